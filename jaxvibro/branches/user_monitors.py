"""Locate the sign changes of user-defined monitors along a branch."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float

from continuation.event_search import Event
from continuation.intermediate_points import point_at_length
from continuation.point_rows import row_at
from continuation.roots import find_bracketed_root

from ..orbits.orbit import eigenvalue_pair
from ..problem.orbit_diagnostics import diagnose
from ..problem.orbit_equations import sides_with_release_codes
from ..scene.check import ArgumentError


class MonitoredPoint(NamedTuple):
    """Point of a branch that is passed to a user's monitor.

    Attributes
    ----------
    value : float
        Value of the parameter.
    times, speeds, sides : ndarray
        Impact times, speeds and sides, arrays of shape (impacts,). The side of a release is multiplied by 2 or 3.
    x, v : ndarray
        State at phase 0 of each period, arrays of shape (periods,).
    multipliers : ndarray
        Floquet multipliers, complex array of shape (2,), the larger first.
    clearance : float
        Least clearance, inf if none.
    """

    value: float
    times: Float[np.ndarray, " impacts"]
    speeds: Float[np.ndarray, " impacts"]
    sides: Float[np.ndarray, " impacts"]
    x: Float[np.ndarray, " periods"]
    v: Float[np.ndarray, " periods"]
    multipliers: Complex[np.ndarray, "2"]
    clearance: float


def make_monitored_point(problem, z, diagnostics):
    """Make the `MonitoredPoint` of one point."""
    n_rows, n_impacts = len(problem.sequence.sides), int(np.sum(problem.sequence.sides != 0))
    return MonitoredPoint(
        float(z[-1]),
        z[:n_impacts],
        z[n_rows : n_rows + n_impacts],
        np.asarray(sides_with_release_codes(problem.sequence)[:n_impacts]),
        diagnostics.x,
        diagnostics.v,
        eigenvalue_pair(float(diagnostics.trace), float(diagnostics.determinant)),
        float(diagnostics.clearance.min(initial=np.inf)),
    )


def locate_crossings(task, points, diagnostics, kind, monitor):
    """Locate the `Event` of each sign change of a user's monitor; `task` is the `ContinuationTask` of the branch."""
    problem = task.args
    monitor_values = np.array(
        [
            _monitor_value(kind, monitor, make_monitored_point(problem, z, row_at(diagnostics, row)))
            for row, z in enumerate(points.z)
        ]
    )
    for row_before in np.flatnonzero(monitor_values[:-1] * monitor_values[1:] < 0).tolist():

        def monitor_value_at(arclength, row_before=row_before):
            point = point_at_length(task, points, row_before, arclength)
            if point is None:
                raise ArgumentError(
                    f"monitors.{kind}",
                    "must be evaluated between two points, where Newton's method fails",
                    float(points.z[row_before, -1]),
                )
            return _monitor_value(
                kind, monitor, make_monitored_point(problem, point.z, row_at(diagnose(problem, point.z[None]), 0))
            )

        arclength = find_bracketed_root(monitor_value_at, float(points.step[row_before + 1]))
        point = point_at_length(task, points, row_before, arclength)
        yield Event(kind, row_before, arclength, point.z, float(point.residual))


def _monitor_value(kind, monitor, point):
    """Evaluate a monitor at a `MonitoredPoint`. Raises ArgumentError if the monitor fails."""
    try:
        return float(monitor(point))
    except (ValueError, TypeError, IndexError, ArithmeticError) as error:
        rule = f"must return a number at every point of the branch ({type(error).__name__}: {error})"
        raise ArgumentError(f"monitors.{kind}", rule, point.value) from None
