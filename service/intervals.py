"""How often what is looked at of a vehicle's samples, and how far apart its clocks may be."""

# Enough for a steady median, few enough to follow a stream whose rate was changed.
PERIODS_KEPT = 51
MEDIAN_EVERY = 8
# The estimate is checked for not being finite once in so many samples. Once it is not finite it
# stays so, and a check at each sample would cost as much as the filter.
CHECKED_EVERY = 8
# The ages of two messages stamped by one clock differ by less than this.
OTHER_CLOCK_US = 1_000_000
