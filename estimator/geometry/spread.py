"""How far angles spread: facts, of which none is chosen."""

from math import pi

# The mean square angle between a direction and any other one, rad^2: it is known no worse.
ANY_DIRECTION_VARIANCE = 0.5 * (pi**2 - 4.0)
# After a turn by an unknown angle any is possible: none is known worse than this, rad^2.
HALF_TURN_VARIANCE = pi**2
# 68 % of a plane normal distribution lie within this many of its sigmas.
PLANE_68 = 1.515
# Of independent readings the second differences' mean square over the first ones'.
INDEPENDENT_SECOND_DIFFERENCE = 3.0
