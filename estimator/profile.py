"""The profile: all parameters of the estimator, as one strict TOML file.

Unknown keys are errors, in files as in partial updates. A file without memberships changes ``imu``,
or ``paper`` if it switches conditioning off. Three profiles ship: ``paper`` (the paper's system
exactly), ``imu`` (real IMUs) and ``adaptive`` (the paper's vectors with a gain that knows their
noise).
"""

import math
import re
import tomllib
from collections.abc import Mapping
from difflib import get_close_matches
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import numpy as np
from msgspec import Meta, Struct

from estimator.aiding.types import AidingParams
from estimator.bounds import require_within
from estimator.calibration import Calibration, Mounting
from estimator.conditioning.params import ConditioningParams
from estimator.errors import InputError, file_text
from estimator.filter import memberships
from estimator.types import Floats, ImuSample, Vec3

SHIPPED = ("paper", "imu", "adaptive")
# The parser's time and memory grow with the square of a key's parts
TOO_DEEP = re.compile(r"(?<![\w\"'-])(?:[\w\"'-]++[ \t]*+\.[ \t]*+){32}")

# Bounds of what several parameters share; estimator/bounds.py has them for the other sections.
LEAST_GAIN, MOST_GAIN = 1e-2, 1e4
Weight = Annotated[float, Meta(ge=0.0, le=1e3)]
Element = Annotated[float, Meta(ge=-1e3, le=1e3)]
Row = tuple[Element, Element, Element]
Declination = Annotated[float, Meta(ge=-180.0, le=180.0)]


class Reference(Struct, frozen=True, forbid_unknown_fields=True):
    """Inertial directions in NED.

    ``magnetic = "learn"`` takes only the horizontal part of the field, which points north, and
    learns its norm and dip. ``declination_deg`` turns magnetic north to true north, east positive;
    ``"position"`` takes it from the first position. A number counts as known, also 0.
    """

    gravity: Vec3 = (0.0, 0.0, 1.0)
    magnetic: Vec3 | Literal["learn"] = "learn"
    declination_deg: Declination | Literal["position"] = "position"


class Filter(Struct, frozen=True, forbid_unknown_fields=True):
    """The paper's filter; see :class:`estimator.filter.types.FilterParams`.

    ``gain`` sets K: "fuzzy", the paper's controller; "noise", rules in noise floors
    (:mod:`estimator.filter.noise_gain`); "fixed", ``fixed_gain``. ``initial_attitude`` is "align"
    (from the first vectors) or the nine numbers of R_hat(0), row after row, which are projected
    onto SO(3).
    """

    gain: Literal["fuzzy", "noise", "fixed"] = "fuzzy"
    fixed_gain: Annotated[float, Meta(ge=LEAST_GAIN, le=MOST_GAIN)] = 20.0
    gamma: Annotated[float, Meta(ge=0.0, le=1e3)] = 1.0
    rate_time_constant_s: Annotated[float, Meta(ge=1e-3, le=1e3)] = 0.3
    bias_bound_rad_s: Annotated[float, Meta(ge=0.0, le=100.0)] = 2.0
    euler_step_max_s: Annotated[float, Meta(ge=0.0, le=0.01)] = 0.01
    first_step_s: Annotated[float, Meta(ge=0.0, le=0.01)] = 0.0
    initial_attitude: Literal["align"] | tuple[Row, Row, Row] = "align"


class Confidence(Struct, frozen=True, forbid_unknown_fields=True):
    """The paper's s_i: of gravity, the magnetic field and their cross product."""

    gravity: Weight = 1.0
    magnetic: Weight = 1.0
    cross: Weight = 1.0


