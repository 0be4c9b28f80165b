"""Periodic orbits, one at a time.

In: a scene and a state, or a guess of the impacts. Out: `Orbit`, with its itinerary, impacts and Floquet
multipliers, solved by its impacts (`by_impacts`) or by shooting on the strobe (`by_shooting`). Start with `find`;
the equations are in `impact_equations`, what says that two orbits are one in `orbit_comparison`.
"""
