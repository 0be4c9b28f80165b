"""Compute points between those of a branch."""

import numpy as np

from . import event_search
from .arclength import Point
from .point_rows import head, insert_row, row_at


def start_point(z, tangent):
    """Make the `Point` from which steps begin.

    Parameters
    ----------
    z : ndarray
        Point of shape (n + 1,).
    tangent : ndarray
        Unit tangent of shape (n + 1,).

    Returns
    -------
    Point
        The point, with step length 0.
    """
    zero = np.zeros(())
    return Point(z, tangent, zero, zero, zero, np.True_, np.True_)


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
    """Make a point with given z and the tangent and determinant of the branch there.

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


def truncate_at_value(task, points, last_row, index, value):
    """Truncate points where an entry of z has a value.

    Parameters
    ----------
    task : ContinuationTask
        The task.
    points : Point
        Points, one row each.
    last_row : int
        First row beyond the value.
    index : int
        Index of the entry of z.
    value : float
        The value.

    Returns
    -------
    points : Point
        Points up to the value.
    found : bool
        True if the point with the value was located.
    """
    (value_before, value_after) = points.z[last_row - 1 : last_row + 1, index]
    fraction = (value - value_before) / (value_after - value_before)
    guess = point_at_length(task, points, last_row - 1, fraction * float(points.step[last_row]))
    guess = (
        points.z[last_row - 1] + fraction * (points.z[last_row] - points.z[last_row - 1]) if guess is None else guess.z
    )
    point = event_search.solve_with_fixed_entry(task.problem, guess, index, value, task.control, task.args)
    truncated = head(points, last_row)
    if not point.converged:
        return truncated, False
    z = np.array(point.z)
    z[index] = value  # exactly, without a rounding error
    return insert_row(truncated, last_row, point_from_z(task, points, last_row - 1, z)), True


def truncate_at_length(task, points, row_before, length):
    """Truncate points at a length after a row."""
    point = point_at_length(task, points, row_before, length)
    truncated = head(points, row_before + 1)
    return truncated if point is None else insert_row(truncated, row_before + 1, point)
