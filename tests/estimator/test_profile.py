"""Profiles are strict: what is wrong is named in one line, what is right comes back unchanged."""

import os
from math import cos, radians, sin
from pathlib import Path

import numpy as np
import pytest
from msgspec import structs

from estimator.errors import InputError
from estimator.estimator import Estimator
from estimator.filter.memberships import LOWER, NAMES, UPPER, midpoint, require_feasible
from estimator.geometry.earth import PlaceField
from estimator.geometry.quaternion import exp, multiply, normalized_distance
from estimator.live.settings import settings_of
from estimator.profile import (
    SHIPPED,
    Provenance,
    load_profile,
    merge_profile,
    parse_profile,
    profile_to_json,
    profile_to_toml,
)
from estimator.types import IDENTITY, ZERO_VEC3, ImuSample
from tests.vocabulary import assert_attitude_close, random_memberships

MEMBERSHIP = "[membership]\n" + "".join(
    f"{name} = {value!r}\n" for name, value in zip(NAMES, midpoint(), strict=True)
)
SMALLEST = f"[conditioning]\nenabled = true\n{MEMBERSHIP}"


def refused(text, *words):
    """The text is refused with one line that names the file and all words."""
    with pytest.raises(InputError) as caught:
        parse_profile(text, "flight.toml")
    message = str(caught.value)
    assert "\n" not in message
    assert "`" not in message
    for word in ("profile flight.toml: ", *words):
        assert word in message, message


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_profiles_survive_being_written(name):
    profile = load_profile(name)
    assert parse_profile(profile_to_toml(profile), "again") == profile


def test_paper_profile_is_the_papers_system():
    paper = load_profile("paper")
    chosen = settings_of(paper)
    assert not chosen.conditioned
    assert paper.filter.gamma == 1.0
    assert structs.astuple(paper.confidence) == (1,) * 3
    assert chosen.reference.magnetic_ned == pytest.approx(np.array([1.0, -1.0, 1.0]) / np.sqrt(3.0))
    assert chosen.reference.gravity_ned == (0.0, 0.0, 1.0)
    assert normalized_distance(IDENTITY, chosen.initial) == pytest.approx(0.9997, abs=5e-5)
    assert chosen.filter.rate_time_constant_s == 0.3
    assert not chosen.filter.gain_is_fixed


def test_smallest_profile_has_the_documented_defaults():
    profile = parse_profile(SMALLEST, "smallest")
    assert profile.reference.magnetic == "learn"
    assert profile.filter.initial_attitude == "align"
    assert profile.k == midpoint()


# What is wrong is named: an unknown key at any level, a wrong type or value
STRUCTS = ("reference", "filter", "confidence", "aiding", "mounting", "calibration", "provenance")
# a number, and what it cannot be
WRONG = {
    "filter.gamma": ("'one'", "true", "-1.0", "nan", "inf"),
    "filter.rate_time_constant_s": ("0.0",),
    "filter.euler_step_max_s": ("0.02",),
    "filter.initial_attitude": ("'guess'", "[[1, 0, 0]]", "[[1, 0, 0], [0, 1, 0], [0, 0, nan]]"),
    "reference.gravity": ("[0, 0]", "'down'", "[0, 0, 0]", "[0, 0, 1e-300]", "[0, 0, 1e300]"),
    "reference.magnetic": ("[0.0, 0.0, -inf]", "[0, 0, 0]", "'learnt'"),
    "reference.declination_deg": ("181.0", '"unknown"', '"learn"', '""'),
    "confidence.gravity": ("-0.1",),
    "confidence.cross": ("'none'",),
    "provenance.description": ("3",),
    "mounting.rotation_deg": ("[0, 0]", "[0, 0, 181]", "[0, nan, 0]", "90"),
    "mounting.acc_sign": ("0", "2"),
    "calibration.mag_offset_gauss": ("[11, 0, 0]",),
    "calibration.acc_bias_m_s2": ("[1, 2]",),
}
# what stands in the smallest profile, what stands there instead, and the word
CHANGED = [
    *(("k1 = 0.075", f"k1 = {x}", "membership.k1") for x in (0.16, -0.01, "nan")),  # out of bounds
    *(("k1 = 0.075", f"k1 = {x}", "membership") for x in ("'small'", "false")),
    ("k1 = 0.075\n", "", "membership.k1 is missing"),
    ("k12 = 7.5", "k12 = 15.1", "membership.k12"),
    ("k2 = 0.1\n", "k2 = 0.15\n", "k2 <= k3"),  # in bounds, but out of order
    ("k20 = 45.0", "k20 = 70.0", "k20 <= k21"),
    ("enabled = true", "enabled = 1", "conditioning.enabled"),
    ("enabled = true", "enabled = 'yes'", "conditioning"),
    ("enabled = true", "", "conditioning.enabled is missing"),
    *(
        ("enabled = true", f"enabled = true\ngravity_tau_s = {x}", "conditioning.gravity_tau_s")
        for x in ("0.0", "nan", "true")
    ),
    ("enabled = true", "enabled = true\nuse_rest = 1.0", "conditioning.use_rest"),
    ("enabled = true", "enabled = false", "reference.magnetic"),  # "learn" needs conditioning
]
BOMBS = (
    "a = " + "[" * 50_000 + "]" * 50_000,
    "[" + ".".join("a" * 1 for _ in range(50_000)) + "]",
    "a" + " . a" * 50_000 + " = 1",
    "a = " + "{a=" * 50_000,
    "[filter]\ngamma = " + "9" * 5000,
    "[filter]\ngamma = 1" + "0" * 400,
)
REFUSED = [
    *((f"{text}\n{SMALLEST}",) for text in BOMBS),
    *((f"{SMALLEST}[{each}]\nsurprise = 1\n", "unknown", each, "surprise") for each in STRUCTS),
    (SMALLEST + "[surprise]\nx = 1\n", "unknown", "surprise"),
    ("surprise = 1\n" + SMALLEST, "unknown", "surprise"),
    (SMALLEST + "k23 = 1.0\n", "unknown", "membership.k23"),
    (SMALLEST.replace("true", "true\nrest = 1.0"), "unknown", "conditioning.rest"),
    *(
        (SMALLEST + "[{}]\n{} = {}\n".format(*name.split("."), value), name)
        for name, values in WRONG.items()
        for value in values
    ),
    *((SMALLEST.replace(old, new, 1), word) for old, new, word in CHANGED),
    (SMALLEST + "filter = 3\n", "membership"),  # within [membership], where the text ends
    (SMALLEST + "[calibration]\ngyr_matrix = [[1, 0, 0], [0, 1, 0], [0, 0, 0]]\n", "gyr_matrix"),
    (MEMBERSHIP, "conditioning"),
    *((text, "is empty") for text in ("", "# [mounting]\n")),
    *((text, "not TOML") for text in ("[filter", "a = = 1", "k1 = 0.1\nk1 = 0.2", "\x00")),
]


