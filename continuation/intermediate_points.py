"""Points between those of a branch."""

import numpy as np

from . import event_search
from .arclength import Point
from .point_rows import head, insert_row, row_at


def start_point(z, tangent):
    """The `Point` from which steps begin along a tangent."""
    zero = np.zeros(())
    return Point(z, tangent, zero, zero, zero, np.True_, np.True_)


def point_at_length(task, points, row_before, length):
    """The `Point` a length after one of them, None where Newton's method does not come there."""
    point = event_search.take_step(task.problem, row_at(points, row_before), length, task.control, task.args)
    return point if point.converged else None


def point_from_z(task, points, row_before, z):
    """A `Point` with this z, its tangent and determinant taken on the branch there."""
    base_point = row_at(points, row_before)
    length = float(np.sum(task.control.scale**2 * base_point.tangent * (z - base_point.z)))
    point = event_search.take_step(task.problem, base_point, length, task.control, task.args)
    if not point.converged or not np.isfinite(point.tangent).all():
        point = base_point
    return point._replace(z=z, step=np.float64(length), converged=np.True_, accepted=np.True_)


def truncate_at_value(task, points, last_row, index, value):
    """(the points up to where one of the numbers of z, before a place, has a value, whether it was found)."""
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
    z[index] = value  # but for a rounding it is
    return insert_row(truncated, last_row, point_from_z(task, points, last_row - 1, z)), True


def truncate_at_length(task, points, row_before, length):
    """The points up to a length after one of them."""
    point = point_at_length(task, points, row_before, length)
    truncated = head(points, row_before + 1)
    return truncated if point is None else insert_row(truncated, row_before + 1, point)
