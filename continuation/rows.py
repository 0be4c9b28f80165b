"""Rows of points, or of what is known of them, in a tuple of a class with an array a field: some of them, and more."""

import numpy as np


def by_field(function, *rows):
    """Rows made of rows by a function of their arrays, one of each: `jax.tree.map` takes some ten times as long. Rows
    are a tuple of a class with an array a field, or None, of which nothing is known."""
    return None if rows[0] is None else type(rows[0])._make(map(function, *rows))


def at(points, place):
    """One row."""
    return by_field(lambda leaf: leaf[place], points)


def upto(points, count):
    """The first rows."""
    return by_field(lambda leaf: leaf[:count], points)


def put(points, place, one):
    """The rows with one more, at a place; the step to the row after it is what is left of it."""
    found = by_field(lambda leaf, new: np.concatenate([leaf[:place], np.asarray(new)[None], leaf[place:]]), points, one)
    if place + 1 < len(found.z):
        found.step[place + 1] -= one.step
    return found


def joined(parts):
    """Rows and rows, each part beginning with the last row of that before."""
    return by_field(lambda *leaves: np.concatenate([leaves[0], *(leaf[1:] for leaf in leaves[1:])]), *parts)


def turned(points):
    """The rows in the other order."""
    return by_field(lambda leaf: leaf[::-1], points)
