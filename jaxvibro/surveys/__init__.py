"""What scenes settle on all over a range of their parameters, and how hard it is to throw them off it.

In: a scene, and values of its parameters. Out: labels, exponents, shares and loads of every cell of a grid; attractors
told apart and matched along a parameter; the least shock that leaves one. Start with `map`; `motions` does its work.
"""
