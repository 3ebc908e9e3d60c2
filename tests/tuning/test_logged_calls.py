"""Every call that changes an estimator is logged."""

from estimator.estimator import Estimator
from estimator.profile import load_profile
from estimator.types import ZERO_VEC3, ImuSample, VelocitySample
from tuning.calls import LoggedEstimator

ASKED = {
    "aligned",
    "attitude",
    "compass_fault",
    "compass_off_rad",
    "contradicted_axes",
    "fixed_gain",
    "gain_in_words",
    "is_aided",
    "dip_error_rad",
    "place_field",
    "profile",
    "rates",
    "settings",
    "snapshot",
    "unshown_iron_rad",
}
# They call what is logged, or are logged by whoever keeps segments: a profile ends one.
BY_OTHERS = {"update_velocity", "replace_profile"}
# In place of ``update``, for arrays of samples, which nobody retunes on.
OF_ARRAYS = {"take", "update_rows"}


def test_every_change_from_outside_is_logged():
    """A new method of the estimator is overridden in LoggedEstimator, or named here."""
    public = {name for name in vars(Estimator) if not name.startswith("_")}
    logged = {name for name in vars(LoggedEstimator) if not name.startswith("_")}
    assert public - logged == ASKED | BY_OTHERS | OF_ARRAYS


def test_of_samples_without_a_call_between_them_nothing_is_kept():
    """Whoever keeps a call for each keeps 800 bytes for each."""
    recorder = LoggedEstimator(load_profile("imu"))
    for k in range(100):
        if k == 50:
            recorder.update_report(VelocitySample(1000 * k, ZERO_VEC3, True, 0.5))
        recorder.update(ImuSample(1000 * k, ZERO_VEC3, (0.0, 0.0, -9.8), ZERO_VEC3, False))
    assert recorder.taken == 100
    assert [(k, len(calls)) for k, calls in recorder.calls.items()] == [(50, 1)]
