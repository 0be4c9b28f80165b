"""Locate, place and fit bifurcations with gradients.

In: special points of branches, orbits, scenes. Out: values with derivatives of any order with respect to every number
of a scene. Start reading at `located.py`.
"""
