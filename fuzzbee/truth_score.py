"""The estimate beside a simulator's truth: live, and as a verdict at the end."""

from math import degrees, inf
from typing import Any, NamedTuple

import numpy as np

from drivers.events import ReferenceAttitude
from drivers.simulation.flight import ALOFT_S, EIGHTS_S, MAGNET_S, ROUND_S, SET_DOWN_S, SILENCE_S
from drivers.simulation.simulated_vehicle import PROFILES
from estimator.geometry.metrics import angle_errors
from estimator.types import Attitude, Floats, Quaternion
from service.pipeline import Pipeline
from service.records import Message, Output

SMOOTHED = 0.02  # share of a new error in the one that is shown
PAPER = "the paper's signals are that noisy: 0.2 rad/s and 5 % of the vectors, and biased"
RELEASED = "somebody still sets the copter down: who aligns now starts wrong"
ANGLES = ("total", "inclination", "heading")


class Chapter(NamedTuple):
    """A part of a flight: when it is in the round (s), a line as it begins, and its name."""

    begin_s: float
    end_s: float
    line: str
    name: str


FLIGHT = (
    Chapter(0.0, SET_DOWN_S, RELEASED, "while it was set down by hand"),
    Chapter(*MAGNET_S, "a magnet of twice the Earth's field passes", "beside the magnet"),
    Chapter(*SILENCE_S, "nothing is heard for 0.9 s", "in the silence"),
    Chapter(SILENCE_S[1], SILENCE_S[1] + 2.0, "", "just after the silence"),
    Chapter(ALOFT_S[0], EIGHTS_S[0][0] + 4.0, "", "in the climb, before velocity had shown much"),
    *(Chapter(*span, "", "in the figures of eight") for span in EIGHTS_S),
)
PAPER_START = (Chapter(0.0, 1.0, "", "at the start, which is the paper's: turned almost round"),)
CHAPTERS = {"flight": FLIGHT, **dict.fromkeys(("paper", "rest", "turn"), PAPER_START)}


class TruthScore:
    """Errors so far (deg) of one vehicle; the ``motion`` of fuzzbee's own shows what happens when.

    Its time is the vehicle's own, since its start. Sums are kept, not samples: a run has no end.
    """

    def __init__(self, motion: str | None = None) -> None:
        self.motion = motion
        self.line = ""  # for the view
        self._announced: set[tuple[int, str]] = set()
        self._count = 0
        self._squares = np.zeros(3)  # of ANGLES
        self._under_sigma = np.zeros(2)  # inclination and heading
        self._smooth: Floats | None = None
        self._worst, self._worst_s = 0.0, 0.0

    def look(self, time_us: int, attitude: Attitude | None, truth: Quaternion) -> list[str]:
        """Compare the attitude of a sample with the truth then; lines about what begins."""
        time_s = 1e-6 * time_us
        if attitude is not None:
            total, heading, inclination = map(degrees, angle_errors(attitude.q_ned_frd, truth))
            errors = np.array([total, inclination, heading])
            self._count += 1
            self._squares += errors * errors
            sigmas = attitude.sigma_inclination_rad, attitude.sigma_heading_rad
            self._under_sigma += errors[1:] <= np.degrees(sigmas)
            before = errors if self._smooth is None else self._smooth
            self._smooth = before + SMOOTHED * (errors - before)
            if total > self._worst or self._count == 1:
                self._worst, self._worst_s = total, time_s
            off = "truth: {:.1f}° off (horizon {:.1f}°, heading {:.1f}°)"
            self.line = off.format(*self._smooth.tolist())
        number, here = self._here(time_s)
        lines = [each.line for each in here if (number, each.line) not in self._announced]
        self._announced.update((number, line) for line in lines)
        return [f"now: {line}" for line in lines if line]

    def _here(self, time_s: float) -> tuple[int, list[Chapter]]:
        """The round of a flight, the others do not begin again; and what it is in there."""
        number, in_round_s = divmod(time_s, ROUND_S if self.motion == "flight" else inf)
        chapters = CHAPTERS.get(self.motion or "", ())
        return int(number), [c for c in chapters if c.begin_s <= in_round_s < c.end_s]

    def result(self) -> dict[str, Any] | None:
        """The verdict as numbers (deg), None if nothing was compared."""
        if not self._count:
            return None
        rms = np.sqrt(self._squares / self._count).round(3).tolist()
        coverage = (self._under_sigma / self._count).round(3).tolist()
        _, here = self._here(self._worst_s)
        return {
            "rms_deg": dict(zip(ANGLES, rms, strict=True)),
            "coverage": dict(zip(ANGLES[1:], coverage, strict=True)),
            "worst_deg": round(self._worst, 2),
            "worst_s": round(self._worst_s, 2),
            "worst_when": here[0].name if here else "",
        }

    def verdict(self) -> str:
        """The same in words; empty if nothing was compared."""
        result = self.result()
        if result is None:
            return ""
        rms, coverage = result["rms_deg"], result["coverage"]
        when = f", {result['worst_when']}" if result["worst_when"] else ""
        why = f"; {PAPER}" if PROFILES.get(self.motion or "") == "paper" else ""
        return (
            f"beside the truth: {rms['total']:.1f}° RMS (horizon {rms['inclination']:.1f}°,"
            f" heading {rms['heading']:.1f}°); under sigma {coverage['inclination']:.0%} and"
            f" {coverage['heading']:.0%} of the errors (68 % is honest, more is careful);"
            f" worst {result['worst_deg']:.1f}° at {result['worst_s']:.1f} s{when}{why}"
        )


class ScoredPipeline(Pipeline):
    """A pipeline that compares what its vehicles' simulators show, if it has ``scores``."""

    scores: dict[str, TruthScore] | None = None  # by name, in the order of their first truths

    def on_reference(self, event: ReferenceAttitude) -> list[Output]:
        """See :class:`Pipeline`; and compare the attitude with the truth."""
        outputs = super().on_reference(event)
        vehicle = self.vehicle(event.vehicle)
        if self.scores is None or event.source != "sim" or vehicle is None:
            return outputs
        score = self.scores.setdefault(vehicle.name, TruthScore())
        score.motion = vehicle.built_in_motion  # sent some times a second, maybe after this
        estimator = vehicle.estimator
        attitude = estimator.attitude(event.time_us) if estimator.aligned else None
        lines = score.look(event.time_us, attitude, event.q_ned_frd)
        return [*outputs, *(Message(f"vehicle {vehicle.name}: {line}") for line in lines)]
