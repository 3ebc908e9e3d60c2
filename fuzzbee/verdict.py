"""How far to rely on an attitude: one word, one colour, and the reasons, alike in every view."""

import re
from enum import IntEnum
from typing import NamedTuple

from fuzzbee.latest import Row
from fuzzbee.notify import printable
from service import records
from service.alarms import AXES, Alarm
from service.records import State
from service.second_opinion import Verdict

# Bounds of sigma in degrees. An eye sees 3 degrees on an artificial horizon; at 10 a climb can be
# a descent. A heading 10 off still points to the right field, one 30 off does not.
HORIZON_DEG = (3.0, 10.0)
HEADING_DEG = (10.0, 30.0)
UPSIDE_DOWN_DEG = 90.0  # of roll
IMUS_DEG, IMUS_DEG_S = 3.0, 5.0  # between two sound IMUs at most
COMPASS_DEG = 20.0  # that its offsets explain
POINTS = {0: "N", 45: "NE", 90: "E", 135: "SE", 180: "S", 225: "SW", 270: "W", 315: "NW"}
# A few refused samples, late ticks or lost records a second are no reason to worry.
MUCH_REFUSED = 0.2  # of those that come
MUCH_LOST = 5
# A field that is none of the place is no evidence against the horizon, another's attitude little.
HARMLESS = (Alarm.FIELD_IMPOSSIBLE, Alarm.AUTOPILOT_DIFFERS)
CONTRADICTED = "unsure"  # in place of a sigma that a warning contradicts


class Level(IntEnum):
    """From harmless to harmful."""

    GOOD = 0
    CARE = 1
    BAD = 2
    NONE = 3  # there is no attitude


WORDS = dict(zip(Level, ("trust", "care", "do not trust", "no attitude"), strict=True))
WHY_NONE = {State.WAITING: "waiting for IMU data", State.ALIGNING: "aligning"}


class Caveat(NamedTuple):
    """A reason to rely on an attitude less, in few words; of a warning, also in a sentence."""

    level: Level
    text: str
    sentence: str = ""


class Judgement(NamedTuple):
    """What to think of the horizon, of the heading, and of all together."""

    overall: Level
    horizon: Level
    heading: Level
    caveats: tuple[Caveat, ...]  # the worst first
    horizon_text: str = ""  # its sigma, unless something contradicts that
    heading_text: str = ""  # likewise

    @property
    def word(self) -> str:
        """One word for a person in a hurry."""
        return WORDS[self.overall]


def verdict_of(
    state: State,
    attitude: records.AttitudeRecord | None,
    status: records.StatusRecord | None = None,
    before: records.StatusRecord | None = None,
) -> Judgement:
    """What to think of a vehicle's ``attitude``, None if it is not valid any more.

    ``before`` is the status before ``status``: what grows between them is happening now.
    """
    service = _of_service(status, before)
    if attitude is None or state not in records.HAS_ATTITUDE:
        why = Caveat(Level.NONE, WHY_NONE.get(state, "IMU silent"))
        return _judged(Level.NONE, Level.NONE, [why, *service])
    sigma, north = attitude.sigma_deg, attitude.heading_reference
    horizon = Level(sum(sigma.inclination > bound for bound in HORIZON_DEG))
    heading = Level(sum(sigma.heading > bound for bound in HEADING_DEG))
    texts = [plus_minus(sigma.inclination), f"{plus_minus(sigma.heading)} {north}"]
    caveats = []
    if state is State.DEGRADED:
        caveats.append(Caveat(Level.CARE, f"IMU silent {1e-3 * attitude.age_ms:.1f} s"))
    if abs(attitude.euler_deg[0]) > UPSIDE_DOWN_DEG:
        caveats.append(Caveat(Level.GOOD, "upside down"))
    if horizon > Level.GOOD:
        caveats.append(Caveat(horizon, f"horizon {texts[0]}"))
    # a horizon can be good without its heading: no heading is a matter of care
    if north == "none":
        heading, texts[1] = Level.BAD, "no north"
        caveats.append(Caveat(Level.CARE, texts[1]))
    elif heading > Level.GOOD:
        caveats.append(Caveat(Level.CARE, f"heading {plus_minus(sigma.heading)}"))
    warnings = [] if status is None else _of_warnings(status)
    words = set() if status is None else {*status.warnings}
    if Alarm.AUTOPILOT_DIFFERS in words:  # ours may be the one that is right
        horizon, heading = max(horizon, Level.CARE), max(heading, Level.CARE)
    if words - {Alarm.AUTOPILOT_DIFFERS}:
        texts[1] = texts[1] if heading is Level.BAD else CONTRADICTED
        heading = Level.BAD
    if any(caveat.level is Level.BAD for caveat in warnings):
        texts[0] = texts[0] if horizon is Level.BAD else CONTRADICTED
        horizon = Level.BAD
    return _judged(horizon, heading, [*caveats, *warnings, *service], *texts)


def row_verdict(row: Row) -> Judgement:
    """What to think of a row of the table; of one that its service has left, nothing."""
    if row.is_silent:
        return _judged(Level.NONE, Level.NONE, [Caveat(Level.NONE, "the service is silent")])
    return verdict_of(row.state, row.valid_attitude, row.status, row.before)


def _judged(horizon: Level, heading: Level, caveats: list[Caveat], *texts: str) -> Judgement:
    worst_first = sorted(caveats, key=lambda caveat: -caveat.level)
    overall = max([horizon, *(caveat.level for caveat in caveats)])
    return Judgement(overall, horizon, heading, tuple(worst_first), *texts)


