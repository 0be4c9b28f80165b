"""The scene file that `jaxvibro init` writes."""

SCENE_TEMPLATE = """\
# A mass on a spring, driven, between two rigid walls. `jaxvibro run` with this file draws what it settles on as the
# drive grows and falls, and looks for all that it can settle on at one strength of the drive.
#
#   x'' + 2 damping x' + x = amplitude cos(frequency t)   between the walls
#   velocity after an impact = -restitution (velocity before), both taken against the wall
#
# Lengths are in a unit of your choice, time in 1/w0, w0 being the natural frequency without damping.

[scene]
amplitude = 3.0      # A, of the drive
frequency = 2.1      # omega, of the drive; greater than 0
damping = 0.05       # gamma, not negative; 1 is critical
restitution = 0.7    # R, from 0 to 1

# [[scene.drive]]    # a term more of the drive: amplitude cos(harmonic frequency t + phase)
# amplitude = 0.4
# harmonic = 3       # a whole number; 0 with phase 0 is a constant force
# phase = 0.0        # radians

[scene.left]         # leave a wall's table out where there is no wall
position = -1.0

[scene.right]
position = 1.0
# restitution = 0.6  # its own, in place of the scene's
# stiffness = 400.0  # of a soft wall, which has no restitution; its damping is the scene's or its own: damping = 3.0

# [scene.right.motion]   # position + amplitude cos(harmonic frequency t + phase)
# amplitude = 0.1
# phase = 0.0            # radians
# harmonic = 1           # a whole number

[sweep]              # a swept diagram: the state at the end of one value starts the next
parameter = "amplitude"   # or "frequency", "left.position", "right.restitution", "right.motion.phase", ...
count = 301          # values in a leg
settle = 200         # drive periods left out at each value
keep = 50            # drive periods drawn at each value

[[sweep.legs]]       # one colour a leg
name = "down"
from = 6.0
to = 0.0
start = {x = 0.9, v = -1.1}

[[sweep.legs]]
name = "up"
from = 0.0
to = 6.0
start = {x = 0.0, v = 0.0}

[attractors]         # what the scene settles on from many random starts
starts = 50
seed = 0
at = {amplitude = 3.0}    # values other than [scene]'s, if any

# [orbits]             # periodic orbits, those that repel too; it takes longer than the attractors
# max_period = 4       # drive periods of the longest, up to 32
# starts = 50
# seed = 0
# at = {amplitude = 3.0}

# [branch]             # the periodic orbits along a parameter, stable and unstable, and where they change
# parameter = "amplitude"
# bounds = [0.0, 6.0]
# start = {x = 0.9, v = -1.1}   # what this settles on is where it begins,
# at = {amplitude = 2.0}        # with these values
# max_period = 1       # drive periods of the longest that a period doubling is followed to; 1: none

# [explore]            # in place of [branch]: from many starts all over the parameter's range; it takes minutes
# parameter = "amplitude"
# bounds = [0.0, 6.0]
# max_period = 2
# budget = 20          # branches after which it stops
# max_seconds = 600    # wall-clock time, s, after which it stops

# [locus]              # the special points of the branches, followed in two parameters
# parameters = ["amplitude", "frequency"]
# bounds = {amplitude = [0.0, 12.0], frequency = [1.2, 3.0]}
# kinds = ["SN", "PD", "SB", "GR"]
"""
