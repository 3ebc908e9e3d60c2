"""An estimator that passes on what it is told, so that others can be told the same."""

from collections.abc import Callable
from operator import methodcaller
from typing import Any

from estimator.carrier import Carrier
from estimator.estimator import Estimator
from estimator.reasons import Reason
from estimator.types import ImuSample, Quaternion

Call = Callable[[Estimator], object]


class ToldEstimator(Estimator):
    """Calls :meth:`note` with every change from outside, :meth:`note_sample` with those it took."""

    def note(self, call: Call) -> None:
        """Something else than a sample was told; before it takes effect."""

    def note_sample(self, sample: ImuSample, call: Call) -> None:
        """A sample was taken; behind its effect."""

    def note_restart(self) -> None:
        """The attitude is about to be forgotten."""

    def update(self, sample: ImuSample) -> Reason | None:
        """See :class:`Estimator`."""
        reason = super().update(sample)
        if reason is None:
            self.note_sample(sample, methodcaller("update", sample))
        return reason

    def update_report(self, report: Any) -> Reason | None:
        """See :class:`Estimator`; velocities and rates come this way, too."""
        self.note(methodcaller("update_report", report))
        return super().update_report(report)

    def restart(self) -> None:
        """See :class:`Estimator`."""
        self.note_restart()
        self.note(methodcaller("restart"))
        super().restart()

    def set_position(
        self, latitude_deg: float, longitude_deg: float, altitude_m: float, unix_us: int
    ) -> None:
        """See :class:`Estimator`."""
        place = (latitude_deg, longitude_deg, altitude_m, unix_us)
        self.note(methodcaller("set_position", *place))
        super().set_position(*place)

    def set_field_calibrated(self, calibrated: bool) -> None:
        """See :class:`Estimator`."""
        self.note(methodcaller("set_field_calibrated", calibrated))
        super().set_field_calibrated(calibrated)

    def set_imu_lag(self, gyr_s: float, acc_s: float) -> None:
        """See :class:`Estimator`."""
        self.note(methodcaller("set_imu_lag", gyr_s, acc_s))
        super().set_imu_lag(gyr_s, acc_s)

    def set_carrier(self, carrier: Carrier) -> None:
        """See :class:`Estimator`."""
        self.note(methodcaller("set_carrier", carrier))
        super().set_carrier(carrier)

    def turn(self, turn_ned: Quaternion) -> None:
        """See :class:`Estimator`."""
        self.note(methodcaller("turn", turn_ned))
        super().turn(turn_ned)

    def change_imu(self) -> None:
        """See :class:`Estimator`."""
        self.note(methodcaller("change_imu"))
        super().change_imu()
