"""The subscriber of the live benchmark, as a process: ``subscriber.py ENDPOINT OUT``.

Prints "ready" once subscribed and ends with its standard input. OUT (.npy) gets, for each
attitude: vehicle, Unix time of the callback in ns, time of the tick in us, the age of its
sample in us, sequence.
"""

import json
import sys
import time
from array import array

import msgspec
import numpy as np
import zenoh


class Seen(msgspec.Struct):
    """What is looked at of an attitude record."""

    time_unix_us: int
    age_ms: float
    sequence: int


def client(endpoint: str) -> zenoh.Session:
    """A Zenoh client of the session at ``endpoint``."""
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([endpoint]))
    config.insert_json5("scouting/multicast/enabled", "false")
    return zenoh.open(config)


def main() -> None:
    endpoint, out = sys.argv[1:]
    rows = array("q")
    decode = msgspec.json.Decoder(Seen).decode

    def on_attitude(sample: zenoh.Sample) -> None:
        now_ns = time.time_ns()
        seen = decode(sample.payload.to_bytes())
        system, _, component = str(sample.key_expr).split("/")[1].partition("-")
        vehicle = 1000 * (int(component or 1) - 1) + int(system)
        rows.extend((vehicle, now_ns, seen.time_unix_us, round(seen.age_ms * 1e3), seen.sequence))

    with client(endpoint) as session:
        session.declare_subscriber("fuzzbee/*/attitude", on_attitude)
        print("ready", flush=True)
        sys.stdin.read()
    np.save(out, np.array(rows, np.int64).reshape(-1, 5))


if __name__ == "__main__":
    main()
