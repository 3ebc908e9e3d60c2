"""A vehicle that changes all the time does not fill the screen."""

from service.lines import MINUTE_US, MOST_LINES, TOO_MANY, LineLimit


def test_a_few_lines_are_passed_on():
    limit = LineLimit("vehicle 1")
    assert limit.lines(["a", "b"], 0) == ["a", "b"]
    assert limit.lines(["c"], 5) == ["c"]


def test_of_many_lines_the_first_are_told_and_later_how_many_were_not():
    limit, said = LineLimit("vehicle 1"), []
    for number in range(1000):
        said += limit.lines([f"line {number}"], 1000 * number)
    assert said[:MOST_LINES] == [f"line {number}" for number in range(MOST_LINES)]
    assert said[MOST_LINES:] == [
        "vehicle 1: more lines are left out: there were more than 12 within a minute"
    ]
    assert limit.lines(["later"], MINUTE_US) == [
        f"vehicle 1: {1000 - MOST_LINES} lines were left out: {TOO_MANY}",
        "later",
    ]


def test_a_clock_set_back_does_not_silence_it():
    limit = LineLimit("vehicle 1")
    limit.lines(["a"] * 100, MINUTE_US)
    assert limit.lines(["b"], 0)[-1] == "b"
