"""What contradicts an attitude although no data is missing.

Things that must hold, whatever the vehicle does, by its own sensors seen from the published
attitude: on average the specific force points up, since nothing accelerates for ever; the Earth's
field keeps its direction, and is that of the place; its dip agrees with the vertical of
force and velocity; a gyroscope's bias is within what the profile allows, its axes show the turns
that field and force show; and the vehicle's seconds are as long as the host's. If one does not
hold, the profile, the axes, a sensor or the clock is wrong, and sigma does not show it. No clock is
read; times are the vehicle's, and those of arrival.
"""

from enum import StrEnum
from math import atan2, degrees, hypot, radians, sqrt
from typing import Self

from estimator.aiding.compass import CONTRADICTED, resembles
from estimator.estimator import Estimator
from estimator.geometry.earth import PlaceField
from estimator.geometry.quaternion import rotate
from estimator.types import Attitude, ImuSample, Vec3
from service.evidence import Persistence, off_north_deg, towards

LOOK_EVERY_US = 500_000
MEMORY_S = 20.0  # of the averages
AT_LIMIT = 0.99  # share of the bound
# A plane that turns round changes its velocity by 50 m/s within the memory, which is 14 deg.
TILT_DEG = 15.0
# A magnet that passes within two seconds leaves 18 deg, which fades; vehicles in flight have 5.
SCATTER_DEG = 12.0
SIGMAS = 2.0
# Of a vertical that the field contradicts, beyond what hard iron and the place's steel explain.
DIP_OFF_DEG = 5.0
# A heading by velocity and one by the field differ by the compass's offsets, up to 11 deg seen.
HEADING_OFF_DEG = 20.0
# Vehicle's time by the host's over ten seconds. Bursts make it swing, both ways; what stays on one
# side for a minute is the clock. The longest that 46 recorded logs stayed there counts 0.5 at most.
PACE_SPAN_US = 10_000_000
PACE_OFF = 0.02
UNKNOWN_HEADING_RAD = radians(40.0)  # beyond this sigma the heading is unknown
# The Earth's field is 0.22 to 0.67 gauss; compasses are off in scale by a factor.
WEAKEST_GAUSS, STRONGEST_GAUSS = 0.1, 1.0
# A compass that is this far off may be mounted otherwise than declared; iron does less.
LEAST_TURNED_DEG = 40
_CONTRADICT = "field and force contradict the gyroscope's"


class Alarm(StrEnum):
    """The words of a status's warnings; docs/troubleshooting.md lists what a person can do.

    ``patience_s`` is the time constant of its :class:`service.evidence.Persistence`, if any.
    """

    meaning: str
    patience_s: float

    def __new__(cls, word: str, meaning: str = "", patience_s: float = 0.0) -> Self:
        """See :class:`enum.Enum`: its value is the word."""
        alarm = str.__new__(cls, word)
        alarm._value_, alarm.meaning, alarm.patience_s = word, meaning, patience_s
        return alarm

    ACCELEROMETER = (
        "accelerometer_contradicts",
        "the magnetic field contradicts the accelerometer's vertical",
        5.0,
    )
    AUTOPILOT_DIFFERS = "autopilot_differs", "the autopilot's attitude differs from ours"
    BIAS_AT_LIMIT = "bias_at_limit", "the gyroscope's bias stands at its limit", 5.0
    CLOCK_DRIFT = "clock_drift", "the vehicle's clock runs too fast or too slow", 60.0
    FIELD_IMPOSSIBLE = "field_impossible", "the magnetic field is none of this place", 20.0
    GYROSCOPE_X = "gyroscope_x_contradicts", f"{_CONTRADICT} x axis", 1.0
    GYROSCOPE_Y = "gyroscope_y_contradicts", f"{_CONTRADICT} y axis", 1.0
    GYROSCOPE_Z = "gyroscope_z_contradicts", f"{_CONTRADICT} z axis", 1.0
    SIGMA_TOO_SMALL = (
        "sigma_too_small",
        "force and field contradict the attitude by more than sigma allows",
        20.0,
    )
    PROFILE_UNFIT = "profile_unfit", "the profile does not fit these signals"


