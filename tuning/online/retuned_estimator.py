"""An estimator that cuts what it is given into segments, by which a retuner decides."""

from collections.abc import Callable

from estimator.profile import Profile, profile_to_json
from estimator.reasons import Reason
from estimator.types import ImuSample
from tuning.logged_calls import LoggedEstimator
from tuning.online.retuner import Decision, Retuner
from tuning.online.segment import SEGMENT_S, Segment


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

    def begin_log(self) -> None:
        """See :class:`LoggedEstimator`: a segment begins."""
        super().begin_log()
        self._before = self.snapshot
        self._samples: list[ImuSample] = []

    def update(self, sample: ImuSample) -> Reason | None:
        """See :class:`Estimator`."""
        reason = super().update(sample)
        if reason is None:
            self._samples.append(sample)
            if sample.time_us - self._samples[0].time_us >= 1e6 * SEGMENT_S:
                now = self._before, self.profile, tuple(self._samples), self.calls
                segment = Segment(*now, self.fixed_gain)
                self.begin_log()
                self._on_segment(segment)
        return reason

    def replace_profile(self, profile: Profile) -> None:
        """See :class:`Estimator`. Somebody's own profile is the base from now on."""
        if profile_to_json(profile) != profile_to_json(self.retuner.profile):
            self.retuner = Retuner(profile)
        super().replace_profile(profile)
        self.begin_log()

    def _decide(self, segment: Segment) -> None:
        decision = self.retuner.take(segment)
        if decision is not None:
            self.decisions.append((segment.samples[-1].time_us, decision))
            self.replace_profile(self.retuner.profile)
