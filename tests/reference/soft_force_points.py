"""Folds and period doublings between soft walls with laws of their own, beside Duffing's spring: Newton's method on the
map of one period (`soft_force`) in many digits; derivatives by differences in these."""

from mpmath import mp, mpf

from . import soft_force

DIGITS = 28
APART = mpf(10) ** -9  # of states, for the map's derivative
STEP = mpf(10) ** -6  # of unknowns and numbers, for derivatives of equations
ROUNDS = 3  # of Newton's steps, with the derivatives of the first


def _map(law, numbers, x, v, frequency):
    own = {name: numbers[name] for name in ("cubic", "damping")}
    walls = numbers["left"], numbers["right"]
    laws = soft_force.duffing, own, soft_force.LAWS[law], {"stiffness": numbers["stiffness"]}
    return soft_force.flown(*laws, numbers["amplitude"], frequency, walls, x, v)[0]


def matrix(law, numbers, x, v, frequency):
    """The derivative of the map of a period, by rows."""
    columns = []
    for a, b in ((APART, 0), (0, APART)):
        ends = [_map(law, numbers, x + sign * a, v + sign * b, frequency) for sign in (1, -1)]
        columns.append([(one - other) / (2 * APART) for one, other in zip(*ends, strict=True)])
    return [list(row) for row in zip(*columns, strict=True)]


def _left(law, closing, numbers, unknowns):
    x, v, _ = unknowns
    end, ((a, b), (c, d)) = _map(law, numbers, *unknowns), matrix(law, numbers, *unknowns)
    return [end[0] - x, end[1] - v, (a - closing) * (d - closing) - b * c]


def _difference(function, given, key):
    ends = []
    for sign in (1, -1):
        moved = given.copy()
        moved[key] += sign * STEP
        ends.append(function(moved))
    return [(one - other) / (2 * STEP) for one, other in zip(*ends, strict=True)]


def _slopes(law, closing, numbers, unknowns):
    columns = [_difference(lambda u: _left(law, closing, numbers, u), unknowns, k) for k in range(3)]
    return mp.matrix(columns).T


def solved(law, closing, numbers, unknowns):
    """[x, v, frequency] at the point near some: where the map has the multiplier closing."""
    unknowns = [mpf(each) for each in unknowns]
    slopes = _slopes(law, closing, numbers, unknowns)
    for _ in range(ROUNDS):
        change = mp.lu_solve(slopes, mp.matrix(_left(law, closing, numbers, unknowns)))
        unknowns = [one - change[k] for k, one in enumerate(unknowns)]
    return unknowns


def gradient(law, closing, numbers, unknowns, names):
    """{name: d frequency / d number} at a point."""
    slopes, found = _slopes(law, closing, numbers, unknowns), {}
    for name in names:
        by = _difference(lambda given: _left(law, closing, given, unknowns), numbers, name)
        found[name] = -mp.lu_solve(slopes, mp.matrix(by))[2]
    return found
