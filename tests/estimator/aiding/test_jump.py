"""Velocities of both sources that jump, as when the satellites are wrong, and stay wrong."""

import pytest

from tests.estimator.aiding.test_flight import apart_deg, estimator
from tests.flight import banked_flight, flown

JUMP_M_S = 4.0
RECEIVER_LATE_S = 0.1
RECEIVER_S, FILTER_S = 30.0, 32.0  # the filter follows the receiver


def by_both(flight, jump_m_s):
    """The flight's reports by a filter, and by a receiver whose come late."""
    late = dict(flight.reports)
    for k, report in flight.reports:
        north, east, down = report.velocity_ned_m_s
        more = jump_m_s * (report.time_us > FILTER_S * 1e6)
        yield k, report._replace(velocity_ned_m_s=(north + more, east, down))
        before = late.get(k - round(RECEIVER_LATE_S * 50))
        if before is not None:
            north, east, down = before.velocity_ned_m_s
            more = jump_m_s * (report.time_us > RECEIVER_S * 1e6)
            yield (
                k,
                report._replace(
                    velocity_ned_m_s=(north + more, east, down),
                    has_vertical=False,
                    late_sigma_s=0.1,
                ),
            )


def test_a_jump_of_both_sources_that_lasts_is_no_tilt():
    """4 m/s too much for 28 s: if that faded within 5 s, a tilt of 2.6 deg would explain it."""
    flight = banked_flight()
    runs = [
        flown(estimator(), flight, reports=list(by_both(flight, jump))) for jump in (0.0, JUMP_M_S)
    ]
    assert apart_deg(*runs) == pytest.approx(0.268, rel=0.2)
