"""The floor under the live benchmark: what the parts cost without us, on the same machine.

``live_floor.py echo`` and ``live_floor.py publish ENDPOINT VEHICLES HZ SECONDS`` are the
processes; the functions measure against them.
"""

import json
import socket
import subprocess
import sys
import time
from typing import Any

import numpy as np

ECHOES = 1000
ECHO_PAUSE_S = 0.001
DATAGRAM_BYTES = 250  # a heartbeat aside, what a simulated vehicle sends at once
PARSED_S = 0.5


def udp_echo() -> dict[str, float]:
    """Half the time of a round trip between two Python processes over plain UDP."""
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender,
        subprocess.Popen([sys.executable, __file__, "echo"], stdout=subprocess.PIPE) as process,  # noqa: S603
    ):
        assert process.stdout is not None
        sender.connect(("127.0.0.1", int(process.stdout.readline())))
        half_ms = []
        for _ in range(ECHOES):
            begin_ns = time.perf_counter_ns()
            sender.send(bytes(DATAGRAM_BYTES))
            sender.recv(4096)
            half_ms.append((time.perf_counter_ns() - begin_ns) / 2e6)
            time.sleep(ECHO_PAUSE_S)
        sender.send(b"end")
    return percentiles(half_ms)


def pymavlink_parser(vehicles: int, rate_hz: float) -> dict[str, float]:
    """pymavlink's parse_char over the same datagrams, and the share of a core it would take."""
    from drivers.mavlink.dialect import mavlink
    from drivers.simulation.autopilot import SimulatedAutopilot, VehicleOptions

    autopilot = SimulatedAutopilot(VehicleOptions(rate_hz=rate_hz), 1)
    datagrams = [autopilot.advance(autopilot.due_us, 0) for _ in range(500)]
    parser = mavlink().MAVLink(None)
    parser.robust_parsing = True
    parsed, begin_s = 0, time.process_time()
    while (spent_s := time.process_time() - begin_s) < PARSED_S:
        for datagram in datagrams:
            parser.parse_buffer(datagram)
        parsed += len(datagrams)
    per_datagram_s = spent_s / parsed
    return {
        "us_per_datagram": round(per_datagram_s * 1e6, 2),
        "cores": round(per_datagram_s * vehicles * rate_hz, 3),
    }


def percentiles(values_ms: Any) -> dict[str, float]:
    """p50, p99 and worst."""
    values = np.asarray(values_ms, float)
    if not values.size:
        return {}
    p50, p99 = np.percentile(values, (50, 99))
    return {
        "p50_ms": round(float(p50), 3),
        "p99_ms": round(float(p99), 3),
        "worst_ms": round(float(values.max()), 3),
    }


def _echo() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as echo:
        echo.bind(("127.0.0.1", 0))
        print(echo.getsockname()[1], flush=True)
        data = b""
        while data != b"end":
            data, sender = echo.recvfrom(4096)
            echo.sendto(data, sender)


def _publish(endpoint: str, vehicles: int, rate_hz: float, seconds: float) -> None:
    """Records of the size of ours, on as many keys; the time in them is that of the put."""
    import zenoh

    config = zenoh.Config()
    config.insert_json5("listen/endpoints", json.dumps([endpoint]))
    config.insert_json5("scouting/multicast/enabled", "false")
    filler = "x" * 480
    with zenoh.open(config) as session:
        publishers = [
            session.declare_publisher(
                f"fuzzbee/{vehicle}/attitude",
                congestion_control=zenoh.CongestionControl.DROP,
                express=False,
            )
            for vehicle in range(1, vehicles + 1)
        ]
        print("ready", flush=True)
        sys.stdin.readline()
        start_s = time.monotonic()
        for tick in range(int(seconds * rate_hz)):
            time.sleep(max(0.0, start_s + tick / rate_hz - time.monotonic()))
            for publisher in publishers:
                now_us = time.time_ns() // 1000
                record = (
                    f'{{"time_unix_us":{now_us},"age_ms":0,"sequence":{tick},"filler":"{filler}"}}'
                )
                publisher.put(record)


if __name__ == "__main__":
    if sys.argv[1] == "echo":
        _echo()
    else:
        _publish(sys.argv[2], int(sys.argv[3]), float(sys.argv[4]), float(sys.argv[5]))
