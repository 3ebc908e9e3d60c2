"""The viewer's artificial horizon, read back as a picture: what covers a point is its colour."""

import math

import msgspec
import numpy as np
import pytest

from drivers.events import VehicleId
from estimator.geometry.frames import from_euler_rad
from estimator.geometry.quaternion import rotate_inverse
from fuzzbee.trust import Level, trust
from fuzzbee.viewer.horizon import (
    COLOURS,
    FIGURES_Y,
    GREY_GROUND,
    GREY_SKY,
    GROUND,
    HAZE,
    MIDDLE_Y,
    PALE,
    PANEL,
    PEERS,
    PER_DEG,
    SKY,
    TAPE_PER_DEG,
    TAPE_Y,
    WHITE,
    X_RANGE,
    Y_RANGE,
    Scene,
    frame,
    layers,
)
from fuzzbee.viewer.strokes import GLYPHS, text_strokes, width
from service.health import State
from service.records import Peer
from tests.service.records import record


def scene(attitude, state=State.RUNNING, peers=()):
    return Scene("1", state, attitude, trust(state, attitude), peers)


def strips(shown):
    parts = layers(shown)
    return [*parts.world, *frame(), *parts.words, *parts.figures]


def colour_at(drawn, point):
    """What is seen there: the last strip that covers it, or the sky behind all."""
    for strip in reversed(drawn):
        if any(distance(point, a, b) <= strip.radius for a, b in segments(strip)):
            return strip.colour
    return SKY


def segments(strip):
    return list(zip(strip.points, strip.points[1:], strict=False))


def distance(point, a, b):
    p, a, b = np.array(point), np.array(a), np.array(b)
    along = b - a
    length = along @ along
    share = 0.0 if length == 0.0 else np.clip((p - a) @ along / length, 0.0, 1.0)
    return np.linalg.norm(p - a - share * along)


@pytest.mark.parametrize("yaw_deg", [0.0, 130.0])
@pytest.mark.parametrize("pitch_deg", [-20.0, 0.0, 20.0])
@pytest.mark.parametrize("roll_deg", [-170.0, -90.0, -30.0, 0.0, 12.0, 60.0, 135.0, 180.0])
def test_ground_is_drawn_where_a_pilot_sees_it(roll_deg, pitch_deg, yaw_deg):
    """Down in the body's own axes: right is right on the window, down is down."""
    q = from_euler_rad(*map(math.radians, (roll_deg, pitch_deg, yaw_deg)))
    _, right, down = rotate_inverse(q, (0.0, 0.0, 1.0))
    unit = np.array([right, down]) / math.hypot(right, down)
    drawn = strips(scene(record(roll_deg, pitch_deg, yaw_deg)))
    off = pitch_deg * PER_DEG
    for far, colour in ((off + 13.0, GROUND), (off - 13.0, SKY)):
        # beside the rungs and the vehicle's symbol
        seen = {
            colour_at(
                drawn, np.array([0.0, MIDDLE_Y]) + far * unit + side * np.array([-unit[1], unit[0]])
            )
            for side in (-36.0, 36.0)
        }
        assert colour in seen, (far, seen)


@pytest.mark.parametrize(
    ("age_ms", "colours"), [(999.0, (SKY, GROUND)), (1001.0, (GREY_SKY, GREY_GROUND))]
)
def test_an_attitude_of_an_old_sample_is_grey_and_says_its_age(age_ms, colours):
    old = msgspec.structs.replace(record(state=State.DEGRADED), age_ms=age_ms)
    shown = scene(old, State.DEGRADED)
    assert [strip.colour for strip in layers(shown).world[:2]] == [*colours]
    assert f"IMU silent {age_ms / 1e3:.1f} s" in [each.text for each in shown.trust.caveats]


