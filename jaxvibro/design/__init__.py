"""Locate, place and fit bifurcations with gradients.

The functions of this package accept special points of branches, orbits and scenes. They return values with derivatives
of any order with respect to every number of a scene. The module to read first is `located`.
"""
