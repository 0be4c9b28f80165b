"""Questions about a scene that take very many runs: how hard a blow throws its motion out, and what comes after.

In: a scene, its attractors. Out: the least shock that makes an attractor's motion leave it. Start with `least_shock`;
`shock_search` does its work.
"""
