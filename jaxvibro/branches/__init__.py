"""Branches of periodic orbits along one parameter.

In: an `Orbit` and a parameter's bounds. Out: `Branch`, its special points and why it ends; the branches that leave
it; all of a range, unattended. Start with `follow`; `segment` is the loop, `through_grazings` what joins segments,
`explore` what starts many.
"""
