"""The symmetric scene of figure 4, and its branches along the amplitude, computed once."""

from functools import cache

import jaxvibro as jv

GAMMA, OMEGA, R = 0.05, 2.1, 0.7


def scene(amplitude=2.0):
    return jv.make_scene(amplitude, OMEGA, GAMMA, R, (-1.0, 1.0))


@cache
def orbit():
    return jv.find_orbit(scene(), jv.State(0.9, -1.1))


@cache
def branch():
    """P100, which grazes, and P111, which folds and loses its symmetry."""
    return jv.follow(orbit(), "amplitude", (0.0, 6.0))


@cache
def asymmetric():
    """The two branches of P112 and P121."""
    return jv.switch(branch().points("SB")[0])
