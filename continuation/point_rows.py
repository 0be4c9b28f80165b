"""Rows of points, or of what is known of them, in a tuple of a class with an array a field: some of them, and more."""

import numpy as np


def map_fields(function, *rows):
    """Rows made of rows by a function of their arrays, one of each: `jax.tree.map` takes some ten times as long. Rows
    are a tuple of a class with an array a field, or None, of which nothing is known."""
    return None if rows[0] is None else type(rows[0])._make(map(function, *rows))


def row_at(points, index):
    """One row."""
    return map_fields(lambda leaf: leaf[index], points)


def head(points, n_rows):
    """The first rows."""
    return map_fields(lambda leaf: leaf[:n_rows], points)


def insert_row(points, index, row):
    """The rows with one more, at a place; the step to the row after it is what is left of it."""
    extended_rows = map_fields(
        lambda leaf, entry: np.concatenate([leaf[:index], np.asarray(entry)[None], leaf[index:]]), points, row
    )
    if index + 1 < len(extended_rows.z):
        extended_rows.step[index + 1] -= row.step
    return extended_rows


def join_rows(parts):
    """Rows and rows, each part beginning with the last row of that before."""
    return map_fields(lambda *leaves: np.concatenate([leaves[0], *(leaf[1:] for leaf in leaves[1:])]), *parts)


def reverse_rows(points):
    """The rows in the other order."""
    return map_fields(lambda leaf: leaf[::-1], points)
