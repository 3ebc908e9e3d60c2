"""An estimator that passes on what it is told, so that others can be told the same."""

from collections.abc import Callable
from operator import methodcaller
from typing import Any

from estimator.estimator import Estimator
from estimator.profile import Profile
from estimator.reasons import Reason
from estimator.types import ImuSample

Call = Callable[[Estimator], object]


def _noted(name: str) -> Any:
    """A method of the estimator that is noted before it takes effect."""

    def method(told: "ToldEstimator", *values: Any, **named: Any) -> Any:
        told._waiting.append(methodcaller(name, *values, **named))  # noqa: SLF001 - its method
        return getattr(Estimator, name)(told, *values, **named)

    return method


class ToldEstimator(Estimator):
    """Calls :meth:`note_sample` with every sample it took, and what it was told since the last."""

    def __init__(self, profile: Profile, fixed_gain: float | None = None) -> None:
        super().__init__(profile, fixed_gain)
        self._waiting: list[Call] = []

    def note_sample(self, sample: ImuSample, calls: tuple[Call, ...]) -> None:
        """A sample was taken, behind these calls and before this one."""

    def note_restart(self) -> None:
        """The attitude is about to be forgotten."""

    def update(self, sample: ImuSample) -> Reason | None:
        """See :class:`Estimator`."""
        reason = super().update(sample)
        if reason is None:
            calls = tuple(self._waiting)
            self._waiting.clear()
            self.note_sample(sample, calls)
        return reason

    def restart(self) -> None:
        """See :class:`Estimator`."""
        self.note_restart()
        self._waiting.append(methodcaller("restart"))
        super().restart()

    update_report = _noted("update_report")  # velocities and rates come this way, too
    set_position = _noted("set_position")
    set_field_calibrated = _noted("set_field_calibrated")
    set_imu_lag = _noted("set_imu_lag")
    set_vehicle_class = _noted("set_vehicle_class")
    turn = _noted("turn")
    change_imu = _noted("change_imu")
