"""Points between those of a branch."""

import numpy as np

from . import event_search
from .arclength import Point
from .rows import at, put, upto


def start_point(z, tangent):
    """The `Point` from which steps begin along a tangent."""
    zero = np.zeros(())
    return Point(z, tangent, zero, zero, zero, np.True_, np.True_)


def between(task, points, after, length):
    """The `Point` a length after one of them, None where Newton's method does not come there."""
    one = event_search.step(task.problem, at(points, after), length, task.control, task.args)
    return one if one.met else None


def pointed(task, points, after, z):
    """A `Point` with this z, its tangent and determinant taken on the branch there."""
    here = at(points, after)
    length = float(np.sum(task.control.scale**2 * here.tangent * (z - here.z)))
    one = event_search.step(task.problem, here, length, task.control, task.args)
    if not one.met or not np.isfinite(one.tangent).all():
        one = here
    return one._replace(z=z, step=np.float64(length), met=np.True_, kept=np.True_)


def to_value(task, points, last, index, value):
    """(the points up to where one of the numbers of z, before a place, has a value, whether it was found)."""
    (p, q) = points.z[last - 1 : last + 1, index]
    share = (value - p) / (q - p)
    guess = between(task, points, last - 1, share * float(points.step[last]))
    guess = points.z[last - 1] + share * (points.z[last] - points.z[last - 1]) if guess is None else guess.z
    found = event_search.pinned(task.problem, guess, index, value, task.control, task.args)
    cut = upto(points, last)
    if not found.met:
        return cut, False
    z = np.array(found.z)
    z[index] = value  # but for a rounding it is
    return put(cut, last, pointed(task, points, last - 1, z)), True


def cut_at(task, points, after, length):
    """The points up to a length after one of them."""
    one = between(task, points, after, length)
    cut = upto(points, after + 1)
    return cut if one is None else put(cut, after + 1, one)
