"""Bytes over UDP, TCP or a serial line, and the table from an endpoint to its transport."""

from collections.abc import Callable

from drivers.endpoint import Endpoint
from drivers.mavlink.transports.serial import SerialLine
from drivers.mavlink.transports.tcp import TcpClient, TcpServer
from drivers.mavlink.transports.transport import Transport
from drivers.mavlink.transports.udp import UdpIn, UdpOut
from estimator.errors import InputError

TRANSPORTS: dict[str, Callable[[Endpoint], Transport]] = {
    "udpin": UdpIn,
    "udpout": UdpOut,
    "tcp": TcpClient,
    "tcpin": TcpServer,
    "serial": SerialLine,
}


def open_transport(endpoint: Endpoint) -> Transport:
    """The transport for a socket or serial endpoint, not yet open.

    Raises:
        InputError: the endpoint is neither.
    """
    transport = TRANSPORTS.get(endpoint.kind)
    if transport is None:
        raise InputError(f"{endpoint} is no MAVLink link: use udpin, udpout, tcp or tcpin")
    return transport(endpoint)
