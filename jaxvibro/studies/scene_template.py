"""Define the commented scene file that `jaxvibro init` writes."""

SCENE_TEMPLATE = """\
# A driven mass on a spring between two rigid walls. `jaxvibro run` with this file draws a swept diagram for increasing
# and decreasing drive amplitude, and finds the attractors at one amplitude.
#
#   x'' + 2 damping x' + x = amplitude cos(frequency t)   between the walls
#   velocity after an impact = -restitution (velocity before), both relative to the wall
#
# Lengths are in a unit of your choice, time in 1/w0, w0 being the undamped natural frequency.

[scene]
amplitude = 3.0      # A, amplitude of the drive
frequency = 2.1      # omega, frequency of the drive; greater than 0
damping = 0.05       # gamma, damping ratio; not negative, 1 is critical
restitution = 0.7    # R, coefficient of restitution; from 0 to 1

# [[scene.drive]]    # a further term of the drive: amplitude cos(harmonic frequency t + phase)
# amplitude = 0.4
# harmonic = 3       # an integer; 0 with phase 0 is a constant force
# phase = 0.0        # radians

[scene.left]         # without this table there is no left wall
position = -1.0

[scene.right]
position = 1.0
# restitution = 0.6  # in place of the scene's
# stiffness = 400.0  # makes the wall soft, without restitution; its damping is the scene's, or damping = 3.0

# [scene.right.motion]   # position + amplitude cos(harmonic frequency t + phase)
# amplitude = 0.1
# phase = 0.0            # radians
# harmonic = 1           # an integer

[sweep]              # a swept diagram: the last state at one value is the first at the next
parameter = "amplitude"   # or "frequency", "left.position", "right.restitution", "right.motion.phase", ...
count = 301          # values per leg
settle = 200         # drive periods discarded at each value
keep = 50            # drive periods drawn at each value

[[sweep.legs]]       # one colour per leg
name = "down"
from = 6.0
to = 0.0
start = {x = 0.9, v = -1.1}

[[sweep.legs]]
name = "up"
from = 0.0
to = 6.0
start = {x = 0.0, v = 0.0}

[attractors]         # attractors from many random starts
starts = 50
seed = 0
at = {amplitude = 3.0}    # values in place of those in [scene]

# [orbits]             # periodic orbits, stable and unstable; takes longer than the attractors
# max_period = 4       # drive periods of the longest orbit, up to 32
# starts = 50
# seed = 0
# at = {amplitude = 3.0}

# [branch]             # branches of periodic orbits along a parameter, with their bifurcations
# parameter = "amplitude"
# bounds = [0.0, 6.0]
# start = {x = 0.9, v = -1.1}   # the branch starts at the orbit that is reached from here
# at = {amplitude = 2.0}        # with these values
# max_period = 1       # drive periods of the longest orbit behind period doublings; 1: no doubled branches

# [explore]            # in place of [branch]: from many starts over the parameter's range; takes minutes
# parameter = "amplitude"
# bounds = [0.0, 6.0]
# max_period = 2
# budget = 20          # largest number of branches
# max_seconds = 600    # limit on the wall-clock time, s

# [locus]              # loci: special points of the branches, continued in two parameters
# parameters = ["amplitude", "frequency"]
# bounds = {amplitude = [0.0, 12.0], frequency = [1.2, 3.0]}
# kinds = ["SN", "PD", "SB", "GR"]
"""
