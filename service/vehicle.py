"""One vehicle as the service sees it: its estimator, clock, health and counts."""

from collections import Counter, deque
from math import degrees, pi, sqrt
from typing import Any

from drivers.events import (
    BodyRates,
    ClockReset,
    FilterWord,
    Heartbeat,
    Imu,
    Parameter,
    Position,
    ReferenceAttitude,
    Rejected,
    Report,
    Shed,
    TrackLost,
    VehicleId,
)
from drivers.mavlink.ardupilot import (
    ACC_FILTER,
    COMPASS_OFFSETS,
    GYRO_FILTER,
    ROVER_FILTERS_HZ,
    TRIM,
)
from drivers.mavlink.constants import (
    MAV_AUTOPILOT_ARDUPILOTMEGA,
    MAV_TYPE_GENERIC,
    MAV_TYPE_GROUND_ROVER,
)
from drivers.mavlink.usual_kinds import (
    ATTITUDE_NAME,
    KIND_NAMES,
    KIND_OF,
    OTHER_NAMES,
    OTHER_OF,
    RECEIVER,
)
from drivers.samples.rotation import quaternion_from_euler
from estimator.carrier import Carrier
from estimator.estimator import Estimator
from estimator.geometry.quaternion import multiply
from estimator.profile import Profile
from estimator.reasons import Reason
from estimator.types import IDENTITY, ImuSample, RateSample, VelocitySample
from service import health, host_clock, imu_choice, report_choice
from service.alarms import LEANING_DEG, MEANINGS, Alarm, Alarms
from service.attitude_record import attitude_record, euler_deg, is_finite
from service.attitude_rows import sample_of
from service.health import Health, State
from service.host_clock import HostClock, Offsets
from service.imu_choice import ImuChoice
from service.intervals import CHECKED_EVERY, MEDIAN_EVERY, OTHER_CLOCK_US, PERIODS_KEPT
from service.load import Load, Losses
from service.records import AttitudeRecord, Autopilot, Retuned, StatusRecord, vehicle_name
from service.report_choice import Kind, ReportChoice, kind_of
from service.second_opinion import Doubts, SecondOpinion, Verdict, in_words, turned_back
from service.showing import is_due, shown_at
from service.talk import Talk
from service.usual_columns import (
    ARRIVAL,
    ATTITUDES,
    CHOSEN_US,
    HEARD,
    LOOK_US,
    PERIODS,
    RATES_US,
    STRIDE_US,
    VELOCITY,
    WINDOW,
)

# What its filter says of itself, once a second or so, holds until it says something else.
WORD_HOLDS_US = 5_000_000
FILTER_VELOCITY: Kind = (VelocitySample, False)
RECEIVER_VELOCITY: Kind = (VelocitySample, True)
RECEIVER_NAME = OTHER_NAMES[RECEIVER]
UNSTAMPED = "AHRS2"  # an attitude of the IMU message before it
# A second-order Butterworth low-pass delays slow motions by this many periods of its cutoff.
BUTTERWORTH_DELAY = 1.0 / (sqrt(2.0) * pi)


def carrier_of(heartbeat: Heartbeat) -> Carrier:
    """What carries the IMU: anything may be done to a vehicle that is not armed."""
    if heartbeat.vehicle_type == MAV_TYPE_GROUND_ROVER:
        return Carrier.WHEELS
    is_vehicle = heartbeat.is_armed and heartbeat.vehicle_type != MAV_TYPE_GENERIC
    return Carrier.VEHICLE if is_vehicle else Carrier.ANYTHING


