"""Whether the autopilot's attitude and ours agree, and which of them other evidence contradicts.

Both are compared at the same instant of the vehicle's clock. They may differ by our
sigma, by trim, mounting and a compass's residual offsets, and by a lag while turning. The evidence
is independent of both: over seconds the specific force less the change of velocity points up, and
the field points to magnetic north.
"""

from collections import Counter, deque
from enum import StrEnum
from math import atan2, cos, degrees, hypot, radians, remainder
from typing import NamedTuple

from msgspec.structs import replace

from drivers.events import FilterStatus
from estimator.geometry import quaternion
from estimator.geometry.earth import PlaceField
from estimator.geometry.quaternion import conjugate, multiply, norm, scale
from estimator.types import STANDARD_GRAVITY_M_S2, Attitude, ImuSample, Quaternion, Vec3
from service.evidence import END_SHARE, SILENT_US, VELOCITY, Consistency, Persistence
from service.publishing import euler_deg
from service.records import Autopilot

LOOK_EVERY_US = 400_000
# Between two attitudes that are both right lie up to some 8 deg of trim, mounting and compass.
TRIM_DEG = 8.0
SIGMAS = 3.0
LAG_S = 0.1
MOST_VELOCITIES = 128  # two seconds of them
# Attitudes agree if they differ by less than this; if a larger difference could hide, no verdict.
CLEAR_DEG = 20.0
# A heading from magnetic north may be a declination off; where people fly it is under this.
DECLINATION_DEG = 20.0
PATIENCE_S = 5.0  # of service.evidence.Persistence
# What its filter reports of itself, once a second or so, holds until it reports something else.
FILTER_STATUS_HOLDS_US = 5_000_000
# One of the two is named if the evidence is nearer to the other by this share of the difference.
NAMED_SHARE = 0.5
# An accelerometer that is off across gravity makes the force larger; by this share of that is odd.
ODD_SHARE = 0.25


class Verdict(StrEnum):
    """The verdict on both attitudes."""

    AGREES = "agrees"
    DIFFERS = "differs"
    CANNOT_TELL = "cannot_tell"


class Difference(NamedTuple):
    """How far the autopilot's attitude lies from ours, and how far it may."""

    off_deg: float  # of the heading clockwise, of the inclination an amount
    sigma_deg: float  # ours
    allowed_deg: float

    @property
    def in_sigmas(self) -> float:
        """The same by our sigma."""
        return round(abs(self.off_deg) / max(self.sigma_deg, 0.01), 1)

    @property
    def is_beyond(self) -> bool:
        """Whether it is more than may be."""
        return abs(self.off_deg) > self.allowed_deg


class Look(NamedTuple):
    """Both attitudes of the IMU at one instant, the last sample and what is known beside them.

    Ours is of the sample, if that is later. ``faults`` are what else speaks against the autopilot's
    and against ours, in words, or empty.
    """

    time_us: int
    message: str  # that the autopilot's comes from
    theirs: Quaternion
    ours: Attitude
    sample: ImuSample
    place: PlaceField | None
    faults: tuple[str, str] = ("", "")


class Interval(NamedTuple):
    """A time for which both have differed, on the vehicle's clock."""

    begin_us: int
    end_us: int
    inclination_deg: float  # the largest
    heading_deg: float
    wrong: str
    evidence: str


