"""What an estimator is told, and nothing of it forgotten."""

from estimator.estimator import Estimator
from tuning.told import ToldEstimator

ASKED = {
    "aligned",
    "attitude",
    "compass_doubt",
    "contradicted_axes",
    "fixed_gain",
    "gain_in_words",
    "is_aided",
    "leaning_rad",
    "norths",
    "place_field",
    "profile",
    "rates",
    "settings",
    "snapshot",
    "trusts_compass",
    "unshown_iron_rad",
}
# They call what is told, or are noted by whoever keeps segments: a profile ends one.
BY_OTHERS = {"update_velocity", "replace_profile"}
# In place of ``update``, for arrays of samples, which nobody retunes on.
OF_ARRAYS = {"take", "update_rows"}


def test_every_change_from_outside_is_told():
    """A method that is new in the estimator is to be overridden in ToldEstimator, or named here."""
    public = {name for name in vars(Estimator) if not name.startswith("_")}
    told = {name for name in vars(ToldEstimator) if not name.startswith("_")}
    assert public - told == ASKED | BY_OTHERS | OF_ARRAYS
