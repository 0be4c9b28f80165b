"""The points of a branch, a row each, and one more between two of them."""

import jax
import numpy as np

from continuation import follow

from .equations import problem


def at(points, place):
    """One row."""
    return jax.tree.map(lambda leaf: leaf[place], points)


def upto(points, count):
    """The first rows."""
    return jax.tree.map(lambda leaf: leaf[:count], points)


def put(points, place, one):
    """The rows with one more, at a place; the step to the row after it is what is left of it."""
    found = jax.tree.map(lambda leaf, new: np.insert(leaf, place, new, axis=0), points, one)
    if place + 1 < len(found.z):
        found.step[place + 1] -= one.step
    return found


def joined(parts):
    """Rows and rows, each part beginning with the last row of that before."""
    return jax.tree.map(lambda *each: np.concatenate([each[0], *(one[1:] for one in each[1:])]), *parts)


def turned(points):
    """The rows in the other order."""
    return jax.tree.map(lambda leaf: leaf[::-1], points)


def between(along, points, after, length, control):
    """The `Point` a length after one of them, None where Newton's method does not come there."""
    one = follow.step(problem(along), at(points, after), length, control, along)
    return one if one.met else None