class SecondOpinion:
    """Compares one vehicle's two attitudes, a few times a second of its clock."""

    def __init__(self) -> None:
        self.intervals: list[Interval] = []
        self.looks: Counter[Verdict] = Counter()
        self.filter_status: FilterStatus | None = None  # the autopilot's latest
        self._differed = False  # at the last comparison
        self._since_us = 0  # of the verdict, on the vehicle's clock
        self.restart()

    def restart(self) -> None:
        """Begin anew, as our attitude does; the intervals of before stay."""
        self.opinion: Autopilot | None = None  # at the last comparison
        self._last_us: int | None = None
        self._tilting, self._turning = Persistence(PATIENCE_S), Persistence(PATIENCE_S)
        self._ours, self._theirs = Consistency(), Consistency()
        # the vehicle's times (us) and velocities (NED, m/s) since the last look
        self.velocities: deque[tuple[int, Vec3]] = deque(maxlen=MOST_VELOCITIES)

    def is_due(self, time_us: int) -> bool:
        """Whether it is time to look again."""
        return self._last_us is None or not 0 <= time_us - self._last_us < LOOK_EVERY_US

    def compare(self, look: Look) -> list[str]:
        """Compare both attitudes; a line when they begin to differ, and one when that ends."""
        behind_s = 1e-6 * max(look.sample.time_us - look.time_us, 0)
        turn = quaternion.exp(scale(-behind_s, look.ours.rate_rad_s))
        ours = look.ours._replace(q_ned_frd=multiply(look.ours.q_ned_frd, turn))
        self.look(look._replace(ours=ours))
        opinion = self.record(look.time_us)
        differs = opinion is not None and opinion.verdict == Verdict.DIFFERS
        before, self._differed = self._differed, differs
        if opinion is None or differs == before:
            return []
        return [in_words(opinion) if differs else "the autopilot's attitude and ours agree"]

    def look(self, look: Look) -> None:
        """Compare both attitudes of one instant."""
        inclination, heading = differences(look.theirs, look.ours)
        self._gather(look, inclination, heading)
        verdict = self._verdict(inclination, heading)
        self.looks[verdict] += 1
        if self.opinion is None or self.opinion.verdict != verdict:
            self._since_us = look.time_us
        axis, wrong, evidence = "", "", ""
        if verdict is Verdict.DIFFERS and self._tilting.is_on:
            axis, (wrong, evidence) = "inclination", self._judge_tilt(inclination.off_deg, look)
        elif verdict is Verdict.DIFFERS:
            axis, (wrong, evidence) = "heading", self._judge_heading(abs(heading.off_deg), look)
        if axis:
            self._note_interval(look.time_us, (inclination, heading), wrong, evidence)
        angles = zip(euler_deg(look.theirs), euler_deg(look.ours.q_ned_frd), strict=True)
        roll_deg, pitch_deg, _ = (round(remainder(a - b, 360.0), 2) for a, b in angles)
        self.opinion = Autopilot(
            verdict=verdict,
            message=look.message,
            for_s=0.0,
            inclination_deg=round(inclination.off_deg, 2),
            heading_deg=round(heading.off_deg, 2),
            inclination_sigmas=inclination.in_sigmas,
            heading_sigmas=heading.in_sigmas,
            wrong=wrong,
            evidence=evidence,
            axis=axis,
            roll_deg=roll_deg,
            pitch_deg=pitch_deg,
        )

    def record(self, time_us: int) -> Autopilot | None:
        """The verdict at a time of the vehicle's clock; None if it sends no attitude."""
        if self._last_us is not None and not 0 <= time_us - self._last_us < SILENT_US:
            self.opinion = None
        if self.opinion is None:
            return None
        for_s = max(0.0, round(1e-6 * (time_us - self._since_us), 1))
        return replace(self.opinion, for_s=for_s)

    def _gather(self, look: Look, inclination: Difference, heading: Difference) -> None:
        """Take what a look shows; begin anew after a silence."""
        while self.velocities:
            velocity = self.velocities.popleft()
            for each in (self._ours, self._theirs):
                each.take_velocity(*velocity)
        passed_us = look.time_us - (look.time_us if self._last_us is None else self._last_us)
        if not 0 <= passed_us < SILENT_US:
            self.restart()
            passed_us = 0
        self._last_us, dt_s = look.time_us, 1e-6 * passed_us
        self._tilting.look(inclination.is_beyond, dt_s)
        self._turning.look(heading.is_beyond, dt_s)
        self._ours.look(look.ours.q_ned_frd, look.sample, dt_s)
        self._theirs.look(look.theirs, look.sample, dt_s)

    def _note_interval(
        self, time_us: int, off: tuple[Difference, Difference], wrong: str, evidence: str
    ) -> None:
        """Lengthen the interval in which both differ, or begin one."""
        if self._since_us == time_us:
            self.intervals.append(Interval(time_us, time_us, 0.0, 0.0, "", ""))
        now, (inclination, heading) = self.intervals[-1], off
        if wrong or not now.wrong:
            now = now._replace(wrong=wrong, evidence=evidence)
        self.intervals[-1] = now._replace(
            end_us=time_us,
            inclination_deg=max(now.inclination_deg, inclination.off_deg),
            heading_deg=max(now.heading_deg, abs(heading.off_deg)),
        )

    def _verdict(self, inclination: Difference, heading: Difference) -> Verdict:
        axes = ((self._tilting, inclination), (self._turning, heading))
        if any(persistence.is_on for persistence, _ in axes):
            return Verdict.DIFFERS
        agrees = all(
            persistence.share < END_SHARE and abs(it.off_deg) <= it.allowed_deg <= CLEAR_DEG
            for persistence, it in axes
        )
        return Verdict.AGREES if agrees else Verdict.CANNOT_TELL

    def autopilots_fault(self, now_us: int) -> str:
        """What the autopilot's filter reports against itself."""
        known = self.filter_status
        if known is None or abs(now_us - known.arrival_us) > FILTER_STATUS_HOLDS_US:
            return ""
        if not known.has_attitude:
            return "its own filter calls it not good"
        if max(known.velocity_ratio, known.compass_ratio) > 1.0:
            return "its own filter refuses velocity or compass"
        return ""

    def _judge_heading(self, off_deg: float, look: Look) -> tuple[str, str]:
        """Which heading velocity or the field contradicts, and the evidence in words."""
        of_ours, of_theirs = self._ours.turn_deg(look.place), self._theirs.turn_deg(look.place)
        if of_ours is None or of_theirs is None:
            return _weighed("", "nothing else shows the heading", look.faults)
        by = of_ours[1]
        wrong, evidence = _named(by, of_ours[0], of_theirs[0], off_deg)
        if wrong == "autopilot" and by != VELOCITY:  # a compass that is turned shows the same
            wrong, evidence = "", f"{evidence}, but ours is made of it"
        return _weighed(wrong, evidence, look.faults)

    def _judge_tilt(self, off_deg: float, look: Look) -> tuple[str, str]:
        """Which inclination the mean force contradicts; if ours, which is made of it, that is sure.

        An accelerometer that leads ours astray seldom leaves the force as large as gravity, and
        shows in the field's dip.
        """
        both, faults = (self._ours, self._theirs), look.faults
        held = [each.held_m_s2() for each in both]
        ours, theirs = (degrees(atan2(hypot(x, y), -z)) for x, y, z in held)
        wrong, evidence = _named("the mean force", ours, theirs, off_deg)
        if wrong != "autopilot":
            return _weighed(wrong, evidence, faults)
        excess = abs(norm(held[0]) / STANDARD_GRAVITY_M_S2 - 1.0)
        is_odd = excess > ODD_SHARE * (1.0 / max(cos(radians(off_deg)), 0.1) - 1.0)
        if is_odd:
            odd = f"of ours, the force is {excess:.0%} off gravity's strength"
            faults = faults[0], "; ".join(filter(None, [odd, faults[1]]))
        our_dip, their_dip = (each.dip_deg(look.place) for each in both)
        if our_dip is not None and their_dip is not None:
            by_dip, text = _named("the field's dip", our_dip, their_dip, off_deg)
            evidence += f"; {text}" if by_dip else ""
            if by_dip == "ours":
                wrong = "ours" if is_odd else ""
        return _weighed(wrong, evidence, faults)