@pytest.mark.parametrize(("age_ms", "text"), [(8.4, "age 8 ms"), (2340.0, "age 2.3 s")])
def test_the_age_of_the_sample_is_written_fresh_or_old_beside_sigma(age_ms, text):
    shown = layers(scene(msgspec.structs.replace(record(sigma_deg=(99.0, 99.0)), age_ms=age_ms)))
    wanted = list(text_strokes(text, (32.0, FIGURES_Y + 32.0), 5.0, "centre"))
    assert [strip.points for strip in shown.figures if strip.colour == PALE] == wanted
    left, right = (pick(x for line in wanted for x, _ in line) for pick in (min, max))
    others = [x for strip in shown.words for x, y in strip.points if y > FIGURES_Y + 26.0]
    assert not [x for x in others if left - 2.0 < x < right + 2.0]


def test_the_haze_is_as_wide_as_sigma_and_has_the_colour_of_its_trust():
    for sigma_deg, level in ((2.0, Level.GOOD), (8.0, Level.CARE), (20.0, Level.BAD)):
        drawn = strips(scene(record(sigma_deg=(sigma_deg, 1.0))))
        x = 130.0
        for share, colour in ((0.9, HAZE[level]), (1.2, None)):
            for side in (-1, 1):
                y = MIDDLE_Y + side * share * sigma_deg * PER_DEG
                expected = colour or (GROUND if side > 0 else SKY)
                assert colour_at(drawn, (x, y)) == expected, (sigma_deg, share, side)
        assert colour_at(drawn, (x, Y_RANGE[0] + 3.0)) == COLOURS[level]


def test_a_doubtful_heading_leaves_the_haze_alone():
    attitude = record(sigma_deg=(2.0, 20.0))
    assert trust(State.RUNNING, attitude).overall is Level.CARE
    assert colour_at(strips(scene(attitude)), (130.0, MIDDLE_Y + 2.0)) == HAZE[Level.GOOD]


def test_without_an_attitude_there_is_no_horizon_to_be_believed():
    attitude = record(20.0, 5.0, 90.0)
    for state in (State.LOST, State.WAITING, State.ALIGNING):
        drawn = strips(scene(None, state))
        colours = {
            colour_at(drawn, (x, y))
            for x in np.linspace(*X_RANGE, 13)
            for y in np.linspace(TAPE_Y + 2.0, FIGURES_Y - 2.0, 13)
        }
        assert colours <= {PANEL, COLOURS[Level.NONE]}
        assert COLOURS[Level.NONE] in colours
    assert layers(scene(attitude)).world


def test_the_tape_shows_the_range_of_the_heading():
    drawn = strips(scene(record(yaw_deg=200.0, sigma_deg=(1.0, 14.0))))
    y = TAPE_Y - 1.5
    for share, inside in ((0.9, True), (1.2, False)):
        for side in (-1, 1):
            seen = colour_at(drawn, (side * share * 14.0 * TAPE_PER_DEG, y))
            assert (seen == COLOURS[Level.CARE]) == inside


def test_a_heading_without_north_is_in_brackets_and_names_no_direction():
    sure = record(yaw_deg=90.0)
    lost = record(yaw_deg=90.0)
    lost = msgspec.structs.replace(lost, heading_reference="none")
    brackets = text_strokes("(", (0.0, 0.0), 12.0)[0]
    assert not has_glyph(layers(scene(sure)).figures, brackets)
    assert has_glyph(layers(scene(lost)).figures, brackets)


def has_glyph(drawn, stroke):
    """Whether a strip is that stroke, wherever it lies."""
    shape = np.diff(np.array(stroke), axis=0)
    return any(
        len(strip.points) == len(stroke)
        and np.allclose(np.diff(np.array(strip.points), axis=0), shape)
        for strip in drawn
    )


def test_the_world_has_always_as_many_strips_of_the_same_kind():
    """So that only their points have to be sent."""
    styles = {
        tuple((strip.radius, strip.colour) for strip in layers(scene(record(r, p, 0.0))).world)
        for r in range(-180, 181, 45)
        for p in range(-90, 91, 9)
    }
    assert len(styles) == 1


