"""The cost of a flight: the errors that a user sees, and how honest their sigmas are."""

from collections.abc import Iterator, Sequence
from math import exp, log
from typing import NamedTuple

import numpy as np
from scipy.special import ndtri

from estimator.geometry.metrics import batch_angle_errors, rms
from estimator.geometry.rotations import exp as exp_turns
from estimator.geometry.rotations import multiply
from estimator.live.rows import cut
from estimator.profile import Profile
from estimator.types import Floats
from tuning.flight import Flight, fly
from tuning.prediction import heading_errors, predicted_vectors

SHARE = 0.68  # of the errors that lie under sigma
# Beside the RMS. With normal errors a sigma three times too small costs 18 %, too large 65 %.
SIGMA_WEIGHT = 2.0
FLOOR_DEG = 0.1  # no reference is better known
# Coverage within these bounds is honest; beyond them it may be this much worse than before.
HONEST = (0.6, 0.76)
COVERAGE_SLACK = 0.02
AROUND = 8  # attitudes around a reference that is uncertain
# Of a normal error a share of 0.68 lies under so many standard deviations: of one component, and
# of two together.
ONE, TWO = 0.994, 1.510
GOLDEN = 0.618034  # turns between two azimuths, so that any few of them are spread out


class Figure(NamedTuple):
    """Inclination or heading over a part of a flight: RMS and quantile loss, deg, and coverage."""

    rms_deg: float
    sigma_loss_deg: float
    coverage: float | None

    @property
    def cost(self) -> float:
        """What the search minimises, deg."""
        return self.rms_deg + SIGMA_WEIGHT * self.sigma_loss_deg


class FlightFigures(NamedTuple):
    """A part's figures; ``heading`` is None where there was none."""

    inclination: Figure
    heading: Figure | None

    @property
    def cost(self) -> float:
        """Geometric mean of both, deg: a percent of the one is worth a percent of the other."""
        return geometric_mean([figure.cost for figure in self if figure is not None])

    @property
    def miscoverage(self) -> float:
        """How far the shares of errors under sigma are from ``SHARE``, in the mean."""
        shares = [f.coverage for f in self if f is not None and f.coverage is not None]
        return sum(abs(share - SHARE) for share in shares) / len(shares) if shares else 1.0

    def as_json(self) -> dict[str, dict[str, float | None] | None]:
        """Plain dictionaries."""
        return {name: angle and angle._asdict() for name, angle in self._asdict().items()}


def harm(before: Sequence[FlightFigures], after: Sequence[FlightFigures]) -> str | None:
    """What a change makes worse on flights, in words; None if error and coverage both hold.

    Errors are weighed over all flights and both angles, as the cost does; coverage holds on each.
    """
    then, now = ([f for figures in side for f in figures] for side in (before, after))
    pairs = [(b, a) for b, a in zip(then, now, strict=True) if b is not None]
    was_deg = geometric_mean([b.rms_deg for b, _ in pairs])
    is_deg = geometric_mean([180.0 if a is None else a.rms_deg for _, a in pairs])
    if is_deg > was_deg:
        return f"the error rises from {was_deg:.3f} to {is_deg:.3f} deg"
    for was, is_ in pairs:
        if is_ is None or is_.coverage is None or was.coverage is None:
            continue
        shares = was.coverage, is_.coverage
        before_off, off = (max(HONEST[0] - each, each - HONEST[1], 0.0) for each in shares)
        if off > before_off + COVERAGE_SLACK:
            return f"a coverage of {was.coverage:.2f} becomes {is_.coverage:.2f}"
    return None


def geometric_mean(costs: list[float]) -> float:
    """The geometric mean, deg: a bad flight does not hide what happens to the good ones.

    The floor is added to each cost and taken off the mean, so that a cost near 0 decides nothing.
    """
    return exp(sum(log(FLOOR_DEG + cost) for cost in costs) / len(costs)) - FLOOR_DEG


def measure(profile: Profile, flight: Flight) -> FlightFigures:
    """Fly with ``profile`` and score it, against the reference wherever it is known.

    Without one by the errors of the vectors that the estimate predicts, which have no sigma.
    """
    course, window = fly(flight, profile), flight.window
    if flight.reference == "none":
        rows = cut(flight.rows, 0, flight.last)
        down, field = predicted_vectors(rows, course.q_ned_frd, course.bias_rad_s, flight.first)
        level = np.arctan2(np.hypot(down[:, 0], down[:, 1]), down[:, 2])
        seen = (errors[np.isfinite(errors)] for errors in (level, heading_errors(field)))
        sizes = [float(np.degrees(rms(errors))) if len(errors) else None for errors in seen]
        tilt, turn = (None if size is None else Figure(size, 0.0, None) for size in sizes)
        return FlightFigures(tilt or Figure(180.0, 0.0, None), turn)
    known = flight.known[window]
    truth_sigma = None if flight.truth_sigma_rad is None else flight.truth_sigma_rad[window]
    sigma = np.degrees(course.sigma_rad[window])
    headed = known & flight.headed[window]
    inclination, heading = [], []
    for truth in possible_truths(flight.truth[window], truth_sigma):
        errors = np.degrees(batch_angle_errors(course.q_ned_frd[window], truth))
        inclination.append(score_errors(errors[known, 2], sigma[known, 0]))
        heading.append(score_errors(errors[headed, 1], sigma[headed, 1]))
    has_heading = flight.has_field and headed.any()
    return FlightFigures(_mean_of(inclination), _mean_of(heading) if has_heading else None)


def possible_truths(truth: Floats, sigma_rad: Floats | None) -> Iterator[Floats]:
    """References (N, 4), or if they have sigmas ``AROUND`` others as likely as each other."""
    if sigma_rad is None:
        yield truth
        return
    share = (np.arange(AROUND) + 0.5) / AROUND
    tilt = np.sqrt(-2.0 * np.log(share)) / TWO
    azimuth = 2.0 * np.pi * GOLDEN * np.arange(AROUND)
    # in another order than the tilts
    turn = ndtri(share[np.argsort(GOLDEN * np.arange(AROUND) % 1.0)]) / ONE
    level, north = sigma_rad.T
    for t, a, h in zip(tilt, azimuth, turn, strict=True):
        each = np.stack([level * t * np.cos(a), level * t * np.sin(a), north * h], axis=-1)
        yield multiply(exp_turns(each), truth)


def _mean_of(figures: Sequence[Figure]) -> Figure:
    """The figures of the same errors against several references as those of all of them."""
    rms_deg, losses_deg, shares = zip(*figures, strict=True)
    return Figure(rms(np.array(rms_deg)), float(np.mean(losses_deg)), float(np.mean(shares)))


def score_errors(errors: Floats, sigma: Floats) -> Figure:
    """Errors (N,) and their sigmas, deg: RMS, quantile loss, coverage.

    The loss (R. Koenker, G. Bassett, 1978, doi:10.2307/1913643) of a share of 0.68 is a proper
    score: least, in the mean, for a sigma that 68 % of the errors lie under.
    """
    if not np.isfinite(errors).all() or not np.isfinite(sigma).all():
        return Figure(180.0, 180.0, 0.0)
    off = errors - sigma
    loss = np.where(off > 0.0, SHARE * off, (SHARE - 1.0) * off)
    return Figure(rms(errors), float(loss.mean()), float(np.mean(off <= 0.0)))