@pytest.mark.parametrize("words", REFUSED)
def test_what_is_wrong_is_refused_by_name(words):
    refused(*words)


@pytest.mark.parametrize("base", ["imu", "paper"])
def test_a_file_without_memberships_changes_a_shipped_profile(base):
    """The shipped profile of the same kind of vectors sets every key that the file leaves out."""
    enabled = "true" if base == "imu" else "false"
    text = f"[conditioning]\nenabled = {enabled}\n[filter]\nfixed_gain = 7.0\n"
    changed = parse_profile(text, "x")
    expected = load_profile(base)
    assert changed.filter == structs.replace(expected.filter, fixed_gain=7.0)
    for section in ("membership", "confidence", "reference", "mounting", "rates"):
        assert getattr(changed, section) == getattr(expected, section)
    assert changed.provenance == Provenance()  # nobody has tuned this one
    only = parse_profile("[mounting]\nrotation_deg = [0, 0, 90]\n", "x")
    assert only.filter == load_profile("imu").filter
    assert only.mounting.rotation_deg == (0.0, 0.0, 90.0)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig"])  # Windows' editors put a mark first
def test_profiles_are_read_from_files(tmp_path, encoding):
    path = tmp_path / "mine.toml"
    path.write_text(SMALLEST, encoding)
    assert load_profile(str(path)) == load_profile(path) == parse_profile(SMALLEST, "mine")


def test_missing_and_unreadable_files_are_named(tmp_path):
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe\x00")
    for path in (tmp_path / "no.toml", tmp_path, tmp_path / "binary.toml"):
        with pytest.raises(InputError) as caught:
            load_profile(str(path))
        assert str(path) in str(caught.value)
        assert "\n" not in str(caught.value)


def test_a_file_does_not_hide_a_shipped_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("paper").write_text("not a profile", "utf-8")
    assert load_profile("paper").conditioned is False


def test_toml_round_trip_keeps_every_digit():
    rng = np.random.default_rng(60)
    for k in (LOWER, UPPER, *(random_memberships(rng) for _ in range(20))):
        known = dict(zip(NAMES, k, strict=True))
        changed = merge_profile(load_profile("imu"), {"membership": known})
        again = parse_profile(profile_to_toml(changed), "again")
        assert again == changed
        assert again.k == k


def test_json_names_every_number():
    imu = load_profile("imu")
    tree = profile_to_json(imu)
    assert list(tree) == [
        *("reference", "filter", "membership", "confidence", "conditioning", "aiding"),
        *("mounting", "calibration", "rates", "provenance"),
    ]
    assert list(tree["membership"]) == list(NAMES)
    assert "gravity_tau_s" in tree["conditioning"]
    assert settings_of(merge_profile(load_profile("paper"), tree)) == settings_of(imu)


def test_21_numbers_are_not_feasible():
    with pytest.raises(InputError, match="22"):
        require_feasible(midpoint()[:-1])