def differences(theirs: Quaternion, ours: Attitude) -> tuple[Difference, Difference]:
    """How far the autopilot's attitude is off ours, in inclination and in heading."""
    w, x, y, z = multiply(theirs, conjugate(ours.q_ned_frd))
    tilt_deg = degrees(2.0 * atan2(hypot(x, y), hypot(w, z)))
    turn_deg = remainder(degrees(2.0 * atan2(z, w)), 360.0)
    lag_deg = degrees(norm(ours.rate_rad_s)) * LAG_S
    by_tilt = degrees(ours.sigma_inclination_rad)
    by_turn = degrees(ours.sigma_heading_rad) if ours.heading_reference != "none" else 180.0
    unknown_deg = 0.0 if ours.heading_reference == "true" else DECLINATION_DEG
    return (
        Difference(tilt_deg, by_tilt, TRIM_DEG + SIGMAS * by_tilt + lag_deg),
        Difference(turn_deg, by_turn, TRIM_DEG + SIGMAS * by_turn + lag_deg + unknown_deg),
    )


def _named(by: str, ours: float, theirs: float, off_deg: float) -> tuple[str, str]:
    """Which one the evidence contradicts, given in degrees off each; and the same in words."""
    evidence = f"{by} is {ours:.0f} deg off ours and {theirs:.0f} off the autopilot's"
    least = NAMED_SHARE * off_deg
    if min(ours, theirs) > least or abs(theirs - ours) < least:
        return "", evidence
    return ("autopilot" if theirs > ours else "ours"), evidence


def _weighed(wrong: str, evidence: str, faults: tuple[str, str]) -> tuple[str, str]:
    """A known fault of one alone names it, unless the evidence names the other."""
    faulty = wrong
    if bool(faults[0]) != bool(faults[1]):
        faulty = "autopilot" if faults[0] else "ours"
    return (faulty if wrong in ("", faulty) else ""), "; ".join(filter(None, [evidence, *faults]))


def in_words(opinion: Autopilot) -> str:
    """One line for a person, of two that differ."""
    what = "horizon" if opinion.axis == "inclination" else "heading"
    lasted_s = PATIENCE_S + opinion.for_s
    who = {"autopilot": "the autopilot's is likely wrong", "ours": "ours is likely wrong"}
    named = who.get(opinion.wrong, "which is wrong is not known")
    return (
        f"the autopilot's {what} has been {opinion.off_deg:.0f} deg off ours for {lasted_s:.0f} s, "
        f"and ours is good to {opinion.sigma_deg:.0f} deg; {named}: {opinion.evidence}"
    )
