"""A parameter surveyed by what is found at each of its values.

In: a scene, a parameter and its values. Out: Datasets along the parameter, of what is known at each value and of what
carries over from one to the next: the attractors and their shares of random starts. Start with `fractions`; `carry`
takes attractors from value to value, `matching` tells which are one.
"""
