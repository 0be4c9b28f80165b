"""Attractors, Lyapunov exponents, basins of attraction and invariant manifolds.

The functions take a scene and initial states. They return attractors with their basin fractions, swept bifurcation
diagrams, both Lyapunov exponents, the attractor that each initial state of a grid approaches, and the manifolds of a
saddle. Start with `find`, which uses `transients` and `classify_attractors`.
"""
