"""The times over which the estimate averages and remembers: the same time has the same name."""

# Low-pass of the field's norm and dip, s. Small: noise counts, large: magnets are noticed late.
FIELD_S = 0.05
# Of samples further apart (s) what turned in between is mostly missed: one shows no own field, and
# is a sign of no more than this, so that several in a row have to agree.
LONGEST_STEP_S = 0.15
# The quick means of gyroscope, force and field, s: in a shorter one is noise, a longer one is late.
# Looking back, the gyroscope's path does not go on over a longer step.
QUICK_S = 0.5
# Means of force, field and velocity over so long (s) are compared: a shorter one is mostly noise,
# and in a longer one the gyroscope drifts. So long a silence is one.
SPAN_S = 1.0
# So long (s) a field that looks usual must point elsewhere to be believed: a magnet passes. The
# residual of a heading that velocity helps is low-passed with it.
CONFIRM_S = 4.0
# Accelerations that the mean force does not average out, and slips of wheels, last for so long, s.
ACCELERATION_LASTS_S = 3.0
# What is compared with now, s: accelerations, a wandering field, where gravity and field stood.
LATELY_S = 10.0
# Mean squares of how much something usually scatters, s: the size of force and field, the
# heading's residual, and what betrays accelerations that last.
USUAL_S = 20.0
# What has been measured counts for so long, s: corrections, what velocities show of the heading
# (meanwhile G drifts by less than that is wrong), what wheels contradict, that a field is new.
MEMORY_S = 30.0
# What is remembered, s: headings that were given up, how well means of the force agree, how far
# measurements usually lie from an attitude. A random walk's growth is given for it.
# Velocity that has been missing for longer helps no more.
LONG_S = 100.0
# What has been learnt is forgotten in so long, s: a vehicle's own field, that its compass misled.
FORGET_S = 600.0