def _of_warnings(status: records.StatusRecord) -> list[Caveat]:
    """What contradicts the attitude whatever sigma is; words of other versions are counted."""
    known = [Alarm(word) for word in status.warnings if word in {*Alarm}]
    caveats = [
        Caveat(Level.CARE if word in HARMLESS else Level.BAD, *warning_texts(word, status))
        for word in known
        if word not in AXES
    ]
    if axes := [word.removeprefix("gyroscope_")[0] for word in known if word in AXES]:
        text = f"gyroscope {', '.join(axes)} contradict{'s' * (len(axes) == 1)}"
        meaning = f"field and force contradict the gyroscope ({', '.join(axes)}); so does a magnet"
        caveats.append(Caveat(Level.BAD, text, meaning))
    if unknown := len(status.warnings) - len(known):
        caveats.append(Caveat(Level.CARE, f"{unknown} unknown warnings"))
    off = imus_off(status)  # if all others differ, the one in use may be the wrong one
    level = Level.CARE if len(off) == len(status.other_imus) else Level.GOOD
    return [*caveats, *(Caveat(level, text) for text in off)]


def warning_texts(word: str, status: records.StatusRecord) -> tuple[str, str]:
    """A warning in few words and in a sentence; one of another version keeps its own name.

    Of another attitude they have how far it is off, and who is likely wrong.
    """
    if word not in {*Alarm}:
        return word, printable(word, 40)
    autopilot, off_deg = status.autopilot, compass_off_deg(status)
    short, meaning = word.replace("_", " "), Alarm(word).meaning
    if word == Alarm.FIELD_IMPOSSIBLE and off_deg is not None:
        off = f"{abs(off_deg):.0f}° off"
        return f"compass {off}", f"{meaning}, the compass is {off}"
    if word == Alarm.AUTOPILOT_DIFFERS and autopilot is not None:
        short = autopilot.in_short
        who = {"autopilot": "; its own is likely wrong", "ours": "; ours is likely wrong"}
        meaning = printable(f"{short} ours{who.get(autopilot.wrong, '')}")
    return short, meaning


def differing(status: records.StatusRecord | None) -> records.Autopilot | None:
    """The autopilot's attitude beside ours, if it differs."""
    theirs = None if status is None else status.autopilot
    return theirs if theirs is not None and theirs.verdict == Verdict.DIFFERS else None


def compass_off_deg(status: records.StatusRecord | None) -> float | None:
    """The compass's own heading less ours, where they disagree."""
    off_deg = None if status is None else status.compass_off_deg
    return None if off_deg is None or abs(off_deg) <= COMPASS_DEG else off_deg


def other_imus(status: records.StatusRecord) -> dict[str, records.ImuDifference]:
    """The difference of each other IMU from the one in use, by a short name: "IMU 2"."""
    own = _imu_number(status.imu_message or "")
    numbers = {message: _imu_number(message) for message in status.other_imus}
    names = (message if n == own else f"IMU {n}" for message, n in numbers.items())
    return dict(zip(names, status.other_imus.values(), strict=True))


def imus_off(status: records.StatusRecord) -> list[str]:
    """The IMUs that differ from the one in use by more than two sound ones, and by how much."""
    lines = []
    for name, each in other_imus(status).items():
        sizes = (each.inclination_deg, IMUS_DEG, "°"), (each.rate_deg_s, IMUS_DEG_S, "°/s")
        if parts := [f"{size:.1f}{unit}" for size, most, unit in sizes if size > most]:
            lines.append(f"{name} off by {', '.join(parts)}")
    return lines


def _imu_number(message: str) -> int:
    """2 of SCALED_IMU2 and of HIGHRES_IMU:1, which counts from 0."""
    found = re.search(r"(:?)(\d+)$", message)
    return 1 if found is None else int(found[2]) + bool(found[1])


def _of_service(
    status: records.StatusRecord | None, before: records.StatusRecord | None
) -> list[Caveat]:
    """What the service has lost since its last status.

    A busy computer is no reason to distrust the attitude: sigma knows how old it is.
    """
    if status is None or before is None:
        return []
    caveats = []
    if status.overloaded:
        shed = status.shed - before.shed
        caveats.append(Caveat(Level.GOOD, f"overloaded, {shed} left out" if shed else "overloaded"))
    late, lost = status.overruns - before.overruns, status.dropped - before.dropped
    for count, what in ((late, "late ticks"), (lost, "records lost")):
        if count > MUCH_LOST:
            caveats.append(Caveat(Level.GOOD, f"this computer is busy, {count} {what}"))
    refused = sum(status.rejected.values()) - sum(before.rejected.values())
    if refused > max(1.0, MUCH_REFUSED * status.imu_rate_hz):
        caveats.append(Caveat(Level.CARE, f"{refused} refused"))
    return caveats


def plus_minus(sigma_deg: float) -> str:
    """A sigma with as many digits as it deserves; the largest means nothing."""
    if sigma_deg >= 180.0:
        return "unknown"
    return f"±{sigma_deg:.1f}°" if sigma_deg < 10.0 else f"±{sigma_deg:.0f}°"


def heading_text(attitude: records.AttitudeRecord) -> str:
    """Three digits; in brackets if they refer to nothing."""
    text = f"{round(attitude.euler_deg[2]) % 360:03}°"
    return f"({text})" if attitude.heading_reference == "none" else text
