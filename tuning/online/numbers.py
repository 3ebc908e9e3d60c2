"""The few numbers that are retuned, as factors on the base profile's."""

import numpy as np

from estimator.arrays import Floats
from estimator.profile import Profile, merge_profile, profile_to_json
from tuning.space import Space

# In all, and in one move.
MOST_FACTOR = 30.0
MOST_MOVE = 3.0

# Keys of a profile (section, key, power) that are multiplied by powers of one factor, by its name.
Numbers = dict[str, tuple[tuple[str, str, float], ...]]

# With raw vectors the confidences scale the gain, floor and all. How they share it out is
# not searched: what the vectors' own biases do is in no prediction.
RAW: Numbers = {
    "gain": tuple(("confidence", key, 1.0) for key in ("gravity", "magnetic", "cross")),
    "gamma": (("filter", "gamma", 1.0),),
}
CONDITIONED: Numbers = {
    "gyroscope": (("aiding", "gyr_slow_noise_1_s", 1.0),),
    "accelerometer": (("aiding", "acc_noise", 1.0),),
    "gravity time": (("conditioning", "gravity_tau_s", 1.0),),
    "heading": (("aiding", "heading_noise", 1.0), ("conditioning", "heading_noise_rad2_s", 2.0)),
}


def numbers_of(base: Profile) -> Numbers:
    """The numbers of a profile that are retuned, but for zeros, which have no factor."""
    tree = profile_to_json(base)
    chosen = CONDITIONED if base.conditioned else RAW
    return {
        name: keys
        for name, keys in chosen.items()
        if all(tree[section][key] > 0.0 for section, key, _ in keys)
    }


def update_of(base: Profile, factors: Floats) -> dict[str, dict[str, float]]:
    """The partial profile that ``factors`` (D,) on the base's numbers mean."""
    tree = profile_to_json(base)
    update: dict[str, dict[str, float]] = {}
    for keys, factor in zip(numbers_of(base).values(), factors.tolist(), strict=True):
        for section, key, power in keys:
            update.setdefault(section, {})[key] = tree[section][key] * factor**power
    return update


def with_factors(base: Profile, factors: Floats) -> Profile:
    """The base with its numbers changed by ``factors`` (D,)."""
    return merge_profile(base, update_of(base, factors))


def space_around(base: Profile, factors: Floats) -> Space:
    """What can be reached in one move from ``factors`` (D,), by their logarithm."""
    names = tuple(numbers_of(base))
    low = np.maximum(factors / MOST_MOVE, 1.0 / MOST_FACTOR)
    high = np.minimum(factors * MOST_MOVE, MOST_FACTOR)
    return Space(names, tuple(low.tolist()), tuple(high.tolist()), logarithmic=(True,) * len(names))
