"""Questions that gradients answer: bifurcations as functions of the scene, and what is built on them.

In: special points of branches, orbits, scenes. Out: values with derivatives of any order by every number of a scene.
Start reading at `located.py`.
"""
