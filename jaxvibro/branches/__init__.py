"""Branches of periodic orbits along one parameter.

`follow` continues an `Orbit` between the bounds of a parameter. It returns a `Branch` with its special points and the
reasons for its ends. `switch` follows the branches that emanate from a special point, and `explore` finds the branches
over a whole range of the parameter. `itinerary_segment` follows orbits with one itinerary and joins
the segments.
"""
