"""Periodic orbits, one at a time.

Input is a scene and a state, or a guess of the impacts. Output is an `Orbit` with its itinerary, impacts and Floquet
multipliers. It is solved by its impacts (`orbit_from_impacts`) or by shooting with the strobe (`shooting`). Start with
`find`. The equations are in `impact_equations`, and `orbit_comparison` decides if two orbits are the same.
"""
