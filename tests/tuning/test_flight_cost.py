"""What a tuned profile may not make worse."""

import re

import pytest

from tuning.flight_cost import Figure, FlightFigures, harm

FINE = FlightFigures(Figure(2.0, 0.5, 0.70), Figure(4.0, 1.0, 0.65))
SAME_ELSEWHERE = FlightFigures(Figure(1.0, 0.2, 0.95), None)


def changed(angle, **fields):
    return FINE._replace(**{angle: getattr(FINE, angle)._replace(**fields)})


def test_what_holds_does_no_harm():
    flights = [FINE, SAME_ELSEWHERE]
    assert harm(flights, flights) is None
    assert harm(flights, [changed("inclination", rms_deg=1.9), SAME_ELSEWHERE]) is None
    # from one end of what is honest to the other, and nearer to it
    assert harm([FINE], [changed("heading", coverage=0.76)]) is None
    assert harm([FINE], [changed("heading", coverage=0.59)]) is None  # and hardly outside
    too_sure = changed("heading", coverage=0.3)
    assert harm([too_sure], [changed("heading", coverage=0.5)]) is None


@pytest.mark.parametrize(
    ("after", "words"),
    [
        (changed("inclination", rms_deg=2.1), "error rises from 2.016 to 2.049"),
        (changed("inclination", coverage=0.57), "coverage of 0.70 becomes 0.57"),
        (changed("heading", coverage=0.79), "coverage of 0.65 becomes 0.79"),
        (FINE._replace(heading=None), "error rises"),
    ],
)
def test_an_error_that_rises_or_a_sigma_that_lies_is_harm(after, words):
    said = harm([FINE, SAME_ELSEWHERE], [after, SAME_ELSEWHERE])
    assert said is not None
    assert re.search(words, said)


def test_one_flight_may_be_worse_if_the_others_are_better_by_more():
    """Errors are weighed over all; coverage holds on each."""
    before, better = [FINE, FINE], changed("inclination", rms_deg=1.5)
    worse = changed("inclination", rms_deg=2.2)
    assert harm(before, [better, worse]) is None
    assert harm(before, [better, worse._replace(heading=Figure(4.0, 1.0, 0.5))]) is not None
