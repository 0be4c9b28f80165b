"""Classify motions over ranges of parameters, and measure the resilience of attractors against shocks.

The functions take a scene and values of its parameters. They return labels, exponents, basin fractions and wall loads
of every cell of a parameter grid, attractors matched along a parameter, and the minimal fatal shock of an attractor.
Start with `map`, which uses `motion_classification`.
"""
