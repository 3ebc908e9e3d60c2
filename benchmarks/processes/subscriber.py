"""The subscriber of the live benchmark, as a process: ``subscriber.py ENDPOINT OUT``.

Prints "ready" once subscribed and ends with its standard input. OUT (.npy) gets, for each
attitude: vehicle, Unix time of the callback in ns, time of the tick in us, the age of its
sample in us, sequence.
"""

import sys
import time
from array import array

import msgspec
import numpy as np
import zenoh

from service.zenoh_session import OpeningSession, ZenohOptions


class Seen(msgspec.Struct):
    """What is looked at of an attitude record."""

    time_unix_us: int
    age_ms: float
    sequence: int


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

    options = ZenohOptions(connect=(endpoint,), mode="client")
    with OpeningSession(options, print).session() as session:
        session.declare_subscriber("fuzzbee/*/attitude", on_attitude)
        print("ready", flush=True)
        sys.stdin.read()
    np.save(out, np.array(rows, np.int64).reshape(-1, 5))


if __name__ == "__main__":
    main()
