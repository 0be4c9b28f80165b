"""Periodic orbits at given parameters.

`find` solves for an `Orbit` near a state: its itinerary, impacts and Floquet multipliers. `find` finds the
orbits near many trajectories, and `solve` solves for many orbits at once. Two solvers exist: one for the times and
speeds of the impacts (`orbit_from_impacts`), and shooting with the stroboscopic map (`shooting`). The equations are in
`impact_equations`, and `orbit` decides if two orbits are the same.
"""
