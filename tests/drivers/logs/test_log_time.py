"""What stands in for arrivals in a log that has none."""

from drivers.logs.logged_vehicle import LONGEST_HOLE_US, LogTime


def test_it_follows_the_logs_time_but_never_goes_back_nor_over_a_hole_of_years():
    time = LogTime()
    raw_us = (10_000_000, 10_020_000, 3_000_000, 3_020_000, 2**50, 2**50 + 20_000)
    assert [time.arrival_us(each) for each in raw_us] == [
        0,
        20_000,
        20_000,  # rebooted
        40_000,
        40_000 + LONGEST_HOLE_US,
        60_000 + LONGEST_HOLE_US,
    ]
