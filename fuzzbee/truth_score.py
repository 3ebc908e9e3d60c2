"""The estimate beside a simulator's truth: live, and as a verdict at the end."""

from math import degrees, inf, sqrt
from typing import Any, NamedTuple

from drivers.events import ReferenceAttitude
from drivers.simulation.flight import ALOFT_S, EIGHTS_S, MAGNET_S, ROUND_S, SET_DOWN_S, SILENCE_S
from drivers.simulation.simulated_vehicle import PROFILES
from estimator.geometry.metrics import angle_errors
from estimator.types import Attitude, Quaternion
from service.pipeline import Pipeline
from service.records import Message, Output

SMOOTHED = 0.02  # share of a new error in the one that is shown
PAPER = "the paper's signals are that noisy: 0.2 rad/s and 5 % of the vectors, and biased"
RELEASED = "somebody still sets the copter down: who aligns now starts wrong"


class Chapter(NamedTuple):
    """A part of a flight: when it is in the round (s), what is said as it begins, and its name."""

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


class Off(NamedTuple):
    """How far an attitude is from the truth, and sigma of both (deg)."""

    total: float
    inclination: float
    heading: float
    inclination_sigma: float
    heading_sigma: float


class TruthScore:
    """Errors so far of one vehicle; of fuzzbee's own its ``motion`` shows what happens when.

    Its time is the vehicle's own, since its start.
    """

    def __init__(self, motion: str | None = None) -> None:
        self.motion = motion
        self._told: set[tuple[int, str]] = set()
        self._count = 0
        self._squares = [0.0, 0.0, 0.0]
        self._inside = [0, 0]
        self._smooth: list[float] = []
        self._worst: tuple[Off, float] | None = None
        self.line = ""  # for the view

    def _here(self, time_s: float) -> tuple[int, list[Chapter]]:
        """The round of a flight, the others do not begin again; and what it is in there."""
        number, in_round_s = divmod(time_s, ROUND_S if self.motion == "flight" else inf)
        chapters = CHAPTERS.get(self.motion or "", ())
        return int(number), [c for c in chapters if c.begin_s <= in_round_s < c.end_s]

    def look(self, time_us: int, attitude: Attitude | None, truth: Quaternion) -> list[str]:
        """Take the attitude of a sample and the truth then; what is to be told."""
        time_s = 1e-6 * time_us
        if attitude is not None:
            self._add(off_truth(attitude, truth), time_s)
        number, here = self._here(time_s)
        news = [(number, chapter.line) for chapter in here if chapter.line]
        news = [each for each in news if each not in self._told]
        self._told.update(news)
        return [f"now: {line}" for _, line in news]

    def _add(self, off: Off, time_s: float) -> None:
        self._count += 1
        self._squares = [a + b * b for a, b in zip(self._squares, off, strict=False)]
        self._inside[0] += off.inclination <= off.inclination_sigma
        self._inside[1] += off.heading <= off.heading_sigma
        before = self._smooth or off[:3]
        self._smooth = [a + SMOOTHED * (b - a) for a, b in zip(before, off, strict=False)]
        if self._worst is None or off.total > self._worst[0].total:
            self._worst = off, time_s
        total, inclination, heading = self._smooth
        self.line = f"truth: {total:.1f}° off (horizon {inclination:.1f}°, heading {heading:.1f}°)"

    def result(self) -> dict[str, Any] | None:
        """The verdict as numbers (deg), None if nothing was compared."""
        if self._worst is None:
            return None
        rms = [round(sqrt(square / self._count), 3) for square in self._squares]
        off, time_s = self._worst
        _, here = self._here(time_s)
        return {
            "rms_deg": dict(zip(("total", "inclination", "heading"), rms, strict=True)),
            "coverage": {
                "inclination": round(self._inside[0] / self._count, 3),
                "heading": round(self._inside[1] / self._count, 3),
            },
            "worst_deg": round(off.total, 2),
            "worst_s": round(time_s, 2),
            "worst_when": here[0].name if here else "",
        }

    def verdict(self) -> str:
        """The same in words; empty if nothing was compared."""
        result = self.result()
        if result is None:
            return ""
        rms, inside = result["rms_deg"], result["coverage"]
        when = f", {result['worst_when']}" if result["worst_when"] else ""
        why = f"; {PAPER}" if PROFILES.get(self.motion or "") == "paper" else ""
        return (
            f"beside the truth: {rms['total']:.1f}° RMS (horizon {rms['inclination']:.1f}°,"
            f" heading {rms['heading']:.1f}°); under sigma {inside['inclination']:.0%} and"
            f" {inside['heading']:.0%} of the errors (68 % is honest, more is careful);"
            f" worst {result['worst_deg']:.1f}° at {result['worst_s']:.1f} s{when}{why}"
        )


class ScoredPipeline(Pipeline):
    """A pipeline that compares what its vehicles' simulators show, if it has ``scores``.

    Those are by the vehicle's name, in the order of its first truth.
    """

    scores: dict[str, TruthScore] | None = None

    def on_reference(self, event: ReferenceAttitude) -> list[Output]:
        """See :class:`Pipeline`; and compare the attitude with the truth."""
        outputs = super().on_reference(event)
        if self.scores is None or event.source != "sim":
            return outputs
        vehicle = self.vehicle(event.vehicle)
        if vehicle is None:
            return outputs
        score = self.scores.setdefault(vehicle.name, TruthScore())
        score.motion = vehicle.built_in_motion  # told some times a second, maybe after this
        estimator = vehicle.estimator
        attitude = estimator.attitude(event.time_us) if estimator.aligned else None
        lines = score.look(event.time_us, attitude, event.q_ned_frd)
        return [*outputs, *(Message(f"vehicle {vehicle.name}: {line}") for line in lines)]


def off_truth(attitude: Attitude, truth: Quaternion) -> Off:
    """The errors of an attitude."""
    total, heading, inclination = angle_errors(attitude.q_ned_frd, truth)
    sigmas = attitude.sigma_inclination_rad, attitude.sigma_heading_rad
    return Off(*map(degrees, (total, inclination, heading, *sigmas)))
