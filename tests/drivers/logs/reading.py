"""What the tests of logs ask of events."""

from collections import Counter
from itertools import pairwise
from pathlib import Path

from drivers.events import Imu, Malformed, Rejected

DATA = Path(__file__).parents[2] / "data"
S = 1_000_000


def of(kind, events, message=None):
    found = [event for event in events if isinstance(event, kind)]
    return [event for event in found if message is None or event.message == message]


def imu_times(events, message=None):
    return [event.sample.time_us for event in of(Imu, events, message)]


def gaps_s(times_us):
    return [(b - a) / S for a, b in pairwise(times_us)]


def malformed(events):
    return sum(event.frames for event in of(Malformed, events))


def reasons(events):
    return Counter(str(event.reason) for event in of(Rejected, events))
