"""Locate sign changes along a branch: of user-defined monitors, Neimark-Sacker points and resonances.

Locate Neimark-Sacker points and neutral saddles, where the product of the multipliers passes 1. Such points exist only
in scenes in which areas in the phase space grow somewhere.

Locate resonances of area-preserving maps: multipliers that are primitive third or fourth roots of 1. Without damping,
and with walls of restitution 1, the product of the multipliers is 1. A pair lies on the unit circle, where the trace is
between -2 and 2 (elliptic), or is real (hyperbolic). The elliptic range ends at SN, SB or BP, at PD, or at a grazing.
At the resonances 1:3 and 1:4 within this range, orbits of three and four times the period meet the orbit, and the orbit
may lose its stability (Arnold, Mathematical Methods of Classical Mechanics, appendix 7).
"""

from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Complex, Float

from continuation.branch_segment import row_at
from continuation.event_search import locate_sign_changes

from ..contact.kinds import flow_of_scene
from ..orbits.orbit import eigenvalue_pair, has_unit_determinants
from ..problem.orbit_equations import diagnose
from ..scene.check import ArgumentError
from ..scene.force_operations import areas_never_grow


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


def locate_neimark_sacker(task, points, diagnostics):
    """Locate the `Event` of each point at which the determinant of the monodromy matrix passes 1.

    The kind is NS if the multipliers are complex there, and NSA (neutral saddle) if they are real. There are no events
    if the flow contracts areas, if areas are proved never to grow, or if the determinant is 1 everywhere.
    """
    determinant_excess = diagnostics.determinant - 1.0
    if not flow_of_scene(task.args.scene).areas_may_grow() or not (np.diff(np.sign(determinant_excess)) != 0).any():
        return []
    if has_unit_determinants(diagnostics.trace, diagnostics.determinant) or areas_never_grow(
        *_scenes_at_extremes(task.args, points)
    ):
        return []
    return [
        event._replace(kind=_event_kind(task.args, event))
        for event in locate_crossings(task, points, diagnostics, "NS", _determinant_excess)
    ]


def _scenes_at_extremes(problem, points):
    """Return the scenes at the least and at the largest value of the parameter."""
    values = points.z[:, -1]

    def scene_at_value(value):
        return jax.tree.map(
            lambda leaf, parameter_mark: np.where(parameter_mark == 1, value, leaf),
            problem.scene,
            problem.parameter_marks,
        )

    return scene_at_value(values.min()), scene_at_value(values.max())


def _event_kind(problem, event):
    return "NS" if abs(row_at(diagnose(problem, event.z[None]), 0).trace) < 2.0 else "NSA"


def _determinant_excess(point):
    """Return the determinant at a `MonitoredPoint` minus 1."""
    with np.errstate(invalid="ignore"):  # multipliers are infinite at an impact with zero speed
        return float(np.prod(point.multipliers).real) - 1.0


RESONANT_TRACES = {"R3": -1.0, "R4": 0.0}


def locate_resonances(task, points, diagnostics):
    """Locate the `Event` of each R3 and R4. Return no events unless areas are preserved."""
    if not has_unit_determinants(diagnostics.trace, diagnostics.determinant):
        return []

    def trace_offset_function(resonant_trace):
        return lambda point: float(np.sum(point.multipliers).real) - resonant_trace

    return [
        event
        for kind, resonant_trace in RESONANT_TRACES.items()
        for event in locate_crossings(task, points, diagnostics, kind, trace_offset_function(resonant_trace))
    ]