def test_others_horizons_are_drawn_in_their_colours_and_how_far_they_are_off_is_written():
    q = from_euler_rad(0.0, math.radians(10.0), 0.0)
    peers = ((Peer(VehicleId(1, 1), "autopilot", q), 10.0),)
    drawn = strips(scene(record(), peers=peers))
    assert colour_at(drawn, (90.0, MIDDLE_Y + 10.0 * PER_DEG)) == (255, 140, 40)
    assert colour_at(drawn, (90.0, MIDDLE_Y)) == WHITE


def test_the_longest_numbers_stay_inside_the_window_and_apart():
    figures = layers(scene(record(-123.4, -88.8, 359.9, sigma_deg=(99.0, 99.0)))).figures
    xs = sorted(x for strip in figures for x, y in strip.points if 0.0 < y - FIGURES_Y < 26.0)
    assert X_RANGE[0] < xs[0]
    assert xs[-1] < X_RANGE[1]
    assert sum(gap > 20.0 for gap in np.diff(xs)) == 2  # three numbers


def test_text_is_as_wide_as_it_says_and_aligned():
    for align, left in (("left", 0.0), ("centre", -0.5), ("right", -1.0)):
        points = [p for stroke in text_strokes("HH", (0.0, 0.0), 6.0, align) for p in stroke]
        xs, ys = [x for x, _ in points], [y for _, y in points]
        wide = width("HH", 6.0)
        assert min(xs) == pytest.approx(left * wide)
        assert max(xs) == pytest.approx((left + 1.0) * wide)
        assert (min(ys), max(ys)) == (-3.0, 3.0)


def test_every_word_of_the_instrument_has_its_glyphs():
    text = "DO NOT TRUST, NO ATTITUDE ±0.8° MAGNETIC UNKNOWN (359°) 255-190 HIGHRES_IMU +"
    assert set(text) - {" "} <= GLYPHS.keys()
    assert set("ABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789") <= GLYPHS.keys()
    shapes = [GLYPHS[c] for c in "ABCDEFGHIJKLMNPQRSTUVWXYZ123456789"]
    assert len(set(shapes)) == len(shapes)  # no two look alike but O and 0


@pytest.mark.parametrize("roll_deg", [-50.0, 25.0])
def test_the_mark_on_the_rolls_scale_is_where_the_zenith_is(roll_deg):
    """Up in the body's own axes: to the left of a vehicle that rolls to the right."""
    attitude = record(roll_deg, 0.0, 40.0)
    _, right, down = rotate_inverse(attitude.q_ned_frd, (0.0, 0.0, -1.0))
    tip = layers(scene(attitude)).world[-1].points[0]
    far = math.hypot(tip[0], tip[1] - MIDDLE_Y)
    assert tip == pytest.approx((far * right, MIDDLE_Y + far * down))
    assert right * roll_deg < 0.0


@pytest.mark.parametrize(("theirs_deg", "side"), [(60.0, 1.0), (20.0, -1.0)])
def test_somebody_elses_heading_is_marked_on_its_side_of_ours(theirs_deg, side):
    peer = Peer(VehicleId(1, 1), "sim", from_euler_rad(0.0, 0.0, math.radians(theirs_deg)))
    parts = layers(scene(record(0.0, 0.0, 40.0), peers=((peer, 20.0),)))
    (mark,) = [s for s in parts.words if s.colour == PEERS["sim"] and s.points[1][1] == TAPE_Y]
    assert mark.points[1][0] == pytest.approx(side * 20.0 * TAPE_PER_DEG)


def test_an_autopilot_that_differs_stands_out():
    peers = ((Peer(VehicleId(1, 1), "autopilot", from_euler_rad(0.0, 0.4, 0.0)), 22.9),)
    place = (X_RANGE[1] - 9.0, TAPE_Y + 13.5)
    usual = scene(record(), peers=peers)
    assert colour_at(strips(usual), place) == PANEL
    assert colour_at(strips(usual._replace(differs=True)), place) == PEERS["autopilot"]
