"""Vehicles that come and go with new ids, for soak.py: over UDP, or a day of them in a log.

``comers.py PORT SECONDS KEY_FILE`` sends as many as twenty at a time at 10 Hz,
signed, each for ten seconds.
"""

import itertools
import socket
import sys
import time
from collections import deque
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from drivers.events import VehicleId
from drivers.mavlink.constants import MAV_AUTOPILOT_ARDUPILOTMEGA, MAV_TYPE_QUADROTOR
from drivers.mavlink.encoder import FrameEncoder, Message, heartbeat, raw_imu, signing_key
from drivers.simulation.simulated_vehicle import SimulatedVehicle

FIRST_COMPONENT = 3  # the fleet beside them has 1 and 2
SYSTEMS, COMPONENTS = 250, 188  # 191 is ours
SAMPLES = 600  # which all of them send, over and over


class Plan(NamedTuple):
    """How many fly at a time, for how long each, and their samples a second."""

    at_a_time: int = 20
    stay_s: float = 10.0
    rate_hz: float = 10.0


class Comer:
    """One vehicle's frames, from its first sample to its last."""

    def __init__(self, vehicle: VehicleId, key: bytes | None, messages: list[Message]) -> None:
        self._encoder = FrameEncoder(vehicle, key)
        self._messages = messages
        self._sent = 0

    def frames(self, unix_us: int, rate_hz: float) -> bytes:
        """A sample, and a heartbeat each second."""
        number, self._sent = self._sent, self._sent + 1
        sample = self._messages[number % len(self._messages)]
        frames = self._encoder.frame(sample, unix_us)
        if number % max(1, round(rate_hz)) == 0:
            beat = heartbeat(MAV_TYPE_QUADROTOR, MAV_AUTOPILOT_ARDUPILOTMEGA)
            frames += self._encoder.frame(beat, unix_us)
        return frames


def comers(plan: Plan, start_us: int, key: bytes | None) -> Iterator[tuple[int, bytes]]:
    """(time, frames) for ever: at each sample of all that fly one comes, and one goes, if due."""
    messages = _messages(plan.rate_hz)
    addresses = itertools.cycle(
        VehicleId(1 + n % SYSTEMS, FIRST_COMPONENT + n // SYSTEMS)
        for n in range(SYSTEMS * COMPONENTS)
    )
    flying: deque[Comer] = deque()
    turns_a_comer = plan.stay_s * plan.rate_hz / plan.at_a_time
    met = 0
    for turn in itertools.count():
        while met <= turn / turns_a_comer:
            met += 1
            flying.append(Comer(next(addresses), key, messages))
            if len(flying) > plan.at_a_time:
                flying.popleft()
        now_us = start_us + round(1e6 * turn / plan.rate_hz)
        for comer in flying:
            yield now_us, comer.frames(now_us, plan.rate_hz)


def write_day(path: Path, hours: float, plan: Plan) -> int:
    """A telemetry log of so many hours; returns the number of samples."""
    start_us = 1_700_000_000_000_000
    end_us = start_us + round(3.6e9 * hours)
    samples = 0
    with path.open("wb") as out:
        for now_us, frames in comers(plan, start_us, None):
            if now_us >= end_us:
                return samples
            samples += 1
            stamp = now_us.to_bytes(8, "big")
            first = 12 + frames[1]  # a frame has 12 bytes beside its payload
            out.write(stamp + frames[:first])
            if len(frames) > first:
                out.write(stamp + frames[first:])
    return samples


def _messages(rate_hz: float) -> list[Message]:
    vehicle = SimulatedVehicle(seed=0, rate_hz=rate_hz)
    return [
        raw_imu(s.time_us, s.acc_m_s2, s.gyr_rad_s, s.mag_gauss)
        for s in itertools.islice(vehicle, SAMPLES)
    ]


def main() -> None:
    port, seconds, key_file = int(sys.argv[1]), float(sys.argv[2]), Path(sys.argv[3])
    key = signing_key(key_file.read_bytes())
    start_us = time.time_ns() // 1000
    target = ("127.0.0.1", port)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
        for due_us, frames in comers(Plan(), start_us, key):
            if due_us - start_us > 1e6 * seconds:
                return
            wait_s = 1e-6 * (due_us - time.time_ns() // 1000)
            if wait_s > 0.0:
                time.sleep(wait_s)
            out.sendto(frames, target)


if __name__ == "__main__":
    main()
