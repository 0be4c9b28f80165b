"""A user's monitors along a branch: functions of a point, and where they change their sign."""

from typing import NamedTuple

import numpy as np

from ..orbits.orbit import multipliers
from ..problem.diagnostics import looked
from ..problem.points import at, between
from ..scene.check import SceneError


class MonitoredPoint(NamedTuple):
    """A point of a branch, as a user's monitor sees it. value: the parameter's; times, speeds, sides: of the impacts;
    x, v: at the section, one for each period; multipliers: the larger first; clearance: the least, inf if none."""

    value: float
    times: np.ndarray
    speeds: np.ndarray
    sides: np.ndarray
    x: np.ndarray
    v: np.ndarray
    multipliers: np.ndarray
    clearance: float


def seen(along, z, look):
    """The `MonitoredPoint` of one point."""
    rows, count = len(along.cycle.sides), int(np.sum(along.cycle.sides != 0))
    return MonitoredPoint(
        float(z[-1]),
        z[:count],
        z[rows : rows + count],
        np.asarray(along.cycle.sides[:count]),
        look.x,
        look.v,
        multipliers(float(look.trace), float(look.determinant)),
        float(look.clear.min(initial=np.inf)),
    )


def crossings(along, points, look, kind, function, control):
    """Where a user's monitor changes its sign."""
    values = np.array([_value(kind, function, seen(along, z, at(look, k))) for k, z in enumerate(points.z)])
    for after in np.flatnonzero(values[:-1] * values[1:] < 0):
        size = float(points.step[after + 1])

        def value(length, after=int(after)):
            one = between(along, points, after, length, control)
            if one is None:
                raise ValueError(f"the monitor {kind} cannot be followed between two points")
            return _value(kind, function, seen(along, one.z, at(looked(along, one.z[None]), 0)))

        length = _root(value, size)
        one = between(along, points, int(after), length, control)
        yield int(after), length, kind, one.z, float(one.residual)


def _value(kind, function, point):
    """What a monitor says of a `MonitoredPoint`. Raises SceneError where it fails."""
    try:
        return float(function(point))
    except (ValueError, TypeError, IndexError, ArithmeticError) as error:
        told = f"must give a number at every point of the branch ({type(error).__name__}: {error})"
        raise SceneError(f"monitors.{kind}", told, point.value) from None


def _root(function, end):
    """Where a function changes its sign between 0 and an end, to 1e-14: Chandrupatla's mix of halving and inverse
    quadratics (Advances in Engineering Software 28, 145, 1997). SciPy's roots take as long to load as all the rest."""
    a, b, c = end, 0.0, 0.0  # the newest, that with the other sign, the one before
    f_a, f_b, f_c = function(a), function(b), 0.0
    share = 0.5
    while True:
        new = a + share * (b - a)
        value = function(new)
        if value * f_a > 0:
            c, f_c = a, f_a
        else:
            b, f_b, c, f_c = a, f_a, b, f_b
        a, f_a = new, value
        best = a if abs(f_a) < abs(f_b) else b
        least = 1e-14 * (1.0 + abs(best)) / abs(b - a)
        if f_a == 0 or least > 0.5:
            return best
        xi, phi = (a - b) / (c - b), (f_a - f_b) / (f_c - f_b)
        share = 0.5
        if phi * phi < xi and (1.0 - phi) ** 2 < 1.0 - xi:
            share = f_a / (f_b - f_a) * f_c / (f_b - f_c) + (c - a) / (b - a) * f_a / (f_c - f_a) * f_b / (f_c - f_b)
        share = min(max(share, least), 1.0 - least)
