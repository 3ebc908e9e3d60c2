"""The table from an endpoint to its transport."""

from drivers.endpoint import Endpoint
from drivers.mavlink.transports.serial import SerialLine
from drivers.mavlink.transports.tcp import TcpClient, TcpServer
from drivers.mavlink.transports.transport import Transport
from drivers.mavlink.transports.udp import UdpIn, UdpOut
from estimator.errors import InputError


def open_transport(endpoint: Endpoint) -> Transport:
    """The transport for a socket or serial endpoint, not yet open.

    Raises:
        InputError: the endpoint is neither.
    """
    match endpoint.kind:
        case "udpin":
            return UdpIn(endpoint)
        case "udpout":
            return UdpOut(endpoint)
        case "tcp":
            return TcpClient(endpoint)
        case "tcpin":
            return TcpServer(endpoint)
        case "serial":
            return SerialLine(endpoint)
        case _:
            raise InputError(f"{endpoint} is no MAVLink link: use udpin, udpout, tcp or tcpin")