AXES = (Alarm.GYROSCOPE_X, Alarm.GYROSCOPE_Y, Alarm.GYROSCOPE_Z)


class Alarms:
    """Looks at one vehicle's estimate twice a second of its time, and reports what changes."""

    def __init__(self) -> None:
        self.profile_is_unfit = False  # as the vehicle itself reports
        self._reported: frozenset[Alarm] = frozenset()
        self._compass_reported: set[str] = set()
        self.restart()

    def restart(self) -> None:
        """Forget what was seen of another estimate."""
        self.words: frozenset[Alarm] = frozenset()  # of the alarms that stand now
        self.compass_off_deg: float | None = None  # its own heading less ours, averaged
        self._last_us: int | None = None  # of the vehicle's time
        self._persistence = {
            each: Persistence(each.patience_s) for each in Alarm if each.patience_s > 0.0
        }
        self._force: Vec3 | None = None  # mean specific force, NED
        self._field: Vec3 | None = None  # mean field, NED, and its mean square
        self._field_square = 0.0
        self._pace_since_us: tuple[int, int] | None = None  # the vehicle's time, and arrival

    def is_due(self, time_us: int) -> bool:
        """Whether it is time to look again."""
        return self._last_us is None or time_us - self._last_us >= LOOK_EVERY_US

    def look(
        self, sample: ImuSample, arrival_us: int, attitude: Attitude, estimator: Estimator
    ) -> list[str]:
        """Compare a sample with the attitude at its time; returns lines for a person.

        A field that is not used, because velocity contradicts it, shows nothing of the attitude.
        While velocity helps, a field that scatters is wrong itself.
        """
        time_us = sample.time_us
        last_us, self._last_us = self._last_us, time_us
        dt_s = 0.0 if last_us is None else min(1e-6 * (time_us - last_us), MEMORY_S)
        self._remember(sample, attitude, dt_s / (MEMORY_S + dt_s))
        # a small sigma excludes a contradiction, which takes longer to compute
        is_sure = degrees(attitude.sigma_inclination_rad) < DIP_OFF_DEG
        dip_error_rad = 0.0 if is_sure else estimator.dip_error_rad
        why = estimator.compass_fault
        settings = estimator.settings
        limit = AT_LIMIT * settings.filter.bias_bound_rad_s
        if settings.conditioned:
            limit = AT_LIMIT * settings.conditioning.bias_limit_rad_s
        self.compass_off_deg = self._compass_off_deg(attitude, estimator)
        is_impossible, scatters = True, False
        if why != CONTRADICTED:
            is_impossible, scatters = self._field_faults(attitude, estimator.place_field)
        seen = {
            Alarm.ACCELEROMETER: degrees(dip_error_rad) > DIP_OFF_DEG,
            Alarm.BIAS_AT_LIMIT: limit > 0.0 and max(map(abs, attitude.gyro_bias_rad_s)) >= limit,
            Alarm.FIELD_IMPOSSIBLE: is_impossible or (scatters and estimator.is_aided),
            Alarm.SIGMA_TOO_SMALL: self._is_tilted(attitude)
            or (scatters and not estimator.is_aided),
            **dict(zip(AXES, estimator.contradicted_axes, strict=True)),
        }
        for word, is_so in seen.items():
            self._persistence[word].look(is_so, dt_s)
        self._follow_pace(time_us, arrival_us)
        self.words = frozenset(word for word, each in self._persistence.items() if each.is_on)
        return [*self._compass_lines(why, estimator), *self._alarm_lines()]

    def _compass_lines(self, why: str, estimator: Estimator) -> list[str]:
        """Why the compass does not give the heading, once for each reason."""
        if not why or why in self._compass_reported:
            return []
        self._compass_reported.add(why)
        if why != CONTRADICTED:
            return [f"heading ±45° until velocity shows it: {why}"]
        off_deg = round(degrees(estimator.compass_off_rad))
        asked = "; is its orientation set rightly?" * (abs(off_deg) >= LEAST_TURNED_DEG)
        return [f"velocity shows the heading, not the compass, which is {off_deg}° off{asked}"]

    def _alarm_lines(self) -> list[str]:
        """The alarms that have begun or ended since the last look."""
        before, self._reported = self._reported, self.words
        begun = [f"warning: {word.meaning}" for word in sorted(self.words - before)]
        ended = [f"no more: {word.meaning}" for word in sorted(before - self.words)]
        return [*begun, *ended]

    def _remember(self, sample: ImuSample, attitude: Attitude, share: float) -> None:
        q = attitude.q_ned_frd
        self._force = towards(self._force, rotate(q, sample.acc_m_s2), share)
        if sample.has_mag:
            square = sum(b * b for b in sample.mag_gauss) - self._field_square
            self._field_square += square if self._field is None else share * square
            self._field = towards(self._field, rotate(q, sample.mag_gauss), share)

    def _follow_pace(self, time_us: int, arrival_us: int) -> None:
        """Every ten seconds of the host, note whether the vehicle's clock was too fast or slow.

        The share is that of the host's time: a burst is long by the vehicle's.
        """
        self._pace_since_us = self._pace_since_us or (time_us, arrival_us)
        passed_us = time_us - self._pace_since_us[0]
        host_passed_us = arrival_us - self._pace_since_us[1]
        if 0 <= host_passed_us < PACE_SPAN_US:
            return
        self._pace_since_us = (time_us, arrival_us)
        ahead_us = passed_us - host_passed_us
        is_off = abs(ahead_us) > PACE_OFF * host_passed_us
        side = is_off * (1 if ahead_us > 0 else -1)  # a clock that is too slow is below zero
        self._persistence[Alarm.CLOCK_DRIFT].look(side, PACE_SPAN_US * 1e-6)

    def _field_faults(self, attitude: Attitude, place: PlaceField | None) -> tuple[bool, bool]:
        """Whether the field is none of this place, and varies by more than sigma explains."""
        if self._field is None or attitude.sigma_heading_rad > UNKNOWN_HEADING_RAD:
            return False, False
        mean_square = sum(b * b for b in self._field)
        scatter = degrees(sqrt(max(0.0, self._field_square / max(mean_square, 1e-12) - 1.0)))
        sigma = degrees(hypot(attitude.sigma_inclination_rad, attitude.sigma_heading_rad))
        scatters = scatter > SIGMAS * sigma + SCATTER_DEG
        north, east, down = self._field
        horizontal = hypot(north, east)
        if place is None:
            is_possible = WEAKEST_GAUSS <= hypot(horizontal, down) <= STRONGEST_GAUSS
        else:
            most_off = SIGMAS * degrees(attitude.sigma_heading_rad) + HEADING_OFF_DEG
            is_near = abs(self.compass_off_deg or 0.0) <= most_off
            is_possible = is_near and resembles(place, horizontal, down)
        return not is_possible, scatters

    def _compass_off_deg(self, attitude: Attitude, estimator: Estimator) -> float | None:
        """None without a field or a north; a field to the east of north makes it read less."""
        profile, place = estimator.profile, estimator.place_field
        if self._field is None or attitude.heading_reference == "none" or not profile.conditioned:
            return None
        given = profile.reference.declination_deg
        declination_rad = 0.0 if isinstance(given, str) else radians(given)
        if place is not None:
            declination_rad = place.declination_rad
        return round(-off_north_deg(self._field, declination_rad), 2)

    def _is_tilted(self, attitude: Attitude) -> bool:
        """Whether the mean force is far from the vertical, by sigma."""
        assert self._force is not None
        north, east, down = self._force
        tilt = degrees(atan2(hypot(north, east), -down))
        return tilt > SIGMAS * degrees(attitude.sigma_inclination_rad) + TILT_DEG
