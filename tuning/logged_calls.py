"""An estimator that logs its calls, so that others can be given the same."""

from collections.abc import Callable
from operator import methodcaller
from typing import Any

from estimator.estimator import Estimator
from estimator.profile import Profile
from estimator.reasons import Reason
from estimator.types import ImuSample

Call = Callable[[Estimator], object]


def _logged(name: str) -> Any:
    """A method of the estimator that is logged before it takes effect."""

    def method(logged: "LoggedEstimator", *values: Any, **named: Any) -> Any:
        logged._waiting.append(methodcaller(name, *values, **named))  # noqa: SLF001 - its method
        return getattr(Estimator, name)(logged, *values, **named)

    return method


class LoggedEstimator(Estimator):
    """Calls :meth:`note_sample` with every sample it took, and the calls since the last."""

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

    def set_position(self, *place: Any) -> bool:
        """See :class:`Estimator`; what is no news changes nothing, whatever the numbers."""
        is_news = super().set_position(*place)
        if is_news:
            self._waiting.append(methodcaller("set_position", *place))
        return is_news

    def restart(self) -> None:
        """See :class:`Estimator`."""
        self.note_restart()
        self._waiting.append(methodcaller("restart"))
        super().restart()

    update_report = _logged("update_report")  # velocities and rates come this way, too
    set_field_calibrated = _logged("set_field_calibrated")
    set_imu_lag = _logged("set_imu_lag")
    set_vehicle_class = _logged("set_vehicle_class")
    turn = _logged("turn")
    change_imu = _logged("change_imu")
