"""Compute points between the points of a branch, and truncate branches at such points."""

import numpy as np

from . import event_search
from .point_rows import first_rows, insert_row, row_at
from .roots import find_bracketed_root


def point_at_length(task, points, row_before, length):
    """Compute the point at a length after a row of points.

    Parameters
    ----------
    task : ContinuationTask
        The task.
    points : Point
        Points, one row each.
    row_before : int
        Row from which the step is taken.
    length : float
        Length of the step.

    Returns
    -------
    Point or None
        The point; None if Newton's method does not converge.
    """
    point = event_search.take_step(task.problem, row_at(points, row_before), length, task.control, task.args)
    return point if point.converged else None


def point_from_z(task, points, row_before, z):
    """Make the `Point` at z, with the tangent and determinant of the branch at z.

    If the step to z fails, the tangent and determinant are those of the row before.

    Parameters
    ----------
    task : ContinuationTask
        The task.
    points : Point
        Points, one row each.
    row_before : int
        Row before the point.
    z : ndarray
        The point.

    Returns
    -------
    Point
        The point.
    """
    base_point = row_at(points, row_before)
    length = float(np.sum(task.control.scale**2 * base_point.tangent * (z - base_point.z)))
    point = event_search.take_step(task.problem, base_point, length, task.control, task.args)
    if not point.converged or not np.isfinite(point.tangent).all():
        point = base_point
    return point._replace(z=z, step=np.float64(length), converged=np.True_, accepted=np.True_)


def truncate_at_value(task, points, row_beyond, z_index, target_value):
    """Truncate points where an entry of z reaches a value.

    Parameters
    ----------
    task : ContinuationTask
        The task.
    points : Point
        Points, one row each.
    row_beyond : int
        First row beyond the value.
    z_index : int
        Index of the entry of z.
    target_value : float
        The value.

    Returns
    -------
    points : Point
        Points up to the value, or up to the row before the value if no point with the value was located.
    is_located : bool
        True if the point with the value was located.
    """
    (value_before, value_after) = points.z[row_beyond - 1 : row_beyond + 1, z_index]
    fraction = (target_value - value_before) / (value_after - value_before)
    z_guess = point_at_length(task, points, row_beyond - 1, fraction * float(points.step[row_beyond]))
    z_guess = (
        points.z[row_beyond - 1] + fraction * (points.z[row_beyond] - points.z[row_beyond - 1])
        if z_guess is None
        else z_guess.z
    )
    point = event_search.solve_with_fixed_entry(task.problem, z_guess, z_index, target_value, task.control, task.args)
    points_before = first_rows(points, row_beyond)
    if not point.converged:
        return points_before, False
    z = np.array(point.z)
    z[z_index] = target_value  # exactly, without a rounding error
    return insert_row(points_before, row_beyond, point_from_z(task, points, row_beyond - 1, z)), True


def truncate_at_length(task, points, row_before, length):
    """Truncate points at a length after a row, or at the row if Newton's method fails."""
    point = point_at_length(task, points, row_before, length)
    points_before = first_rows(points, row_before + 1)
    return points_before if point is None else insert_row(points_before, row_before + 1, point)


def locate_sign_changes(task, points, kind, values, value_at, make_error):
    """Yield the `Event` of each sign change of a function along a branch.

    Parameters
    ----------
    task : ContinuationTask
        The task.
    points : Point
        Points, one row each.
    kind : str
        Kind of the events.
    values : ndarray
        Values of the function at the points.
    value_at : callable
        The function of z.
    make_error : callable
        Function of (kind, row before). It returns the error to raise if Newton's method fails between two points.

    Yields
    ------
    Event
        The sign changes, in order.
    """
    for row_before in np.flatnonzero(values[:-1] * values[1:] < 0).tolist():

        def value_at_length(length, row_before=row_before):
            point = point_at_length(task, points, row_before, length)
            if point is None:
                raise make_error(kind, row_before)
            return value_at(point.z)

        length = find_bracketed_root(value_at_length, float(points.step[row_before + 1]))
        point = point_at_length(task, points, row_before, length)
        yield event_search.Event(kind, row_before, length, point.z, float(point.residual))
