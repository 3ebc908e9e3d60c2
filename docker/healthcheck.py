# ruff: noqa: INP001 - a script of the image, not of a package
"""Asks the service on Zenoh how it is; exit status 0 if it answers.

A service whose vehicle is not there yet is healthy: it listens. One that has
vehicles must publish their statuses, which come once a second.
"""

import json
import os
import sys
import threading

import zenoh

ENDPOINT = os.environ.get("FUZZBEE_HEALTH_ENDPOINT", "tcp/127.0.0.1:7447")
PREFIX = os.environ.get("FUZZBEE_HEALTH_PREFIX", "fuzzbee")
CONNECT_TIMEOUT_MS = 2000
STATUS_TIMEOUT_S = 3.0


def main() -> int:
    """0 or 1, with one line that gives the reason."""
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("connect/endpoints", json.dumps([ENDPOINT]))
    config.insert_json5("connect/timeout_ms", str(CONNECT_TIMEOUT_MS))
    try:
        session = zenoh.open(config)
    except zenoh.ZError:
        return answer(1, f"nobody answers on {ENDPOINT}")
    with session:
        fresh = threading.Event()
        subscriber = session.declare_subscriber(f"{PREFIX}/*/status", lambda _: fresh.set())
        vehicles = list(session.liveliness().get(f"{PREFIX}/*/alive"))
        if vehicles and not fresh.wait(STATUS_TIMEOUT_S):
            return answer(1, f"{len(vehicles)} vehicles, but no status in {STATUS_TIMEOUT_S:g} s")
        subscriber.undeclare()
    return answer(0, f"{len(vehicles)} vehicles")


def answer(status: int, text: str) -> int:
    """Print it where ``docker inspect`` shows it."""
    print(text)
    return status


if __name__ == "__main__":
    sys.exit(main())
