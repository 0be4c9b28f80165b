"""Classify motions over ranges of parameters, and measure the resilience of attractors against shocks.

In: a scene and values of its parameters. Out: labels, exponents, basin fractions and wall loads of every cell of a
grid; attractors matched along a parameter; the minimal fatal shock of an attractor. Start with `map`; `motions` does
its work.
"""
