"""Select, insert and join rows of points or diagnostics: NamedTuples with one array per field."""

import numpy as np


def map_fields(function, *rows):
    """Apply a function to the fields of rows.

    Parameters
    ----------
    function : callable
        Function of one array of each of the rows.
    *rows : NamedTuple or None
        Rows of one class, with one array per field.

    Returns
    -------
    NamedTuple or None
        The results in the same class; None for None.

    Notes
    -----
    `jax.tree.map` takes about ten times as long.
    """
    return None if rows[0] is None else type(rows[0])._make(map(function, *rows))


def row_at(points, index):
    """Return one row."""
    return map_fields(lambda leaf: leaf[index], points)


def head(points, n_rows):
    """Return the first rows."""
    return map_fields(lambda leaf: leaf[:n_rows], points)


def insert_row(points, index, row):
    """Insert a row at an index and shorten the step of the row after it."""
    extended_rows = map_fields(
        lambda leaf, entry: np.concatenate([leaf[:index], np.asarray(entry)[None], leaf[index:]]), points, row
    )
    if index + 1 < len(extended_rows.z):
        extended_rows.step[index + 1] -= row.step
    return extended_rows


def join_rows(parts):
    """Join parts, each of which begins with the last row of the previous one."""
    return map_fields(lambda *leaves: np.concatenate([leaves[0], *(leaf[1:] for leaf in leaves[1:])]), *parts)


def reverse_rows(points):
    """Reverse the order of the rows."""
    return map_fields(lambda leaf: leaf[::-1], points)
