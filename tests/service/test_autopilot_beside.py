"""The service compares the autopilot's attitude with ours, and reports when they differ."""

from math import radians

import pytest

from drivers.events import FilterStatus, Heartbeat, Parameter, ReferenceAttitude
from estimator.estimator import Estimator
from estimator.geometry.frames import euler_rad, from_euler_rad
from estimator.geometry.quaternion import exp, multiply
from service.pipeline import Pipeline
from tests.service.flight_rig import ONE, PAPER, imu_events, statuses, texts


def turned(roll_deg=0.0, pitch_deg=0.0):
    """An attitude that is shown turned about the vehicle's own axes."""
    return lambda q: multiply(q, exp((radians(roll_deg), radians(pitch_deg), 0.0)))


def flown(
    show, *, message="ATTITUDE", clock_off_us=0, late_us=0, parameters=(), vehicle_type=1,
    word=None, word_off_us=0,
):  # fmt: skip
    """The lines and the last status of a vehicle whose autopilot shows another attitude."""
    pipeline, twin, lines = Pipeline(PAPER), Estimator(PAPER), []
    pipeline.handle(Heartbeat(ONE, 0, 3, vehicle_type))
    for name, value in parameters:
        pipeline.handle(Parameter(ONE, 0, name, value))
    for k, event in enumerate(imu_events(3000)):
        outputs, now_us = pipeline.handle(event), event.arrival_us
        twin.update(event.sample)
        for name, value in parameters if k == 0 else ():
            pipeline.handle(Parameter(ONE, now_us, name, value))
        if k % 10 == 5:
            time_us = event.sample.time_us
            if word is not None:
                pipeline.handle(FilterStatus(ONE, now_us + word_off_us, True, True, **word))
            q = show(twin.attitude(time_us).q_ned_frd)
            theirs = (time_us + clock_off_us, "autopilot", message, q)
            outputs += pipeline.handle(ReferenceAttitude(ONE, now_us + late_us, *theirs))
        lines += texts(outputs)
    return [line for line in lines if "autopilot" in line], statuses(pipeline.tick(now_us))[-1]


def test_a_wrong_attitude_is_reported_once_and_warned_of():
    (line,), status = flown(turned(60.0))
    found = status.autopilot
    assert "the autopilot's horizon has been" in line
    assert "autopilot_differs" in status.warnings
    assert (found.verdict, found.message, found.axis) == ("differs", "ATTITUDE", "inclination")
    assert found.inclination_deg > 20.0
    assert found.roll_deg == pytest.approx(60.0, abs=6.0)
    assert found.in_short == f"autopilot horizon {found.off_deg:.0f}° off"


@pytest.mark.parametrize(
    ("other", "is_compared"),
    [
        *(({"clock_off_us": off_us}, False) for off_us in (5_000_000, -5_000_000, -200_000)),
        # without a stamp, and right behind its IMU message or not; a sample comes each 10 ms
        ({"message": "AHRS2", "late_us": 5_000}, True),
        ({"message": "AHRS2", "late_us": 15_000}, False),
    ],
)
def test_an_attitude_of_another_clock_is_not_compared(other, is_compared):
    lines, status = flown(turned(60.0), **other)
    assert bool(lines) is is_compared
    assert (status.autopilot and status.autopilot.verdict) == ("differs" if is_compared else None)


def pitched_down(q):
    """As a plane shows it that cruises 60 degrees nose up, more than any does."""
    roll, pitch, yaw = euler_rad(q)
    return from_euler_rad(roll, pitch - radians(60.0), yaw)


as_a_copter = turned(pitch_deg=-90.0)  # as a tailsitter shows itself while it hovers
PITCH, OLD_PITCH, TAILSITTER = ("PTCH_TRIM_DEG", 60.0), ("TRIM_PITCH_CD", 6e3), "Q_TAILSIT_ENABLE"
QUADPLANE, SHOWS_ALL = ("Q_ENABLE", 1.0), ("FLIGHT_OPTIONS", 256.0)


@pytest.mark.parametrize(
    ("shown", "parameters", "vehicle_type", "verdict"),
    [
        (turned(), [], 1, "agrees"),
        (turned(-60.0), [("AHRS_TRIM_X", radians(60.0))], 1, "agrees"),  # its IMU is so mounted
        (pitched_down, [], 1, "differs"),
        (pitched_down, [PITCH], 1, "agrees"),
        (pitched_down, [OLD_PITCH], 1, "agrees"),
        (pitched_down, [PITCH, SHOWS_ALL], 1, "differs"),
        (turned(), [PITCH, SHOWS_ALL], 1, "agrees"),
        (turned(), [PITCH], 1, "differs"),
        (turned(), [PITCH, QUADPLANE], 1, "agrees"),  # while it hovers
        (as_a_copter, [], 1, "differs"),
        (as_a_copter, [(TAILSITTER, 1.0)], 1, "agrees"),
        (turned(), [(TAILSITTER, 1.0)], 1, "agrees"),
        (as_a_copter, [], 20, "agrees"),
        (as_a_copter, [(TAILSITTER, 0.0)], 22, "differs"),
        (as_a_copter, [], 22, None),  # not reported
        (turned(), [], 22, "agrees"),
        (turned(60.0), [], 22, "differs"),
    ],
)
def test_what_an_autopilot_shows_its_pilot_is_known_by_parameters_and_type(
    shown, parameters, vehicle_type, verdict
):
    lines, status = flown(shown, parameters=parameters, vehicle_type=vehicle_type)
    found = None if status.autopilot is None else status.autopilot.verdict
    assert found in ((verdict, "cannot_tell") if verdict == "agrees" else (verdict,))
    assert bool(lines) is (verdict == "differs")
    assert ("autopilot_differs" in status.warnings) is (verdict == "differs")
    if verdict == "agrees":
        assert status.autopilot.inclination_deg == pytest.approx(0.0, abs=1.0)


@pytest.mark.parametrize(
    ("word", "off_us", "output"),
    [
        ({"has_attitude": False}, 0, "calls it not good"),
        ({"compass_ratio": 1.5}, 0, "or compass"),
        ({}, 0, None),
        # at another time of the host's clock
        *(({"has_attitude": False}, off_us, None) for off_us in (-3_600_000_000, 3_600_000_000)),
    ],
)
def test_what_the_autopilot_s_filter_reports_against_itself_is_evidence(word, off_us, output):
    _, status = flown(turned(60.0), word=word, word_off_us=off_us)
    assert ("its own filter" in status.autopilot.evidence) is (output is not None)
    assert (output or "") in status.autopilot.evidence
