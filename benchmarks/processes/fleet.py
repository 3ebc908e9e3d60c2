"""Vehicles for live.py: ``fleet.py PORT VEHICLES HZ SECONDS OUT [FEW FROM TO [LOG]]``.

The simulated vehicles of ``fuzzbee sim``, on UDP, or all that the vehicle of a telemetry log says,
over and over: what they say is made before they begin, so that to send it costs little. OUT (.npy)
gets the sender and the Unix time in ns of every sample's datagram, taken right before it was sent.
With FEW only so many send, but for the time FROM to TO, in s since the start.
"""

import gc
import socket
import sys
import time
from array import array
from collections import Counter
from contextlib import suppress
from pathlib import Path

import numpy as np

from drivers.logs.log_file import Window
from drivers.logs.tlog import TlogRecords, believe
from drivers.mavlink.constants import RAW_IMU_ID
from drivers.mavlink.dialect import mavlink as dialect
from drivers.mavlink.framing import MAGIC_V1, Frame
from drivers.simulation.autopilot import VehicleOptions
from drivers.simulation.fleet import Fleet

# Frames of a log so near are of one moment; samples come at 50 Hz.
MOMENT_US, PERIOD_US = 3000, 20_000
mavlink = dialect()

LATE_S = 0.001  # a datagram leaves this late at most, where there is time


def sayings(options: VehicleOptions, vehicles: int, seconds: float) -> list[tuple[float, bytes]]:
    """All that vehicles say, and when; each datagram has a sample."""
    fleet, said = Fleet(options, vehicles), []
    while fleet.due_us <= seconds * 1e6:
        due_us = fleet.due_us
        fleet.send_due(due_us, 0, lambda data, due_us=due_us: said.append((due_us, data)))
    return said


def recorded(path: Path, vehicles: int, seconds: float) -> list[tuple[float, bytes, bool]]:
    """What a recorded vehicle said, as so many vehicles say it one shortly after the other.

    Frames of one moment share a datagram, as an autopilot's port sends them; also whether the IMU
    message in use is among them.
    """
    records = TlogRecords(Window(path.read_bytes()), frozenset(range(1 << 16)))
    frames = [(us, frame) for us, frame in believe(records, 0) if frame is not None]
    senders = Counter(
        (f.system_id, f.component_id) for _, f in frames if f.message_id == RAW_IMU_ID
    )
    ((own, _),) = senders.most_common(1)
    frames = [(us, f) for us, f in frames if (f.system_id, f.component_id) == own]
    begin_us, moments = frames[0][0], list[tuple[int, list[Frame]]]()
    for us, frame in frames:
        if us - begin_us > 1e6 * seconds:
            break
        if not moments or us - moments[-1][0] > MOMENT_US:
            moments.append((us, []))
        moments[-1][1].append(frame)
    said = [
        (
            us - begin_us + PERIOD_US * k / vehicles,
            b"".join(of_system(f, k + 1) for f in moment),
            any(f.message_id == RAW_IMU_ID for f in moment),
        )
        for us, moment in moments
        for k in range(vehicles)
    ]
    return sorted(said, key=lambda each: each[0])


def sender_at(data: bytes | bytearray) -> int:
    """Where a frame has its system id, before the component id."""
    return 3 if data[0] == MAGIC_V1 else 5


def of_system(frame: Frame, number: int) -> bytes:
    """The frame, without signature, as another vehicle would have sent it."""
    data = bytearray(frame.data[: frame.payload_end])
    at = sender_at(data)
    data[at], data[at + 1] = (number - 1) % 250 + 1, 1 + (number - 1) // 250
    checksum = mavlink.x25crc(bytes(data[1:]))
    checksum.accumulate(bytes([mavlink.mavlink_map[frame.message_id].crc_extra]))
    return bytes(data) + checksum.crc.to_bytes(2, "little")


def main() -> None:
    port, vehicles, rate_hz, seconds, out, *burst = sys.argv[1:]
    few, *burst_s = map(float, burst[:3] or ("1e9", "0", "0"))
    if burst[3:]:
        said = recorded(Path(burst[3]), int(vehicles), float(seconds))
    else:
        made = sayings(VehicleOptions(rate_hz=float(rate_hz)), int(vehicles), float(seconds))
        said = [(*each, True) for each in made]
    gc.freeze()
    print("ready", flush=True)
    sys.stdin.readline()
    sent, start_ns = array("q"), time.time_ns()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as wire:
        wire.connect(("127.0.0.1", int(port)))
        for due_us, data, is_sample in said:
            at = sender_at(data)
            vehicle = 1000 * (data[at + 1] - 1) + data[at]
            if vehicle > few and not burst_s[0] <= 1e-6 * due_us < burst_s[1]:
                continue
            wait_s = 1e-6 * due_us - 1e-9 * (time.time_ns() - start_ns)
            if wait_s > LATE_S:
                time.sleep(wait_s)
            if is_sample:
                sent.extend((vehicle, time.time_ns()))
            with suppress(ConnectionRefusedError):  # nobody listens any more
                wire.send(data)
    np.save(out, np.array(sent, np.int64).reshape(-1, 2))


if __name__ == "__main__":
    main()
