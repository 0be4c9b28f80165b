"""A user's monitors along a branch: functions of a point, and where they change their sign."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float

from continuation.event_search import Event
from continuation.points import between
from continuation.roots import sign_change
from continuation.rows import at

from ..orbits.orbit import multipliers
from ..problem.diagnostics import diagnose
from ..problem.equations import codes
from ..scene.check import ArgumentError


class MonitoredPoint(NamedTuple):
    """A point of a branch, as a user's monitor sees it. value: the parameter's; times, speeds, sides: of the impacts;
    x, v: at the section, one for each period; multipliers: the larger first; clearance: the least, inf if none."""

    value: float
    times: Float[np.ndarray, " impacts"]
    speeds: Float[np.ndarray, " impacts"]
    sides: Float[np.ndarray, " impacts"]
    x: Float[np.ndarray, " periods"]
    v: Float[np.ndarray, " periods"]
    multipliers: Complex[np.ndarray, "2"]
    clearance: float


def monitored_point(along, z, look):
    """The `MonitoredPoint` of one point."""
    rows, count = len(along.cycle.sides), int(np.sum(along.cycle.sides != 0))
    return MonitoredPoint(
        float(z[-1]),
        z[:count],
        z[rows : rows + count],
        np.asarray(codes(along.cycle)[:count]),
        look.x,
        look.v,
        multipliers(float(look.trace), float(look.determinant)),
        float(look.clear.min(initial=np.inf)),
    )


def crossings(task, points, look, kind, function):
    """The `Event`s where a user's monitor changes its sign; task: the `driver.Task` of the branch."""
    along = task.args
    values = np.array([_value(kind, function, monitored_point(along, z, at(look, k))) for k, z in enumerate(points.z)])
    for after in np.flatnonzero(values[:-1] * values[1:] < 0).tolist():

        def value(length, after=after):
            one = between(task, points, after, length)
            if one is None:
                raise ArgumentError(
                    f"monitors.{kind}", "must be followed between two points", float(points.z[after, -1])
                )
            return _value(kind, function, monitored_point(along, one.z, at(diagnose(along, one.z[None]), 0)))

        length = sign_change(value, float(points.step[after + 1]))
        one = between(task, points, after, length)
        yield Event(kind, after, length, one.z, float(one.residual))


def _value(kind, function, point):
    """What a monitor says of a `MonitoredPoint`. Raises ArgumentError where it fails."""
    try:
        return float(function(point))
    except (ValueError, TypeError, IndexError, ArithmeticError) as error:
        told = f"must give a number at every point of the branch ({type(error).__name__}: {error})"
        raise ArgumentError(f"monitors.{kind}", told, point.value) from None
