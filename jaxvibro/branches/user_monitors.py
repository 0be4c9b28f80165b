"""A user's monitors along a branch: functions of a point, and where they change their sign."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float

from continuation.event_search import Event
from continuation.intermediate_points import point_at_length
from continuation.point_rows import row_at
from continuation.roots import find_sign_change

from ..orbits.orbit import eigenvalue_pair
from ..problem.diagnostics import diagnose
from ..problem.equations import side_codes
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


def make_monitored_point(problem, z, diagnostics):
    """The `MonitoredPoint` of one point."""
    n_rows, n_impacts = len(problem.sequence.sides), int(np.sum(problem.sequence.sides != 0))
    return MonitoredPoint(
        float(z[-1]),
        z[:n_impacts],
        z[n_rows : n_rows + n_impacts],
        np.asarray(side_codes(problem.sequence)[:n_impacts]),
        diagnostics.x,
        diagnostics.v,
        eigenvalue_pair(float(diagnostics.trace), float(diagnostics.determinant)),
        float(diagnostics.clearance.min(initial=np.inf)),
    )


def locate_crossings(task, points, diagnostics, kind, function):
    """The `Event`s where a user's monitor changes its sign; task: the `driver.Task` of the branch."""
    problem = task.args
    monitor_values = np.array(
        [
            _monitor_value(kind, function, make_monitored_point(problem, z, row_at(diagnostics, k)))
            for k, z in enumerate(points.z)
        ]
    )
    for row_before in np.flatnonzero(monitor_values[:-1] * monitor_values[1:] < 0).tolist():

        def monitor_value_at(length, row_before=row_before):
            point = point_at_length(task, points, row_before, length)
            if point is None:
                raise ArgumentError(
                    f"monitors.{kind}", "must be followed between two points", float(points.z[row_before, -1])
                )
            return _monitor_value(
                kind, function, make_monitored_point(problem, point.z, row_at(diagnose(problem, point.z[None]), 0))
            )

        length = find_sign_change(monitor_value_at, float(points.step[row_before + 1]))
        point = point_at_length(task, points, row_before, length)
        yield Event(kind, row_before, length, point.z, float(point.residual))


def _monitor_value(kind, function, point):
    """What a monitor says of a `MonitoredPoint`. Raises ArgumentError where it fails."""
    try:
        return float(function(point))
    except (ValueError, TypeError, IndexError, ArithmeticError) as error:
        rule = f"must give a number at every point of the branch ({type(error).__name__}: {error})"
        raise ArgumentError(f"monitors.{kind}", rule, point.value) from None
