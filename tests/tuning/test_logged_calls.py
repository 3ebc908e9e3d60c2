"""Every call that changes an estimator is logged."""

from estimator.estimator import Estimator
from tuning.logged_calls import LoggedEstimator

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
    "trusts_compass",
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
