"""What a scene settles on: attractors, exponents, basins, invariant manifolds.

In: a scene, and starts. Out: attractors with their shares, swept diagrams, both Lyapunov exponents, which attractor
each start of a grid ends on, the manifolds of a saddle. Start with `attractors`; `transients` and `classify` do its
work.
"""
