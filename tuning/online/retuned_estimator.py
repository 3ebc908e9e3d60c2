"""An estimator that cuts what it is told into segments, by which a retuner decides."""

from collections.abc import Callable

from estimator.profile import Profile, profile_to_json
from estimator.types import ImuSample
from tuning.logged_calls import Call, LoggedEstimator
from tuning.online.retuner import Decision, Retuner
from tuning.online.segment import LONGEST_GAP_S, SEGMENT_S, Segment


class RetunedEstimator(LoggedEstimator):
    """Retuned on the spot every five seconds of the vehicle's time: for replay.

    With ``on_segment`` segments are handed to that instead. One ends early, and is dropped, when
    somebody replaces the profile.
    """

    def __init__(
        self,
        profile: Profile,
        fixed_gain: float | None = None,
        on_segment: Callable[[Segment], object] | None = None,
        retuner: Retuner | None = None,
    ) -> None:
        super().__init__(profile, fixed_gain)
        self.retuner = Retuner(profile) if retuner is None else retuner
        self.decisions: list[tuple[int, Decision]] = []  # with the vehicle's times, us
        self._on_segment = on_segment or self._decide
        self._gain = fixed_gain
        self._begin()

    def _begin(self) -> None:
        self._start = self.snapshot
        self._told: list[tuple[Call, ...]] = []
        self._samples: list[ImuSample] = []
        self._silent = not self.aligned
        self._waiting.clear()

    def note_restart(self) -> None:
        """See :class:`LoggedEstimator`."""
        self._silent = True

    def note_sample(self, sample: ImuSample, calls: tuple[Call, ...]) -> None:
        """See :class:`LoggedEstimator`."""
        last_us = self._samples[-1].time_us if self._samples else sample.time_us
        self._silent |= sample.time_us - last_us > 1e6 * LONGEST_GAP_S
        self._told.append(calls)
        self._samples.append(sample)
        if sample.time_us - self._samples[0].time_us >= 1e6 * SEGMENT_S:
            told = tuple(self._samples), tuple(self._told)
            segment = Segment(self._start, self.profile, *told, self._silent, self._gain)
            self._begin()
            self._on_segment(segment)

    def replace_profile(self, profile: Profile) -> None:
        """See :class:`Estimator`. Somebody's own profile is the base from now on."""
        if profile_to_json(profile) != profile_to_json(self.retuner.profile):
            self.retuner = Retuner(profile)
        super().replace_profile(profile)
        self._begin()

    def _decide(self, segment: Segment) -> None:
        decision = self.retuner.take(segment)
        if decision is not None:
            self.decisions.append((segment.samples[-1].time_us, decision))
            self.replace_profile(self.retuner.profile)
