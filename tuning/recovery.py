"""The paper's cost on a flight: how an estimate that is suddenly wrong comes back.

Every 14 s the filter is given the true attitude turned by 170 deg; the conditioning stage and the
aiding go on. The paper's J weighs the errors of the first second with 0.3 and those from 4 to 14 s
with 1, at 100 Hz. On a log each sample stands for the time since the one before, so that costs
compare from one rate to another.
"""

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from estimator.errors import InputError
from estimator.geometry.metrics import STEADY, TRANSIENT, TRANSIENT_WEIGHT, batch_angle_errors
from estimator.geometry.quaternion import multiply
from estimator.profile import Profile
from estimator.types import Floats, Quaternion
from tuning.calls import WRONG_TURN
from tuning.flight import Flight, fly

RECOVERY_S = 14.0
# Both parts of the cost: from when to when, and what the weights of the paper's samples sum to.
PARTS = (
    ((0.0, 1.0), TRANSIENT_WEIGHT * (TRANSIENT.stop - TRANSIENT.start)),
    ((4.0, 14.0), float(STEADY.stop - STEADY.start)),
)
# The conditioning stage learns bias and field for so long before it is judged.
SETTLE_S = 10.0
# A recovery holds no silence longer than this, or than so many sample periods if that is more.
LONGEST_GAP_S, LONGEST_GAP_PERIODS = 1.0, 4.0
LEAST_KNOWN = 0.9  # share of both parts of the cost that needs a reference


class Recovery(NamedTuple):
    """Samples first..last (both included); the estimate is set wrong at the first.

    ``weights`` (last - first + 1,) are those of their errors in J; their sum is the paper's.
    """

    first: int
    last: int
    weights: Floats


def recovery_cost(profile: Profile, flight: Flight) -> float:
    """Mean J over the flight's recoveries; without a magnetic field the inclination alone counts.

    Raises:
        InputError: it has no recovery.
    """
    found = recoveries(flight)
    e = recovery_errors(profile, flight, found)
    return sum(float(w @ e[first : last + 1]) for first, last, w in found) / len(found)


def recovery_errors(profile: Profile, flight: Flight, found: list[Recovery]) -> Floats:
    """e (N,) at each sample that is flown: sin^2 of half the error, 1 of no number."""
    wrong: dict[int, Quaternion] = {}
    for first, _, _ in found:
        w, x, y, z = flight.truth[first].tolist()
        wrong[first] = multiply(WRONG_TURN, (w, x, y, z))
    course = fly(flight, profile, wrong)
    angles = batch_angle_errors(course.q_ned_frd, flight.truth[: flight.last])
    e = np.sin(0.5 * angles[:, 0 if flight.has_field else 2]) ** 2
    return np.where(np.isfinite(e), e, 1.0)


def recoveries(flight: Flight) -> list[Recovery]:
    """Stretches of 14 s of what is scored, none across a restart or a long silence.

    Raises:
        InputError: there is none.
    """
    time_s, window, found = flight.time_s, flight.window, []
    gap_s = np.diff(time_s, prepend=time_s[0])
    longest_s = max(LONGEST_GAP_S, LONGEST_GAP_PERIODS / flight.rate_hz)
    is_break = (flight.restart | (gap_s > longest_s))[window]
    is_break[0] = True
    begins = [*(window.start + np.flatnonzero(is_break)).tolist(), window.stop]
    for begin, end in pairwise(begins):
        start_s = time_s[begin] + SETTLE_S
        while start_s + RECOVERY_S <= time_s[end - 1]:
            first = begin + int(np.searchsorted(time_s[begin:end], start_s))
            end_s = time_s[first] + RECOVERY_S + 1e-9
            last = begin + int(np.searchsorted(time_s[begin:end], end_s)) - 1
            weights = _weights(flight, first, last)
            if weights is not None:
                found.append(Recovery(first, last, weights))
            start_s = time_s[last] + 1e-6
    if not found:
        raise InputError(
            f"{flight.name}: no stretch of 14 s without gaps and with a reference "
            "in what is to be tuned on or held out"
        )
    return found


def _weights(flight: Flight, first: int, last: int) -> Floats | None:
    """Weight of each sample from first to last; None if too many have no reference."""
    t = flight.time_s[first : last + 1] - flight.time_s[first]
    known = flight.known[first : last + 1]
    if last - first < RECOVERY_S * min(flight.rate_hz, 1.0) / 2.0 or not known[0]:
        return None
    share = np.diff(t, prepend=-np.median(np.diff(t))) * known
    weight = np.zeros(len(t))
    for (low, high), total in PARTS:
        inside = (t >= low) & (t <= high)
        if not inside.any() or known[inside].mean() <= LEAST_KNOWN:
            return None
        counted = np.where(inside, share, 0.0)
        weight += counted * total / counted.sum()
    return weight