class Vehicle:
    """Everything that changes with one vehicle's events and with time.

    Methods return lines for a person: changes of state and of the IMU message.
    """

    def __init__(self, address: VehicleId, profile: Profile, estimator: Estimator) -> None:
        self.address = address
        self.name = vehicle_name(address)
        self.profile = profile
        self.estimator = estimator
        self.samples = 0
        self.attitudes = 0
        self.heard_us = 0  # the latest arrival of anything that is a vehicle's own
        self._shed = 0  # samples left out of the message in use, as newer ones were there already
        self._shed_before: Counter[str] = Counter()  # of each message, until one is in use
        self.rejected: Counter[Reason] = Counter()
        self.worst_gap_us = 0
        self.built_in_motion: str | None = None  # of fuzzbee's own vehicle
        self.has_unfit_profile = False  # by the vehicle's own word
        self._alarms = Alarms()
        self._alarms_told: frozenset[Alarm] = frozenset()
        self._compass_told: set[str] = set()
        self.second_opinion = SecondOpinion()
        self._differed = False  # at the last look
        self._filter_word: FilterWord | None = None
        self._trim_rad: dict[str, float] = {}
        self._beat: Heartbeat | None = None  # the last one that said something new
        self._statuses = 0
        self._retuned: Retuned | None = None
        self._health = Health()
        self._choice = ImuChoice()
        self._report_choices: dict[Kind, ReportChoice] = {}
        self._compass_offsets: dict[str, float] = {}
        self._filters_hz: dict[str, float] = {}
        self._clock = HostClock()
        self._periods_us: deque[int] = deque(maxlen=PERIODS_KEPT)
        self._median_us: float | None = None
        self._last: Imu | None = None  # as the vehicle sent it
        self._last_sample: ImuSample | None = None  # as it is mounted
        self._published_samples = -1  # of the last attitude
        self._published_us = 0
        self._status_us: int | None = None
        self._attitudes_then = 0  # at the last status
        self._talk = Talk(f"vehicle {self.name}")  # limits lines that others can trigger at will
        # the last arrival before a reboot, until the first sample after it
        self._silent_since_us: int | None = None

    @property
    def state(self) -> State:
        """The state of health."""
        return self._health.state

    @property
    def last_sample(self) -> ImuSample | None:
        """The sample that the estimator took last."""
        return None if self._last is None else self._last_sample

    @property
    def shed(self) -> int:
        """Samples left out of the message in use; before there is one, the most of any."""
        return self._shed + max(self._shed_before.values(), default=0)

    def has_taken(self, event: Imu) -> bool:
        """Whether the estimator took that event last."""
        return self._last is event

    @property
    def imu_message(self) -> str | None:
        """The IMU message in use."""
        return self._choice.message

    @property
    def median_period_us(self) -> float:
        """Median interval of the IMU message in use on the vehicle's clock; 0 if unknown."""
        if self._median_us is None:
            periods = sorted(self._periods_us)
            self._median_us = float(periods[len(periods) // 2]) if periods else 0.0
        return self._median_us

    def on_imu(self, event: Imu) -> list[str]:
        """Feed the estimator, if the message is the chosen one."""
        self.heard_us = event.arrival_us
        before, period_us = self._choice.message, self.median_period_us
        late_us = health.late_after_us(period_us)
        self._choice = imu_choice.consider(
            self._choice, event.message, event.arrival_us, late_us, period_us
        )
        if self._choice.message != event.message:
            return []
        texts = [] if before == event.message else self._change_over(before, event.message)
        sample = self.profile.mounting.to_body_axes(event.sample)
        reason = self.estimator.update(sample)
        if reason is not None:
            self.reject(reason)
            return texts
        self._measure(event)
        self._last_sample = sample
        if self.samples % CHECKED_EVERY == 0:
            texts += self._check(event, sample)
        return texts + self._note_taken(event)

    @property
    def next_look_us(self) -> int:
        """When to look for what contradicts the attitude, by the vehicle's clock."""
        return self._alarms.next_us

    def check(self, event: Imu) -> list[str]:
        """Check the estimate behind a sample that others have had it take."""
        return self._check(event, event.sample) + self._note_taken(event)

    def give_up(self, event: Imu) -> list[str]:
        """Judge the estimate behind a sample that has made it doubtful, which others took."""
        self.estimator.give_up()
        is_due = self.samples % CHECKED_EVERY == 0
        return self.check(event) if is_due else self._note_taken(event)

    def _note_taken(self, event: Imu) -> list[str]:
        """A sample shows that the vehicle is alive."""
        before_it = self._health
        after = health.on_sample(before_it, event.arrival_us, aligned=self.estimator.aligned)
        if after.state is before_it.state:
            self._health = after
            return []
        return self._become(after, event.arrival_us)

    def on_clock_reset(self, event: ClockReset) -> list[str]:
        """The vehicle's clock began anew: what was known about its time and attitude is void."""
        self.restart()
        self._clock = HostClock()
        if event.reason == "reboot":
            self._choice = imu_choice.trust_all(self._choice)
            self._silent_since_us = self._health.last_arrival_us
        text = f"clock {event.reason} by {event.step_s:+.1f} s, aligning anew"
        return self._say([text], event.arrival_us)

    def on_track_lost(self, event: TrackLost) -> list[str]:
        """The vehicle has turned unseen, nobody knows how far: its attitude is void."""
        if event.message != self.imu_message:
            return []
        self.restart()
        return self._say(
            [f"{event.reason} for {event.blind_s:.1f} s, aligning anew"], event.arrival_us
        )

    def on_rejected(self, event: Rejected) -> None:
        """Count a refused sample, unless it is of another IMU than the one in use."""
        self.heard_us = event.arrival_us
        if not event.message or self.imu_message in (None, event.message):
            self.reject(event.reason)

    def on_shed(self, event: Shed) -> None:
        """Count samples that were left out of the stream in use, or of one that may become it."""
        if self.imu_message is None:
            self._shed_before[event.message] += event.samples
        elif self.imu_message == event.message:
            self._shed += event.samples

    def on_position(self, event: Position) -> None:
        """Tell the estimator where it is, for the declination."""
        self.estimator.set_position(
            event.latitude_deg, event.longitude_deg, event.altitude_m, event.arrival_us
        )

    def on_parameter(self, event: Parameter) -> None:
        """Note COMPASS_OFS, all zero where nobody has calibrated, the trim, the IMU's filters."""
        if event.name in TRIM:
            self._trim_rad[event.name] = event.value
        if event.name in (GYRO_FILTER, ACC_FILTER) and event.value > 0.0:
            self._note_filter(event.name, event.value)
        if event.name not in COMPASS_OFFSETS:
            return
        self._compass_offsets[event.name] = event.value
        if len(self._compass_offsets) == len(COMPASS_OFFSETS):
            self.estimator.set_field_calibrated(any(self._compass_offsets.values()))

    def has_said(self, event: Heartbeat) -> bool:
        """Whether a heartbeat is the one before once more."""
        known = self._beat
        return (
            known is not None
            and known.autopilot == event.autopilot
            and known.vehicle_type == event.vehicle_type
            and known.is_armed == event.is_armed
        )

    def on_heartbeat(self, event: Heartbeat) -> None:
        """Note what carries the IMU, and the filters that ArduPilot gives such a vehicle."""
        self.heard_us = event.arrival_us
        self._beat = event
        carrier = carrier_of(event)
        self.estimator.set_carrier(carrier)
        if carrier is Carrier.WHEELS and event.autopilot == MAV_AUTOPILOT_ARDUPILOTMEGA:
            for name, cutoff_hz in ROVER_FILTERS_HZ.items():
                self._note_filter(name, self._filters_hz.get(name, cutoff_hz))

    def _note_filter(self, name: str, cutoff_hz: float) -> None:
        """Tell the estimator what low-passes delay; heard again it takes back nothing learnt."""
        known = self._filters_hz
        if known.get(name) == cutoff_hz:
            return
        known[name] = cutoff_hz
        gyr_hz = known.get(GYRO_FILTER)
        if gyr_hz is not None:
            acc_hz = known.get(ACC_FILTER, gyr_hz)
            self.estimator.set_imu_lag(BUTTERWORTH_DELAY / gyr_hz, BUTTERWORTH_DELAY / acc_hz)

    def on_report(self, event: Report) -> None:
        """Feed the estimator with what something beside the IMU has measured.

        Of several messages that report the same, only with the chosen one.
        """
        is_rates = isinstance(event, BodyRates)
        if is_rates and self._has_other_clock(event.arrival_us, event.sample.time_us):
            return
        kind = kind_of(event)
        before = self._report_choices.get(kind, ReportChoice())
        choice = report_choice.consider(before, event.message, event.arrival_us)
        self._report_choices[kind] = choice
        if choice.message != event.message:
            return
        reason = self.estimator.update_report(event.sample)
        if reason is not None:
            self.reject(reason)
        elif isinstance(event.sample, VelocitySample):
            self.hear_velocity(event.sample)

    def hear_velocity(self, sample: VelocitySample) -> None:
        """Tell whoever compares our attitude with the autopilot's."""
        self.second_opinion.hear_velocity(sample.time_us, sample.velocity_ned_m_s)

    def on_filter_word(self, event: FilterWord) -> None:
        """Note what the autopilot's filter says of itself."""
        self._filter_word = event

    def on_reference(self, event: ReferenceAttitude) -> list[str]:
        """Compare the autopilot's attitude with ours of the same instant, some times a second.

        None is compared that is stamped by another clock or more than a sample's interval away.
        """
        last, sample, opinion = self._last, self._last_sample, self.second_opinion
        if event.source != "autopilot" or not opinion.is_due(event.time_us):
            return []
        if last is None or sample is None or self.state not in health.HAS_ATTITUDE:
            return []
        ahead_us = event.time_us - sample.time_us
        other_clock = self._has_other_clock(event.arrival_us, event.time_us)
        late_us = event.arrival_us - last.arrival_us if event.message == UNSTAMPED else 0
        if other_clock or max(late_us, abs(ahead_us)) > max(self.median_period_us, 1):
            return []
        ours = self.estimator.attitude(sample.time_us + max(ahead_us, 0))
        if not is_finite(ours):
            return []
        roll, pitch, yaw = (self._trim_rad.get(name, 0.0) for name in TRIM)
        theirs = multiply(event.q_ned_frd, quaternion_from_euler(roll, pitch, yaw) or IDENTITY)
        ours = turned_back(ours, 1e-6 * max(-ahead_us, 0))
        place = self.estimator.place_field
        doubts = self._doubts(event.arrival_us)
        opinion.look(event.time_us, event.message, theirs, ours, sample, place, doubts)
        return self._tell_opinion(event)

    def _doubts(self, now_us: int) -> Doubts:
        """What the autopilot's filter says against itself, and our alarms against ours."""
        word, against = self._filter_word, ""
        if word is not None and abs(now_us - word.arrival_us) <= WORD_HOLDS_US:
            if not word.status.has_attitude:
                against = "its own filter calls it not good"
            elif max(word.status.velocity_ratio, word.status.compass_ratio) > 1.0:
                against = "its own filter refuses velocity or compass"
        alarms = sorted(MEANINGS[each] for each in self._alarms.words)
        return Doubts(against, f"of ours, {' and '.join(alarms)}" if alarms else "")

    def _tell_opinion(self, event: ReferenceAttitude) -> list[str]:
        """One line when the two attitudes begin to differ, and one when that ends."""
        said = self.second_opinion.opinion
        differs = said is not None and said.verdict is Verdict.DIFFERS
        before, self._differed = self._differed, differs
        if said is None or differs == before:
            return []
        text = (
            in_words(said, event.time_us) if differs else "the autopilot's attitude and ours agree"
        )
        return self._say([text], event.arrival_us)

    def _has_other_clock(self, arrival_us: int, time_us: int) -> bool:
        """Whether a message's clock is another than the IMU's, or there is no IMU yet.

        Some autopilots stamp ATTITUDE seconds off; its rates are then those of another time.
        """
        last = self._last
        if last is None:
            return True
        age_us = arrival_us - time_us
        return abs(age_us - (last.arrival_us - last.sample.time_us)) > OTHER_CLOCK_US

    def is_left_out(self, now_us: int) -> bool:
        """Whether no sample was taken for long, but some have come."""
        silence_us, median_us = self._silence_us(now_us), self.median_period_us
        is_late = silence_us >= health.late_after_us(median_us)
        return is_late and health.is_left_out(silence_us, now_us - self.heard_us, median_us)

    def on_time(self, now_us: int) -> list[str]:
        """Change the state of health if the IMU has been silent for long."""
        after = health.on_time(self._health, now_us, self.median_period_us)
        return [] if after is self._health else self._become(after, now_us)

    def is_due(self, now_us: int) -> bool:
        """Whether there is a new sample to publish an attitude of, or none for long."""
        return is_due(self.samples != self._published_samples, now_us - self._published_us)

    def attitude(self, now_us: int) -> AttitudeRecord | None:
        """The attitude propagated to ``now_us``, for output only; None if there is none to give."""
        last = self._last
        if last is None or self.state not in health.HAS_ATTITUDE:
            return None
        last_us = (last.sample.time_us, last.arrival_us)
        time_us, age_us = shown_at(self._clock, last_us, self.median_period_us, now_us)
        record = attitude_record(
            self.estimator.attitude(time_us),
            time_unix_us=now_us,
            time_boot_us=last.boot_us + time_us - last.sample.time_us,
            state=self.state,
            age_us=age_us,
            sequence=self.attitudes,
        )
        if record is None:
            return None  # a tick changes nothing; on_imu will restart the estimator
        self.attitudes += 1
        self._published_samples, self._published_us = self.samples, now_us
        return record

    def status(
        self,
        now_us: int,
        load: Load,
        losses: Losses = Losses(),  # noqa: B008 - immutable
        malformed: int = 0,
    ) -> StatusRecord:
        """The vehicle's status at ``now_us``; a silence that still lasts counts as a gap, too."""
        words = set(self._alarms.words)
        if self.has_unfit_profile:
            words.add(Alarm.PROFILE_UNFIT)
        autopilot = self._autopilot(now_us)
        if autopilot is not None and autopilot.verdict == Verdict.DIFFERS:
            words.add(Alarm.AUTOPILOT_DIFFERS)
        record = StatusRecord(
            state=self.state.value,
            imu_message=self.imu_message,
            imu_rate_hz=self.imu_rate_hz,
            worst_gap_s=max(self.worst_gap_us, self._silence_us(now_us)) / 1e6,
            rejected=dict(sorted(self.rejected.items())),
            overruns=losses.overruns,
            dropped=losses.dropped,
            sequence=self._statuses,
            rates=self.estimator.rates,
            gain=self.estimator.gain_in_words,
            overloaded=load.is_shedding,
            shed=self.shed,
            lost=losses.lost,
            published_hz=self._published_hz(now_us, load),
            malformed=malformed,
            warnings=tuple(sorted(words)),
            retuned=self._retuned,
            autopilot=autopilot,
            recording=losses.recording,
        )
        self._statuses += 1
        return record

    def _autopilot(self, now_us: int) -> Autopilot | None:
        """What is said of the autopilot's attitude beside ours; None if it sends none."""
        time_us = host_clock.to_vehicle_us(self._clock, now_us) if self._last is not None else 0
        self.second_opinion.forget(time_us)
        said = self.second_opinion.opinion
        if said is None:
            return None
        angles = zip(euler_deg(said.theirs), euler_deg(said.ours), strict=True)
        turned = [round((a - b + 180.0) % 360.0 - 180.0, 2) for a, b in angles]
        return Autopilot(
            verdict=said.verdict.value,
            message=said.message,
            for_s=max(0.0, round(1e-6 * (time_us - said.since_us), 1)),
            inclination_deg=round(said.inclination.off_deg, 2),
            heading_deg=round(said.heading.off_deg, 2),
            inclination_sigmas=round(said.inclination.sigmas, 1),
            heading_sigmas=round(said.heading.sigmas, 1),
            wrong=said.wrong,
            evidence=said.evidence,
            axis=said.axis,
            roll_deg=turned[0],
            pitch_deg=turned[1],
        )

    def _published_hz(self, now_us: int, load: Load) -> float:
        """Attitudes a second: as the loop says, or counted since the last status."""
        since_us = None if self._status_us is None else now_us - self._status_us
        count = self.attitudes - self._attitudes_then
        self._status_us, self._attitudes_then = now_us, self.attitudes
        if not load.is_shedding or since_us is None or since_us <= 0:
            return load.rate_hz
        return min(load.rate_hz, round(1e6 * count / since_us, 1))

    @property
    def counts(self) -> dict[str, Any]:
        """What was counted so far, as the result of a run has it."""
        return {
            "state": self.state.value,
            "motion": self.built_in_motion,
            "imu_message": self.imu_message,
            "imu_rate_hz": round(self.median_rate_hz, 3),
            "worst_gap_s": self.worst_gap_us / 1e6,
            "samples": self.samples,
            "shed": self.shed,
            "attitudes": self.attitudes,
            "rejected": dict(sorted(self.rejected.items())),
        }

    def numbers(self) -> tuple[list[int], list[float]] | None:
        """What changes while samples just go on; None if something else is to be expected.

        In the columns of :mod:`service.usual_columns`.
        """
        last, choice, clock = self._last, self._choice, self._clock
        chosen, rival = KIND_OF.get(choice.message or "", 0), KIND_OF.get(choice.rival or "", 0)
        is_alone = choice.rival is None or rival > chosen
        if last is None or not (self.just_goes_on and chosen and is_alone):
            return None
        rates = self._report_choices.get((RateSample, False), ReportChoice(ATTITUDE_NAME, -1))
        velocity = self._report_choices.get(FILTER_VELOCITY, ReportChoice())
        receiver = self._report_choices.get(RECEIVER_VELOCITY, ReportChoice(RECEIVER_NAME, -1))
        velocity_kind = OTHER_OF.get(velocity.message or "", 0)
        names = (rates.message, receiver.message)
        if names != (ATTITUDE_NAME, RECEIVER_NAME) or (velocity.message and not velocity_kind):
            return None
        sample, window, even, periods = last.sample, clock.window, clock.even, self._periods_us
        whole = [
            *(self.heard_us, chosen, choice.last_arrival_us, choice.longest_silence_us),
            *(rival, choice.rival_samples, choice.rival_since_us, choice.rival_arrival_us),
            *(rates.last_arrival_us, self.profile.uses_attitude_rates),
            *(velocity_kind, velocity.last_arrival_us),
            *(receiver.last_arrival_us, self.second_opinion.stride_us),
            *(last.arrival_us, sample.time_us, last.boot_us, sample.has_mag),
            *(self.samples, self.worst_gap_us, self._alarms.next_us),
            *(self.attitudes, self._published_samples, self._published_us, clock.at_us),
            *(window.begin_us, window.samples, even.begin_us, even.samples),
            *(int(self.median_period_us), len(periods), len(periods) % PERIODS_KEPT),
            *periods,
            *[0] * (PERIODS_KEPT - len(periods)),
        ]
        spans = (window.least_us, window.most_us, even.least_us, even.most_us)
        reading = (*sample.gyr_rad_s, *sample.acc_m_s2, *sample.mag_gauss)
        return whole, [clock.offset_us, *spans, *reading]

    @property
    def just_goes_on(self) -> bool:
        """Whether nothing else is to be expected than samples of the message in use."""
        last, choice = self._last, self._choice
        if last is None or last.message != choice.message or choice.doubted:
            return False
        is_running = self._health.state is State.RUNNING and self._silent_since_us is None
        return is_running and self.profile.mounting.is_plain

    def know(self, whole: list[int], numbers: list[float]) -> None:
        """Know what others ask for of :meth:`numbers`; what the next sample does is left out."""
        self.heard_us = whole[HEARD]
        arrival_us, time_us, boot_us, has_mag, *counts = whole[ARRIVAL:LOOK_US]
        self.samples, self.worst_gap_us = counts
        self.attitudes, self._published_samples, self._published_us, at_us = whole[ATTITUDES:WINDOW]
        window_us, window, even_us, even, median_us = whole[WINDOW:PERIODS]
        self._median_us = float(median_us)
        offset_us, least_us, most_us, even_least_us, even_most_us, *reading = numbers
        self._clock = HostClock(
            offset_us,
            at_us,
            True,
            Offsets(window_us, least_us, most_us, window),
            Offsets(even_us, even_least_us, even_most_us, even),
        )
        sample = sample_of(time_us, reading, has_mag)
        self._last = Imu(self.address, arrival_us, boot_us, self._choice.message or "", sample)
        self._last_sample = sample
        self._health = Health(State.RUNNING, arrival_us)

    def resume(self, whole: list[int]) -> None:
        """Go on from :meth:`numbers`, of which the rest is known."""
        choice, (n, at, *periods) = self._choice, whole[PERIODS:]
        chosen_us, longest_us, rival, count, since_us, rival_us = whole[CHOSEN_US:RATES_US]
        velocity_kind, velocity_us, receiver_us = whole[VELOCITY:STRIDE_US]
        rivals = (KIND_NAMES.get(rival), count, since_us, rival_us)
        own = (choice.message, chosen_us, longest_us, choice.has_failed)
        self._choice = ImuChoice(*own, *rivals, choice.doubted)
        if whole[RATES_US] >= 0:
            self._report_choices[RateSample, False] = ReportChoice(ATTITUDE_NAME, whole[RATES_US])
        if receiver_us >= 0:
            self._report_choices[RECEIVER_VELOCITY] = ReportChoice(RECEIVER_NAME, receiver_us)
        if velocity_kind:
            name_of_velocity = OTHER_NAMES[velocity_kind]
            self._report_choices[FILTER_VELOCITY] = ReportChoice(name_of_velocity, velocity_us)
        self._periods_us.clear()
        self._periods_us.extend(periods[:n] if n < PERIODS_KEPT else periods[at:] + periods[:at])

    @property
    def imu_rate_hz(self) -> float:
        """Rate of the IMU message in use, 0 if unknown or silent."""
        return self.median_rate_hz if self.state in (State.ALIGNING, State.RUNNING) else 0.0

    @property
    def median_rate_hz(self) -> float:
        """Rate of the IMU message in use while it came, 0 if unknown."""
        return 1e6 / self.median_period_us if self.median_period_us > 0.0 else 0.0

    def reject(self, reason: Reason, count: int = 1) -> None:
        """Count refused samples (or frames, which were not even opened)."""
        self.rejected[reason] += count

    def replace_profile(self, profile: Profile) -> None:
        """Use another profile from the next sample on; the estimate stays.

        If the mounting changes, the estimate restarts: it was the attitude of other axes.
        """
        self.estimator.replace_profile(profile)
        self._alarms = Alarms()
        if profile.mounting != self.profile.mounting:
            self.restart()
        self.profile = profile
        self.has_unfit_profile = False

    def note_retuned(self, summary: str) -> None:
        """Count a change that the service has made by itself."""
        count = 0 if self._retuned is None else self._retuned.count
        self._retuned = Retuned(count + 1, summary)

    def on_profile(self, now_us: int, retuned: str | None = None) -> list[str]:
        """Say that the profile was replaced, but not too often: a program may do it in a loop."""
        what = "new parameters" if retuned is None else f"retuned: {retuned}"
        return self._say([what], now_us)

    def restart(self) -> None:
        """Align anew; what was remembered of the attitude before says nothing of the next."""
        self.estimator.restart()
        self._alarms = Alarms()
        self.second_opinion.restart()
        self._last = None

    def _check(self, event: Imu, sample: ImuSample) -> list[str]:
        """Check that the estimate is finite and, twice a second, that nothing contradicts it."""
        attitude = self.estimator.attitude(sample.time_us)
        if not is_finite(attitude):
            return self._align_broken_anew(event)
        if not self.estimator.aligned or not self._alarms.is_due(sample.time_us):
            return []
        place = self.estimator.place_field
        # what contradicts the vertical is in sigma, and costs more to ask for
        is_sure = degrees(attitude.sigma_inclination_rad) < LEANING_DEG
        leaning_rad = 0.0 if is_sure else self.estimator.leaning_rad
        axes = self.estimator.contradicted_axes
        arrival_us, profile = event.arrival_us, self.profile
        self._alarms.look(sample, arrival_us, attitude, profile, place, leaning_rad, axes)
        if any(axes):  # another one does no harm, and each second with this one does
            self._choice = imu_choice.doubt(self._choice)
        return self._tell_compass(event.arrival_us) + self._tell_alarms(event.arrival_us)

    def _tell_compass(self, now_us: int) -> list[str]:
        """Why the heading's sigma is 45 degrees, once for each reason."""
        why = self.estimator.compass_doubt
        if not why or why in self._compass_told:
            return []
        self._compass_told.add(why)
        return self._say([f"heading ±45° until velocity shows it: {why}"], now_us)

    def _tell_alarms(self, now_us: int) -> list[str]:
        """The alarms that have begun or ended since they were told last."""
        before, now = self._alarms_told, self._alarms.words
        if now == before:
            return []
        self._alarms_told = now
        begun = [f"warning: {MEANINGS[word]}" for word in sorted(now - before)]
        ended = [f"no more: {MEANINGS[word]}" for word in sorted(before - now)]
        return self._say([*begun, *ended], now_us)

    def _align_broken_anew(self, event: Imu) -> list[str]:
        """Restart an estimate that is not finite: no sample would repair it."""
        self.reject(Reason.ESTIMATE_NOT_FINITE)
        self.restart()
        return self._say(["the estimate is not finite, aligning anew"], event.arrival_us)

    def _say(self, texts: list[str], now_us: int) -> list[str]:
        """Lines about this vehicle, fewer of them where there are too many."""
        return self._talk.lines([f"vehicle {self.name}: {text}" for text in texts], now_us)

    def _change_over(self, before: str | None, now: str) -> list[str]:
        self._periods_us.clear()
        self._median_us = None
        if before is None:
            self._shed += self._shed_before[now]
            self._shed_before.clear()
            return [f"vehicle {self.name}: IMU data from {now}"]
        self.estimator.change_imu()
        return [f"vehicle {self.name}: IMU data from {now} now, {before} is given up"]

    def _measure(self, event: Imu) -> None:
        """Measure interval, gap, clock offset. By the vehicle's clock: arrivals come in bursts."""
        if self._silent_since_us is not None:
            silence_us = event.arrival_us - self._silent_since_us
            self.worst_gap_us = max(self.worst_gap_us, silence_us)
            self._silent_since_us = None
        if self._last is not None:
            period_us = event.sample.time_us - self._last.sample.time_us
            self.worst_gap_us = max(self.worst_gap_us, period_us)
            if event.message == self._last.message:
                self._periods_us.append(period_us)
                # a median of 51 changes little in 8 samples, and costs as much as the filter
                if len(self._periods_us) < PERIODS_KEPT or self.samples % MEDIAN_EVERY == 0:
                    self._median_us = None
        self._clock = host_clock.observe(self._clock, event.sample.time_us, event.arrival_us)
        self._last = event
        self.samples += 1

    def _silence_us(self, now_us: int) -> int:
        last_us = self._health.last_arrival_us
        return 0 if last_us is None else max(0, now_us - last_us)

    def _become(self, after: Health, now_us: int) -> list[str]:
        before = self._health.state
        self._health = after
        if after.state is before or after.state is State.ALIGNING:
            return []  # alignment takes a sample or two: only its end is news
        return self._say([str(after.state)], now_us)
