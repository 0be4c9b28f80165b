"""Locate the sign changes of user-defined monitors along a branch."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float

from continuation.intermediate_points import locate_sign_changes
from continuation.point_rows import row_at

from ..orbits.orbit import eigenvalue_pair
from ..problem.orbit_diagnostics import diagnose
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
    return MonitoredPoint(
        float(z[-1]),
        *problem.impacts(z),
        diagnostics.x,
        diagnostics.v,
        eigenvalue_pair(float(diagnostics.trace), float(diagnostics.determinant)),
        float(diagnostics.clearance.min(initial=np.inf)),
    )


def locate_crossings(task, points, diagnostics, kind, monitor):
    """Locate the `Event` of each sign change of a user's monitor; `task` is the `ContinuationTask` of the branch."""
    problem = task.args

    def value_at(z):
        diagnostics_at_z = row_at(diagnose(problem, z[None]), 0)
        return _monitor_value(kind, monitor, make_monitored_point(problem, z, diagnostics_at_z))

    def make_error(kind, row_before):
        rule = "must be evaluated between two points, where Newton's method fails"
        return ArgumentError(f"monitors.{kind}", rule, float(points.z[row_before, -1]))

    monitor_values = [
        _monitor_value(kind, monitor, make_monitored_point(problem, z, row_at(diagnostics, row)))
        for row, z in enumerate(points.z)
    ]
    return locate_sign_changes(task, points, kind, np.array(monitor_values), value_at, make_error)


def _monitor_value(kind, monitor, point):
    """Evaluate a monitor at a `MonitoredPoint`. Raises ArgumentError if the monitor fails."""
    try:
        return float(monitor(point))
    except (ValueError, TypeError, IndexError, ArithmeticError) as error:
        rule = f"must return a number at every point of the branch ({type(error).__name__}: {error})"
        raise ArgumentError(f"monitors.{kind}", rule, point.value) from None
