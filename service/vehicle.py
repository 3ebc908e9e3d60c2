"""One vehicle as the service sees it: its estimator and everything that is known beside it."""

from collections import Counter

from drivers import events
from estimator.estimator import Estimator
from estimator.profile import Profile
from estimator.reasons import Reason
from estimator.types import ImuSample, Quaternion, VelocitySample
from service.alarms import Alarms
from service.evidence import OtherImus
from service.lines import LineLimit
from service.publishing import HostClock, Publishing, attitude_record, is_finite
from service.records import HAS_ATTITUDE, AttitudeRecord, State, vehicle_name
from service.second_opinion import Look, SecondOpinion
from service.stream_state import LATE_MINIMUM_US, ImuStream
from service.vehicle_parameters import VehicleParameters

# The estimate is checked for not being finite once in so many samples: once it is not, it stays so.
CHECKED_EVERY = 8
UNSTAMPED = "AHRS2"  # an attitude of the IMU message before it
STANDARD_RATE_HZ = 100.0


class Vehicle:
    """Everything that changes with one vehicle's events and with time.

    Methods return lines for a person: changes of state, of the IMU message, of what contradicts
    the estimate.
    """

    def __init__(
        self,
        address: events.VehicleId,
        estimator: Estimator,
        rate_hz: float = STANDARD_RATE_HZ,
        number: int = 0,
    ) -> None:
        self.address = address
        self.name = vehicle_name(address)  # the middle part of its keys
        self.estimator = estimator
        self.last_arrival_us = 0  # the latest arrival of anything that is a vehicle's own
        self.silent_looks = 0  # of the pipeline since then
        self.rejected: Counter[Reason] = Counter()
        self.peers: dict[str, Quaternion] = {}  # others' attitudes, until ours is published
        self.built_in_motion: str | None = None  # of fuzzbee's own vehicle
        self.imu = ImuStream()
        self.others = OtherImus()
        self.parameters = VehicleParameters()
        self.comparison = SecondOpinion()
        self.alarms = Alarms()
        self.publishing = Publishing(rate_hz, number)
        self._limit = LineLimit(f"vehicle {self.name}")

    @property
    def profile(self) -> Profile:
        """The parameters in use."""
        return self.estimator.profile

    @property
    def state(self) -> State:
        """The state of health."""
        return self.imu.state

    # --- events

    def on_imu(self, event: events.Imu) -> list[str]:
        """Feed the estimator, if the message is the chosen one."""
        self.last_arrival_us = event.arrival_us
        before = self.imu.message
        if not self.imu.choose(event):
            _, gyr, acc, *_ = event.sample
            other = events.OtherImu(event.vehicle, event.arrival_us, event.message, gyr, acc)
            self.others.take(other, self.imu.last)
            return []
        lines = [] if before == event.message else self._change_message(before, event.message)
        sample = self.profile.to_body_axes(event.sample)
        reason = self.estimator.update(sample)
        if reason is not None:
            self.rejected[reason] += 1
            return lines
        self.imu.note_taken(event, sample)
        self.publishing.clock.observe(event.sample.time_us, event.arrival_us)
        if self.imu.samples % CHECKED_EVERY == 0:
            lines += self._check(event, sample)
        self.imu.last_arrival_us = event.arrival_us
        state = State.RUNNING if self.estimator.aligned else State.ALIGNING
        return lines + self._become(state, event.arrival_us)

    def take(self, event: events.VehicleEvent) -> list[str]:
        """Take whatever else it has sent, or was noticed of it."""
        if isinstance(event, (events.Heartbeat, events.Rejected, events.Shed)):
            self.last_arrival_us = event.arrival_us
        match event:
            case events.Position(latitude_deg=latitude_deg, longitude_deg=longitude_deg):
                height_m, now_us = event.altitude_m, event.arrival_us
                self.estimator.set_position(latitude_deg, longitude_deg, height_m, now_us)
            case events.Heartbeat():
                self.parameters.take_heartbeat(event, self.estimator)
            case events.OtherImu():
                self.others.take(event, self.imu.last)
            case events.ModeChange():
                self.parameters.take_mode(event)
            case events.FilterStatus():
                self.comparison.filter_status = event
            case events.Parameter():
                self.parameters.take(event, self.estimator)
            case events.Rejected():
                if not event.message or self.imu.message in (None, event.message):
                    self.rejected[event.reason] += 1
            case events.Shed():
                self.imu.note_shed(event)
            case events.TrackLost() if event.message == self.imu.message:
                self.restart()
                lasted = f"{event.reason} for {event.blind_s:.1f} s"
                return self.lines(event.arrival_us, f"{lasted}, aligning anew")
            case events.ClockReset():
                return self._on_clock_reset(event)
        return []

    def _on_clock_reset(self, event: events.ClockReset) -> list[str]:
        """The vehicle's clock began anew: what was known about its time and attitude is void."""
        now_us, step = event.arrival_us, f"by {event.step_s:+.1f} s"
        if event.goes_on:
            return self.lines(now_us, f"clock jump {step}, cut out")
        self.restart()
        self.publishing.clock = HostClock()
        if event.reason == "reboot":
            self.imu.note_reboot()
        return self.lines(now_us, f"clock {event.reason} {step}, aligning anew")

    def on_report(self, event: events.Report) -> None:
        """Feed the estimator with what something beside the IMU has measured.

        Of several messages that report the same, only with the chosen one.
        """
        sample = event.sample
        is_rates = isinstance(event, events.BodyRates)
        is_of_other_clock = is_rates and self.imu.has_other_clock(event.arrival_us, sample.time_us)
        if is_of_other_clock or not self.imu.uses(event):
            return
        reason = self.estimator.update_report(sample)
        if reason is not None:
            self.rejected[reason] += 1
        elif isinstance(sample, VelocitySample):
            self.comparison.velocities.append((sample.time_us, sample.velocity_ned_m_s))

    def on_reference(self, event: events.ReferenceAttitude) -> list[str]:
        """Compare the autopilot's attitude with ours of the same instant, some times a second.

        None is compared that is stamped by another clock or more than a sample's interval away.
        """
        last, sample = self.imu.last, self.imu.last_sample
        if event.source != "autopilot" or not self.comparison.is_due(event.time_us):
            return []
        if last is None or sample is None or self.state not in HAS_ATTITUDE:
            return []
        ahead_us = event.time_us - sample.time_us
        late_us = event.arrival_us - last.arrival_us if event.message == UNSTAMPED else 0
        is_near = max(late_us, abs(ahead_us)) <= max(self.imu.median_period_us, 1)
        if not is_near or self.imu.has_other_clock(event.arrival_us, event.time_us):
            return []
        ours = self.estimator.attitude(event.time_us)
        theirs = self.parameters.view.of_imu(event.message, event.q_ned_frd, ours.q_ned_frd)
        if theirs is None or not is_finite(ours):
            return []
        alarms = " and ".join(sorted(each.meaning for each in self.alarms.words))
        against_ours = f"of ours, {alarms}" if alarms else ""
        faults = self.comparison.autopilots_fault(event.arrival_us), against_ours
        both, place = (theirs, ours), self.estimator.place_field
        look = Look(event.time_us, event.message, *both, sample, place, faults)
        return self.lines(event.arrival_us, *self.comparison.compare(look))

    def on_time(self, now_us: int) -> list[str]:
        """Change the state of health if the IMU has been silent for long."""
        return self._become(self.imu.state_at(now_us), now_us)

    # --- output

    def schedule(self, now_us: int) -> None:
        """Note when to look at it next, if nothing of it arrives until then."""
        last_us, due_us = self.imu.last_arrival_us, float(now_us + LATE_MINIMUM_US)
        if last_us is not None and self.imu.state in HAS_ATTITUDE:
            due_us = self.publishing.deadline_us(last_us, self.imu.median_period_us)
        self.publishing.wake_us = min(self.publishing.status_due_us, due_us)

    def is_left_out(self, now_us: int) -> bool:
        """Whether no sample was taken for long, but some have come."""
        late_us, silence_us = self.imu.late_after_us, self.imu.silence_us(now_us)
        is_there = now_us - self.last_arrival_us < late_us
        return is_there and late_us <= silence_us < self.imu.lost_after_us

    def attitude(self, now_us: int) -> AttitudeRecord | None:
        """The attitude propagated to ``now_us``, for output only; None if there is none to give."""
        last, state = self.imu.last, self.imu.state
        if last is None or state not in HAS_ATTITUDE:
            return None
        taken_us = last.sample.time_us
        time_us, age_us = self.publishing.clock.propagated_to(
            taken_us, last.arrival_us, self.imu.median_period_us, now_us
        )
        record = attitude_record(
            self.estimator.attitude(time_us),
            time_unix_us=now_us,
            time_boot_us=last.boot_us + time_us - taken_us,
            state=state,
            age_us=age_us,
            sequence=self.publishing.attitudes,
        )
        if record is not None:  # if it is not finite, on_imu will restart the estimator
            self.publishing.note_attitude(now_us, self.imu.samples)
            self.schedule(now_us)
        return record

    # --- changes

    def replace_profile(self, profile: Profile) -> None:
        """Use another profile from the next sample on; the estimate stays.

        If mounting or calibration change, the estimate restarts: it was made of other readings.
        """
        was = self.profile
        self.estimator.replace_profile(profile)
        self.alarms.restart()
        if (profile.mounting, profile.calibration) != (was.mounting, was.calibration):
            self.restart()
        self.alarms.profile_is_unfit = False

    def restart(self) -> None:
        """Align anew; what was remembered of the attitude before does not hold for the next."""
        self.estimator.restart()
        self.alarms.restart()
        self.comparison.restart()
        self.imu.last = self.imu.last_sample = None

    def _check(self, event: events.Imu, sample: ImuSample) -> list[str]:
        """Check that the estimate is finite and, twice a second, that nothing contradicts it."""
        attitude = self.estimator.attitude(sample.time_us)
        if not is_finite(attitude):  # no sample would repair it
            self.rejected[Reason.ESTIMATE_NOT_FINITE] += 1
            self.restart()
            return self.lines(event.arrival_us, "the estimate is not finite, aligning anew")
        if not self.estimator.aligned or not self.alarms.is_due(sample.time_us):
            return []
        lines = self.alarms.look(sample, event.arrival_us, attitude, self.estimator)
        if any(self.estimator.contradicted_axes):  # each second with this IMU does harm
            self.imu.choice.contradicted.add(event.message)
        return self.lines(event.arrival_us, *lines)

    def _change_message(self, before: str | None, now: str) -> list[str]:
        if before is None:
            return [f"vehicle {self.name}: IMU data from {now}"]
        self.estimator.change_imu()
        self.others = OtherImus()
        return [f"vehicle {self.name}: IMU data from {now} now, {before} is given up"]

    def _become(self, state: State, now_us: int) -> list[str]:
        # alignment takes a sample or two: only its end is news
        is_news = state not in (self.imu.state, State.ALIGNING)
        self.imu.state = state
        return self.lines(now_us, str(state)) if is_news else []

    def lines(self, now_us: int, *texts: str) -> list[str]:
        """Lines about this vehicle, fewer of them where there are too many."""
        return self._limit.lines([f"vehicle {self.name}: {text}" for text in texts], now_us)
