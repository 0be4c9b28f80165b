"""Attractors, Lyapunov exponents, basins of attraction and invariant manifolds.

In: a scene and initial states. Out: attractors with their basin fractions, swept bifurcation diagrams, both Lyapunov
exponents, the attractor that each initial state of a grid approaches, and the manifolds of a saddle. Start with `find`;
`transients` and `classify` do its work.
"""
