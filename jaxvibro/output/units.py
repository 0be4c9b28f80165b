"""The units of what is written and returned, as attributes of its variables: each spelled once.

Lengths are in the unit in which the walls' positions are given; w0 is the frequency of the free oscillator without
damping, t = w0 times the time.
"""

LENGTH = "length"
SPEED = "length w0"
TIME = "1/w0"
ANGLE = "rad"
ONE = "1"
