"""Branches of periodic orbits along one parameter.

The input is an `Orbit` and the bounds of a parameter. The output is a `Branch` with its special points and the reasons
for its ends, the branches that emanate from it, and the unattended exploration of a whole range. Start with `follow`.
`segment` contains the loop, `through_grazings` joins segments, and `explore` starts many branches.
"""