class Provenance(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """What determines the numbers; nothing about where, when or how fast."""

    description: str = ""
    version: str = ""
    options: dict[str, Any] = {}
    inputs: list[dict[str, str]] = []
    seeds: dict[str, Any] = {}


class Profile(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A whole profile; its sections in the order in which they are written.

    ``membership`` holds k1..k22. ``conditioning`` holds ``enabled`` (False: raw vectors, as in the
    paper) and fields of :class:`estimator.conditioning.params.ConditioningParams`, ``aiding`` those
    of :class:`estimator.aiding.types.AidingParams`. ``rates`` decides whether the body rates of
    ATTITUDE show the turning between IMU samples; its angles are never used.
    """

    reference: Reference = Reference()
    filter: Filter = Filter()
    membership: dict[str, float]
    confidence: Confidence = Confidence()
    conditioning: dict[str, float | bool]
    aiding: dict[str, float | bool] = {}
    mounting: Mounting = Mounting()
    calibration: Calibration = Calibration()
    rates: Literal["imu", "imu+attitude"] = "imu+attitude"
    provenance: Provenance = Provenance()

    @property
    def has_plain_imu(self) -> bool:
        """Whether readings are taken as they are."""
        return self.calibration.is_plain and self.mounting.has_body_axes

    def to_body_axes(self, sample: ImuSample) -> ImuSample:
        """A sample of the sensor, calibrated, as the body would have it."""
        if self.has_plain_imu:
            return sample
        gyr, acc, mag = self._applied(sample.gyr_rad_s, sample.acc_m_s2, sample.mag_gauss)
        return sample._replace(gyr_rad_s=gyr, acc_m_s2=acc, mag_gauss=mag)

    def to_body_rows(self, gyr: Floats, acc: Floats, mag: Floats) -> tuple[Floats, Floats, Floats]:
        """Readings (N, 3) of the sensor, calibrated, as the body would have them."""
        if self.has_plain_imu:
            return gyr, acc, mag
        gyr, acc, mag = map(np.column_stack, self._applied(gyr.T, acc.T, mag.T))
        return gyr, acc, mag

    def _applied(self, gyr: Any, acc: Any, mag: Any) -> tuple[Any, Any, Any]:
        return self.mounting.applied(*self.calibration.applied(gyr, acc, mag))

    @property
    def k(self) -> memberships.Memberships:
        """k1..k22 in order."""
        return tuple(self.membership[name] for name in memberships.NAMES)

    @property
    def conditioned(self) -> bool:
        """Whether the conditioning stage stands before the filter."""
        return bool(self.conditioning["enabled"])


def load_profile(name_or_path: str | Path) -> Profile:
    """A shipped profile by its name, or one from a TOML file.

    Raises:
        InputError: no such name or file, or anything wrong in it.
    """
    if not isinstance(name_or_path, str | Path):
        raise InputError(f"profile {name_or_path!s:.60}: must be a name or a file")
    name_or_path = str(name_or_path)
    if name_or_path in SHIPPED:
        return _shipped(name_or_path)
    try:
        text = file_text(Path(name_or_path), f"profile {name_or_path}")
    except FileNotFoundError:
        raise InputError(
            f"profile {name_or_path!r}: no such file, and not one of {', '.join(SHIPPED)}"
        ) from None
    return parse_profile(text.replace("\r\n", "\n"), name_or_path)


@cache
def _shipped(name: str) -> Profile:
    """Read once: a vehicle that is met while others fly must not cost them a file to be parsed."""
    resource = resources.files("estimator").joinpath("profiles", f"{name}.toml")
    return parse_profile(resource.read_text("utf-8"), name)


def parse_profile(text: str, where: str) -> Profile:
    """A profile from TOML text, whole or without memberships; ``where`` names it in errors.

    Raises:
        InputError: not TOML, unknown keys, wrong types, values out of bounds.
    """
    try:
        tree = None if TOO_DEEP.search(text) else tomllib.loads(text)
    except ValueError as error:  # TOMLDecodeError, or a number of thousands of digits
        raise InputError(f"profile {where}: not TOML: {error}") from None
    except RecursionError:
        tree = None
    if tree is None:
        raise InputError(f"profile {where}: nested too deep")
    if not tree:
        raise InputError(f"profile {where}: is empty")
    return _from_tree(tree if "membership" in tree else _completed(tree), where)


def _completed(tree: Mapping[str, Any]) -> dict[str, Any]:
    """A file without memberships changes a shipped profile: that of its kind of vectors."""
    conditioning = tree.get("conditioning")
    is_raw = isinstance(conditioning, Mapping) and conditioning.get("enabled") is False
    base = load_profile("paper" if is_raw else "imu")
    return _merged(base, {"provenance": {}, **tree})


def _merged(base: Profile, partial: Mapping[str, Any]) -> dict[str, Any]:
    tree = profile_to_json(base)
    for section, values in partial.items():
        is_section = isinstance(values, Mapping) and isinstance(tree.get(section), dict)
        if is_section and section != "provenance":
            tree[section] = {**tree[section], **values}
        else:
            tree[section] = values
    return tree


def merge_profile(base: Profile, partial: Mapping[str, Any]) -> Profile:
    """``base`` with the keys of ``partial`` (sections of keys) replaced.

    Raises:
        InputError: unknown keys, wrong types, values out of bounds.
    """
    return _from_tree(_merged(base, partial), "update")


def profile_to_json(profile: Profile) -> dict[str, Any]:
    """The profile as plain dictionaries, lists and numbers, every default written out."""
    tree: dict[str, Any] = msgspec.to_builtins(profile)
    for section, defaults in DEFAULTS.items():
        tree[section] = {**defaults, **tree[section]}
    return tree


def profile_to_toml(profile: Profile) -> str:
    """The profile as TOML text that :func:`parse_profile` reads back to an equal profile."""
    import tomli_w

    tree = profile_to_json(profile)
    tree["conditioning"] = profile.conditioning  # a default left out stays out
    tree["aiding"] = profile.aiding
    return tomli_w.dumps(tree)


DEFAULTS: dict[str, dict[str, float | bool]] = {
    "conditioning": {"enabled": True, **ConditioningParams._field_defaults},
    "aiding": AidingParams._field_defaults,
}


def _from_tree(tree: Mapping[str, Any], where: str) -> Profile:
    try:
        _require_finite(tree, "")
        profile = msgspec.convert(tree, Profile)
        k = _complete_membership(profile.membership)
        memberships.require_feasible(k)
        profile = msgspec.structs.replace(
            profile, membership=dict(zip(memberships.NAMES, k, strict=True))
        )
        _require_numbers("conditioning", profile.conditioning, ConditioningParams)
        _require_numbers("aiding", profile.aiding, AidingParams)
        _require_directions(profile)
    except (msgspec.ValidationError, InputError) as error:
        raise InputError(f"profile {where}: {_in_toml_s_words(str(error))}") from None
    except RecursionError:
        raise InputError(f"profile {where}: nested too deep") from None
    return profile


def _in_toml_s_words(text: str) -> str:
    """The decoder's message in the words of the file that it read."""
    text = text.replace("Object contains unknown field", "unknown key")
    unknown = re.match(r"unknown key [`'](\w+)", text)
    if unknown:
        sections = profile_to_json(load_profile("imu")).values()
        keys = {key for section in sections if isinstance(section, dict) for key in section}
        alike = get_close_matches(unknown[1], keys, 1)
        text += f" (did you mean '{alike[0]}'?)" if alike else ""
    text = text.replace("Expected `object`", "expected a section of keys")
    return text.replace("`$.", "`").replace("`", "'")


def _require_finite(node: object, name: str) -> None:
    if isinstance(node, Mapping):
        for key, value in node.items():
            _require_finite(value, f"{name}.{key}" if name else str(key))
    elif isinstance(node, list | tuple):
        for value in node:
            _require_finite(value, name)
    elif isinstance(node, float) and not math.isfinite(node):
        raise InputError(f"{name}: {node} is not a finite number")


def _complete_membership(given: Mapping[str, float]) -> memberships.Memberships:
    _require_known("membership", given, memberships.NAMES)
    missing = [name for name in memberships.NAMES if name not in given]
    if missing:
        raise InputError(f"membership.{missing[0]} is missing")
    return tuple(given[name] for name in memberships.NAMES)


def _require_numbers(section: str, given: Mapping[str, float | bool], kind: type) -> None:
    """Switches are true or false; numbers are numbers, within the bounds that ``kind`` declares."""
    _require_known(section, given, DEFAULTS[section])
    if "enabled" not in given and section == "conditioning":
        raise InputError(
            "conditioning.enabled is missing (true: for real IMUs, false: the paper's raw vectors)"
        )
    for key, value in given.items():
        default = DEFAULTS[section][key]
        if isinstance(default, bool) != isinstance(value, bool):
            expected = "true or false" if isinstance(default, bool) else "a number"
            raise InputError(f"{section}.{key}: {value!r} should be {expected}")
    require_within(section, given, kind)


def _require_directions(profile: Profile) -> None:
    for name in ("gravity", "magnetic"):
        direction = getattr(profile.reference, name)
        if direction != "learn" and not 1e-6 <= math.hypot(*direction) <= 1e6:
            raise InputError(f"reference.{name}: a direction needs a length between 1e-6 and 1e6")
    if not profile.conditioned and profile.reference.magnetic == "learn":
        raise InputError("reference.magnetic: 'learn' needs conditioning.enabled = true")


def _require_known(section: str, given: Mapping[str, Any], known: object) -> None:
    for key in given:
        if key not in known:  # type: ignore[operator]
            raise InputError(f"unknown key {section}.{key}")
