"""Special points of the Henon map (u, v) -> (p - u^2 + b v, u) in mpmath, from the map's own equations.

Every argument is the exact number it stores; mpmath's precision is the caller's.
"""

from mpmath import det, eye, findroot, matrix, mpf


def slopes(u, b):
    """The map's derivative, by (u, v)."""
    return matrix([[-2 * u, b], [1, 0]])


def doubled_cycle(b, start):
    """(x, y, p) where the cycle x -> y -> x has the multiplier -1 and doubles: Newton's method from a start."""
    b = mpf(b)

    def equations(x, y, p):
        twice = slopes(y, b) * slopes(x, b)
        return [p - x * x + b * y - y, p - y * y + b * x - x, det(twice + eye(2))]

    return tuple(findroot(equations, start))
