"""An estimator that logs its calls, so that others can be given the same."""

from typing import Any, NamedTuple

from estimator.estimator import Estimator
from estimator.profile import Profile
from estimator.reasons import Reason
from estimator.types import ImuSample


class Call(NamedTuple):
    """A method of an estimator, and what it was called with."""

    method: str
    values: tuple[Any, ...] = ()

    def __call__(self, estimator: Estimator) -> None:
        """Call it again."""
        getattr(estimator, self.method)(*self.values)


def _logged(method: str) -> Any:
    """A method of the estimator that is logged before it takes effect."""

    def call(logged: "LoggedEstimator", *values: Any) -> Any:
        logged.log(method, *values)
        return getattr(Estimator, method)(logged, *values)

    return call


class LoggedEstimator(Estimator):
    """Counts the samples it has taken; ``calls[k]`` came between the sample before k and k."""

    def __init__(self, profile: Profile, fixed_gain: float | None = None) -> None:
        super().__init__(profile, fixed_gain)
        self.begin_log()

    def begin_log(self) -> None:
        """Forget what has been logged."""
        self.taken = 0
        self.calls: dict[int, list[Call]] = {}

    def log(self, method: str, *values: Any) -> None:
        """Remember a call before the next sample."""
        self.calls.setdefault(self.taken, []).append(Call(method, values))

    def update(self, sample: ImuSample) -> Reason | None:
        """See :class:`Estimator`."""
        reason = super().update(sample)
        self.taken += reason is None
        return reason

    def set_position(self, *place: Any) -> bool:
        """See :class:`Estimator`; what is no news changes nothing, whatever the numbers."""
        is_news = super().set_position(*place)
        if is_news:
            self.log("set_position", *place)
        return is_news

    update_report = _logged("update_report")  # velocities and rates come this way, too
    restart = _logged("restart")
    set_field_calibrated = _logged("set_field_calibrated")
    set_imu_lag = _logged("set_imu_lag")
    set_vehicle_class = _logged("set_vehicle_class")
    turn = _logged("turn")
    change_imu = _logged("change_imu")
