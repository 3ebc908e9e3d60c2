"""How far angles spread: facts, of which none is chosen."""

from math import pi

# After a turn by an unknown angle any is possible: none is known worse than this, rad^2.
HALF_TURN_VARIANCE = pi**2
# 68 % of a plane normal distribution lie within this many of its sigmas.
PLANE_68 = 1.515
