"""One vehicle as the service sees it: its estimator and everything that is known beside it."""

from collections import Counter

from drivers.events import (
    BodyRates,
    ClockReset,
    Heartbeat,
    Imu,
    Position,
    ReferenceAttitude,
    Rejected,
    Report,
    TrackLost,
    VehicleId,
)
from estimator.estimator import Estimator
from estimator.profile import Profile
from estimator.reasons import Reason
from estimator.types import ImuSample, VelocitySample
from service import health, host_clock
from service.alarms import EstimateChecks
from service.autopilot_comparison import AutopilotComparison
from service.flight_state import FlightState
from service.health import Health, State
from service.host_clock import HostClock
from service.imu_stream import ImuStream, ReportChoices
from service.lines import LineLimit
from service.publishing import Publishing
from service.records import AttitudeRecord, attitude_record, is_finite, vehicle_name
from service.vehicle_parameters import VehicleParameters

# The estimate is checked for not being finite once in so many samples: once it is not, it stays so.
CHECKED_EVERY = 8
# The ages of two messages stamped by one clock differ by less than this.
OTHER_CLOCK_US = 1_000_000
UNSTAMPED = "AHRS2"  # an attitude of the IMU message before it
STANDARD_RATE_HZ = 100.0


class Vehicle:
    """Everything that changes with one vehicle's events and with time.

    Methods return lines for a person: changes of state, of the IMU message, of what contradicts
    the estimate.
    """

    def __init__(
        self,
        address: VehicleId,
        profile: Profile,
        estimator: Estimator,
        rate_hz: float = STANDARD_RATE_HZ,
    ) -> None:
        self.address = address
        self.profile = profile
        self.estimator = estimator
        self.heard_us = 0  # the latest arrival of anything that is a vehicle's own
        self.rejected: Counter[Reason] = Counter()
        self.built_in_motion: str | None = None  # of fuzzbee's own vehicle
        self.imu = ImuStream()
        self.parameters = VehicleParameters()
        self.flight = FlightState()
        self.comparison = AutopilotComparison()
        self.checks = EstimateChecks()
        self.publishing = Publishing(rate_hz)
        self.clock = HostClock()
        self._health = Health()
        self._report_choices = ReportChoices()
        self._limit = LineLimit(f"vehicle {self.name}")

    @property
    def name(self) -> str:
        """The middle part of its keys."""
        return vehicle_name(self.address)

    @property
    def state(self) -> State:
        """The state of health."""
        return self._health.state

    @property
    def samples(self) -> int:
        """Samples that the estimator has taken."""
        return self.imu.samples

    def has_taken(self, event: Imu) -> bool:
        """Whether the estimator took that event last."""
        return self.imu.last is event

    # --- events

    def on_imu(self, event: Imu) -> list[str]:
        """Feed the estimator, if the message is the chosen one."""
        self.heard_us = event.arrival_us
        is_chosen, replaced = self.imu.choose(event)
        if not is_chosen:
            return []
        lines = [] if replaced is None else self._change_message(replaced, event.message)
        sample = self.profile.to_body_axes(event.sample)
        reason = self.estimator.update(sample)
        if reason is not None:
            self.reject(reason)
            return lines
        self.imu.note_taken(event, sample)
        self.clock = host_clock.observe(self.clock, event.sample.time_us, event.arrival_us)
        if self.imu.samples % CHECKED_EVERY == 0:
            lines += self._check(event, sample)
        return lines + self._note_taken(event)

    def on_clock_reset(self, event: ClockReset) -> list[str]:
        """The vehicle's clock began anew: what was known about its time and attitude is void."""
        if event.goes_on:
            return self._lines([f"clock jump by {event.step_s:+.1f} s, cut out"], event.arrival_us)
        self.restart()
        self.clock = HostClock()
        if event.reason == "reboot":
            self.imu.note_reboot(self._health.last_arrival_us)
        text = f"clock {event.reason} by {event.step_s:+.1f} s, aligning anew"
        return self._lines([text], event.arrival_us)

    def on_track_lost(self, event: TrackLost) -> list[str]:
        """The vehicle has turned unseen, nobody knows how far: its attitude is void."""
        if event.message != self.imu.message:
            return []
        self.restart()
        text = f"{event.reason} for {event.blind_s:.1f} s, aligning anew"
        return self._lines([text], event.arrival_us)

    def on_rejected(self, event: Rejected) -> None:
        """Count a refused sample, unless it is of another IMU than the one in use."""
        self.heard_us = event.arrival_us
        if not event.message or self.imu.message in (None, event.message):
            self.reject(event.reason)

    def on_position(self, event: Position) -> None:
        """Tell the estimator where it is, for the declination."""
        self.estimator.set_position(
            event.latitude_deg, event.longitude_deg, event.altitude_m, event.arrival_us
        )

    def on_heartbeat(self, event: Heartbeat) -> None:
        """Note that it is alive, and what carries the IMU if that is new."""
        self.heard_us = event.arrival_us
        self.flight.take(event)
        if not self.parameters.is_repeated(event):
            self.parameters.take_heartbeat(event, self.estimator)

    def on_report(self, event: Report) -> None:
        """Feed the estimator with what something beside the IMU has measured.

        Of several messages that report the same, only with the chosen one.
        """
        sample = event.sample
        if isinstance(event, BodyRates) and self._has_other_clock(event.arrival_us, sample.time_us):
            return
        if not self._report_choices.take(event):
            return
        reason = self.estimator.update_report(sample)
        if reason is not None:
            self.reject(reason)
        elif isinstance(sample, VelocitySample):
            self.comparison.take_velocity(sample)

    def on_reference(self, event: ReferenceAttitude) -> list[str]:
        """Compare the autopilot's attitude with ours of the same instant, some times a second.

        None is compared that is stamped by another clock or more than a sample's interval away.
        """
        last, sample = self.imu.last, self.imu.last_sample
        if event.source != "autopilot" or not self.comparison.opinion.is_due(event.time_us):
            return []
        if last is None or sample is None or self.state not in health.HAS_ATTITUDE:
            return []
        ahead_us = event.time_us - sample.time_us
        late_us = event.arrival_us - last.arrival_us if event.message == UNSTAMPED else 0
        is_near = max(late_us, abs(ahead_us)) <= max(self.imu.median_period_us, 1)
        if not is_near or self._has_other_clock(event.arrival_us, event.time_us):
            return []
        ours = self.estimator.attitude(sample.time_us + max(ahead_us, 0))
        if not is_finite(ours):
            return []
        theirs = self.parameters.view.of_imu(event.message, event.q_ned_frd, ours.q_ned_frd)
        if theirs is None:
            return []
        alarms = self.checks.in_words
        lines = self.comparison.look(
            event,
            theirs,
            ours,
            sample,
            self.estimator.place_field,
            f"of ours, {alarms}" if alarms else "",
        )
        return self._lines(lines, event.arrival_us)

    def on_time(self, now_us: int) -> list[str]:
        """Change the state of health if the IMU has been silent for long."""
        after = health.on_time(self._health, now_us, self.imu.median_period_us)
        return [] if after is self._health else self._become(after, now_us)

    # --- output

    def meets_grid(self, now_us: int) -> bool:
        """Whether the sample that was just taken is the one that the next attitude waits for."""
        is_given = self._health.state in health.HAS_ATTITUDE
        return is_given and self.publishing.grid.meets(now_us, self.imu.median_period_us)

    def schedule(self, now_us: int) -> None:
        """Note when to look at it next, if nothing of it arrives until then."""
        last_us, wake_us = self._health.last_arrival_us, float(self.publishing.status_due_us)
        if last_us is None or self._health.state not in health.HAS_ATTITUDE:
            self.publishing.wake_us = min(wake_us, now_us + health.LATE_MINIMUM_US)
            return
        deadline_us = self.publishing.grid.deadline_us(last_us, self.imu.median_period_us)
        self.publishing.wake_us = min(wake_us, deadline_us)

    def is_left_out(self, now_us: int) -> bool:
        """Whether no sample was taken for long, but some have come."""
        silence_us, median_us = self.silence_us(now_us), self.imu.median_period_us
        is_late = silence_us >= health.late_after_us(median_us)
        return is_late and health.is_left_out(silence_us, now_us - self.heard_us, median_us)

    def attitude(self, now_us: int) -> AttitudeRecord | None:
        """The attitude propagated to ``now_us``, for output only; None if there is none to give."""
        last = self.imu.last
        if last is None or self._health.state not in health.HAS_ATTITUDE:
            return None
        taken_us = last.sample.time_us
        time_us, age_us = host_clock.propagated_to(
            self.clock, taken_us, last.arrival_us, self.imu.median_period_us, now_us
        )
        record = attitude_record(
            self.estimator.attitude(time_us),
            time_unix_us=now_us,
            time_boot_us=last.boot_us + time_us - taken_us,
            state=self._health.state,
            age_us=age_us,
            sequence=self.publishing.attitudes,
        )
        if record is not None:  # if it is not finite, on_imu will restart the estimator
            self.publishing.note_attitude(now_us, self.imu.samples)
            self.schedule(now_us)
        return record

    @property
    def imu_rate_hz(self) -> float:
        """Rate of the IMU message in use, 0 if unknown or silent."""
        is_heard = self.state in (State.ALIGNING, State.RUNNING)
        return self.imu.median_rate_hz if is_heard else 0.0

    def silence_us(self, now_us: int) -> int:
        """How long no sample has arrived."""
        last_us = self._health.last_arrival_us
        return 0 if last_us is None else max(0, now_us - last_us)

    # --- changes

    def reject(self, reason: Reason, count: int = 1) -> None:
        """Count refused samples (or frames, which were not even opened)."""
        self.rejected[reason] += count

    def replace_profile(self, profile: Profile) -> None:
        """Use another profile from the next sample on; the estimate stays.

        If mounting or calibration change, the estimate restarts: it was made of other readings.
        """
        self.estimator.replace_profile(profile)
        self.checks.restart()
        was = self.profile
        if (profile.mounting, profile.calibration) != (was.mounting, was.calibration):
            self.restart()
        self.profile = profile
        self.checks.profile_is_unfit = False

    def on_profile(self, now_us: int, retuned: str | None = None) -> list[str]:
        """Report that the profile was replaced; a program may do it in a loop."""
        what = "new parameters" if retuned is None else f"retuned: {retuned}"
        return self._lines([what], now_us)

    def restart(self) -> None:
        """Align anew; what was remembered of the attitude before says nothing of the next."""
        self.estimator.restart()
        self.checks.restart()
        self.comparison.restart()
        self.imu.last = self.imu.last_sample = None

    def _check(self, event: Imu, sample: ImuSample) -> list[str]:
        """Check that the estimate is finite and, twice a second, that nothing contradicts it."""
        attitude = self.estimator.attitude(sample.time_us)
        if not is_finite(attitude):  # no sample would repair it
            self.reject(Reason.ESTIMATE_NOT_FINITE)
            self.restart()
            text = "the estimate is not finite, aligning anew"
            return self._lines([text], event.arrival_us)
        if not self.estimator.aligned or not self.checks.is_due(sample.time_us):
            return []
        lines, is_doubted = self.checks.look(
            sample, event.arrival_us, attitude, self.profile, self.estimator
        )
        if is_doubted:  # another one does no harm, and each second with this one does
            self.imu.doubt()
        return self._lines(lines, event.arrival_us)

    def _note_taken(self, event: Imu) -> list[str]:
        """A sample shows that the vehicle is alive."""
        after = health.on_sample(self._health, event.arrival_us, aligned=self.estimator.aligned)
        if after.state is self._health.state:
            self._health = after
            return []
        return self._become(after, event.arrival_us)

    def _change_message(self, before: str, now: str) -> list[str]:
        if not before:
            return [f"vehicle {self.name}: IMU data from {now}"]
        self.estimator.change_imu()
        return [f"vehicle {self.name}: IMU data from {now} now, {before} is given up"]

    def _has_other_clock(self, arrival_us: int, time_us: int) -> bool:
        """Whether a message's clock is another than the IMU's, or there is no IMU yet.

        Some autopilots stamp ATTITUDE seconds off; its rates are then those of another time.
        """
        last = self.imu.last
        if last is None:
            return True
        age_us = arrival_us - time_us
        return abs(age_us - (last.arrival_us - last.sample.time_us)) > OTHER_CLOCK_US

    def _become(self, after: Health, now_us: int) -> list[str]:
        before, self._health = self._health.state, after
        if after.state is before or after.state is State.ALIGNING:
            return []  # alignment takes a sample or two: only its end is news
        return self._lines([str(after.state)], now_us)

    def _lines(self, texts: list[str], now_us: int) -> list[str]:
        """Lines about this vehicle, fewer of them where there are too many."""
        if not texts:
            return []
        return self._limit.lines([f"vehicle {self.name}: {text}" for text in texts], now_us)
