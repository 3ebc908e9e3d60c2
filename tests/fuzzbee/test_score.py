import json

import numpy as np
import pytest

from estimator.geometry.quaternion import exp, multiply
from fuzzbee.cli import main
from fuzzbee.replays.score import Convergence, Covered, errors_against, summarize
from tests.flight import banked_flight


def coverage(errors, *others, has_heading, **flags):
    """In two parts, of which one is empty where there is one error."""
    found, half = Covered(has_heading=has_heading), len(errors) // 2
    for part in (slice(half), slice(half, None)):
        parts = (column[part] for column in (errors, *others))
        found.add(*parts, **{name: flag[part] for name, flag in flags.items()})
    return found.coverage()


def convergence_s(*columns):
    found = Convergence()
    for part in (slice(2), slice(2, 2), slice(2, None)):
        found.add(*(column[part] for column in columns))
    return found.time_s


def attitudes(vectors):
    return np.array([exp(tuple(v)) for v in vectors])


def test_a_heading_error_is_no_inclination_error():
    reference = attitudes([(0.3, -0.2, 1.0), (3.0, 0.0, 0.0)])
    off = exp((0.0, 0.0, 0.1))
    errors = errors_against(np.array([multiply(off, tuple(q)) for q in reference]), reference)
    np.testing.assert_allclose(errors, [[0.1, 0.1, 0.0]] * 2, atol=1e-7)


def test_figures_are_root_mean_squares_in_degrees():
    errors = np.radians([[3.0, 0.0, 3.0], [4.0, 0.0, 4.0]])
    figures = summarize(errors, has_heading=True)
    assert figures.total_rms == pytest.approx(np.sqrt(12.5))
    assert figures.heading_rms == 0.0
    assert figures.inclination_p95 == pytest.approx(3.95)


def test_without_a_magnetometer_there_is_no_heading_and_no_total():
    figures = summarize(np.radians([[90.0, 90.0, 1.0]]), has_heading=False)
    assert (figures.total_rms, figures.heading_rms) == (None, None)
    assert figures.inclination_rms == pytest.approx(1.0)


def test_without_samples_there_are_no_figures():
    assert summarize(np.empty((0, 3)), has_heading=True).inclination_rms is None


def test_coverage_is_the_share_under_sigma():
    errors = np.radians([[0.0, 1.0, 3.0], [0.0, 2.0, 1.0]])
    two = np.radians([2.0, 2.0])
    assert coverage(errors, two, two, has_heading=True).inclination == 0.5
    assert coverage(errors, two, two, has_heading=True).heading == 1.0


def test_convergence_counts_from_the_first_known_sample():
    times = np.array([0, 1, 2, 3, 4]) * 1_000_000
    total = np.radians([0.0, 90.0, 20.0, 4.9, 30.0])
    known = np.array([False, True, True, True, True])
    assert convergence_s(times, total, known) == 2.0
    assert convergence_s(times, total + 1.0, known) is None
    assert convergence_s(times, total, np.zeros(5, bool)) is None


def test_a_heading_that_was_not_told_does_not_count():
    errors = np.radians([[40.0, 40.0, 0.0], [3.0, 3.0, 0.0], [4.0, 4.0, 0.0]])
    told = np.array([False, True, True])
    assert summarize(errors, has_heading=True, told=told).heading_rms == pytest.approx(3.5355, 1e-4)
    assert summarize(errors, has_heading=True, told=~told).heading_rms == pytest.approx(40.0)
    assert summarize(errors, has_heading=True, told=told & False).total_rms is None
    three = np.full(3, np.radians(3.5))
    assert coverage(errors, three, three, has_heading=True, told=told).heading == 0.5


def test_coverage_in_motion_stands_apart():
    errors = np.radians([[0.0, 1.0, 1.0], [0.0, 3.0, 3.0], [0.0, 1.0, 3.0]])
    two = np.full(3, np.radians(2.0))
    moved = np.array([False, True, True])
    found = coverage(errors, two, two, has_heading=True, moved=moved)
    assert (found.inclination, found.inclination_moving) == (pytest.approx(1 / 3), 0.0)
    assert (found.heading, found.heading_moving) == (pytest.approx(2 / 3), 0.5)
    assert coverage(errors, two, two, has_heading=True).inclination_moving is None


def test_a_heading_that_was_not_told_does_not_count_in_motion_either():
    errors = np.radians([[0.0, 9.0, 1.0], [0.0, 1.0, 3.0], [0.0, 3.0, 1.0]])
    two = np.full(3, np.radians(2.0))
    told, moved = np.array([False, True, True]), np.array([True, True, False])
    found = coverage(errors, two, two, has_heading=True, told=told, moved=moved)
    assert (found.heading, found.heading_moving) == (0.5, 1.0)
    assert found.inclination_moving == 0.5


def test_coverage_while_moving_leaves_out_headings_that_were_not_told():
    errors = np.radians([[0.0, 9.0, 1.0], [0.0, 1.0, 3.0], [0.0, 1.0, 3.0], [0.0, 3.0, 1.0]])
    told, moved = np.array([False, True, True, True]), np.array([True, True, False, True])
    four = np.radians(np.full(4, 2.0))
    found = coverage(errors, four, four, has_heading=True, told=told, moved=moved)
    assert (found.inclination, found.heading) == (0.5, pytest.approx(2.0 / 3.0))
    assert (found.inclination_moving, found.heading_moving) == (pytest.approx(2.0 / 3.0), 0.5)
    none = coverage(errors, four, four, has_heading=False, told=told, moved=moved)
    assert (none.heading, none.heading_moving) == (None, None)


def test_a_heading_by_velocity_is_scored_without_a_magnetometer(tmp_path, capsys):
    flight = banked_flight(seconds=60.0, rate_hz=50.0)
    velocity = {k: report.velocity_ned_m_s for k, report in flight.reports}
    sensors = [f"gyro_{axis}_rad_s" for axis in "xyz"] + [f"acc_{axis}_m_s2" for axis in "xyz"]
    lines = [",".join(["time_s", *sensors, "vn,ve,vd,w,x,y,z"])]
    for k, (sample, q) in enumerate(zip(flight.samples, flight.truth, strict=True)):
        told = velocity.get(k, ("", "", ""))
        row = (1e-6 * sample.time_us, *sample.gyr_rad_s, *sample.acc_m_s2, *told, *q)
        lines.append(",".join(map(str, row)))
    path = tmp_path / "flight.csv"
    path.write_text("\n".join(lines))
    path.with_suffix(".toml").write_text(
        'axes = "frd"\nvelocity = { columns = ["vn", "ve", "vd"] }\n'
        'truth = { columns = ["w", "x", "y", "z"] }'
    )
    assert main(["replay", str(path), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["heading_references"]["true"] > 1000
    assert report["error_deg"]["heading_rms"] < 5.0
    assert report["error_deg"]["total_rms"] < 5.0
    assert report["coverage"]["heading"] is not None