def test_bounds_are_the_papers_blocks():
    """Eq. (16) and (17), triangle by triangle, low corner block and high corner block."""
    low = "0 | 0 0 0.1 | 0.05 0.1 0.1 | 0.1 0.2 0.2 | 0.2 | 0 | 0 5 10 | 5 20 20 | 20 20 40 | 40"
    high = (
        "0.15 | 0.2 0.2 0.2 | 0.2 0.25 0.35 | 0.35 0.5 0.7 | 0.7 |"
        " 15 | 20 20 30 | 20 50 50 | 50 70 90 | 70"
    )
    assert tuple(float(x) for x in low.replace("|", " ").split()) == LOWER
    assert tuple(float(x) for x in high.replace("|", " ").split()) == UPPER


@pytest.mark.parametrize("gain", [0.0, -1.0, float("nan"), float("inf")])
def test_a_fixed_gain_replaces_the_controller_and_must_be_positive(gain):
    chosen = settings_of(load_profile("paper"), 7.0).filter
    assert (chosen.gain_is_fixed, chosen.fixed_gain) == (True, 7.0)
    with pytest.raises(InputError, match="gain"):
        settings_of(load_profile("paper"), gain)


def test_every_parameter_of_the_filter_reaches_it():
    """Each of a value that no other has, and none that a profile ships with."""
    chosen = {
        "gamma": 0.7,
        "bias_bound_rad_s": 1.3,
        "rate_time_constant_s": 0.4,
        "euler_step_max_s": 0.003,
        "first_step_s": 0.006,
    }
    for name in SHIPPED:
        params = settings_of(merge_profile(load_profile(name), {"filter": chosen})).filter
        assert {key: getattr(params, key) for key in chosen} == chosen
    weights = {"gravity": 0.5, "magnetic": 0.6, "cross": 0.8}
    reference = settings_of(merge_profile(load_profile("paper"), {"confidence": weights})).reference
    assert (reference.s_gravity, reference.s_magnetic, reference.s_cross) == (0.5, 0.6, 0.8)


def test_declination_turns_magnetic_to_true_north():
    east = merge_profile(load_profile("imu"), {"reference": {"declination_deg": 90.0}})
    assert settings_of(east).reference.magnetic_ned == pytest.approx((0.0, 1.0, 0.0), abs=1e-15)


EASTERLY = PlaceField(declination_rad=0.1, dip_rad=1.1, strength_gauss=0.5)


def test_a_declination_of_zero_is_known_and_the_default_is_not():
    """0 is a value: the heading is true, and a position 4 deg off changes nothing."""
    zero = merge_profile(load_profile("imu"), {"reference": {"declination_deg": 0}})
    assert not settings_of(zero).learns_north
    assert settings_of(zero, place=EASTERLY).reference.magnetic_ned == (1.0, 0.0, 0.0)
    default = load_profile("imu")
    assert settings_of(default).learns_north
    turned = settings_of(default, place=EASTERLY).reference.magnetic_ned
    assert turned == pytest.approx((cos(0.1), sin(0.1), 0.0), abs=1e-15)
    level = ImuSample(1_000_000, ZERO_VEC3, (0.0, 0.0, -9.8), (0.2, 0.0, 0.4), True)
    for profile, before, after in ((zero, "true", "true"), (default, "magnetic", "true")):
        estimator = Estimator(profile)
        estimator.update(level)
        first = estimator.attitude(level.time_us)
        assert first.heading_reference == before
        estimator.set_position(52.0, 13.0, 50.0, 1_790_000_000_000_000)
        then = estimator.attitude(level.time_us)
        assert then.heading_reference == after
        # 4.5 deg east near Berlin in 2026 by the World Magnetic Model
        east = radians(4.5) if before == "magnetic" else 0.0
        expected = multiply(exp((0.0, 0.0, east)), first.q_ned_frd)
        assert_attitude_close(then.q_ned_frd, expected, 0.01)


def test_dots_in_descriptions_are_no_depth():
    words = "Tuned at 1.2.3 m, of a.b.c. On two flights. " * 50 + "." * 100
    text = f'{SMALLEST}[provenance]\ndescription = "{words}"\n'
    assert parse_profile(text, "x").provenance.description == words


def test_an_update_nested_deep_is_refused():
    deep = []
    for _ in range(1100):
        deep = [deep]
    with pytest.raises(InputError, match="too deep"):
        merge_profile(load_profile("imu"), {"filter": {"gamma": deep}})


@pytest.mark.parametrize("name", ["fifo", "/dev/zero", "/dev/null", "long.toml"])
def test_what_may_block_or_never_end_is_not_read(tmp_path, name):
    if name == "fifo":
        os.mkfifo(tmp_path / name)
    (tmp_path / "long.toml").write_text(SMALLEST + "#" * (1 << 20))
    why = "more than" if name == "long.toml" else "a pipe, a socket or a device"
    with pytest.raises(InputError, match=why):
        load_profile(str(tmp_path / name))
