"""Contacts with walls, and the registry of the kinds of flow and contact.

The input of `kinds` is a scene; the output is its coefficients, which contain the chosen flow and contact. A contact
(`rigid`, `linear`, `force_law`, `force_spring`) is a module with all functions of `flight.protocols.Contact`: the rules
of a wall, its part in a certified step, and contact phases for a replay, for a matrix and for the equations of orbits.
Start with `kinds`, then `rigid`.
"""
