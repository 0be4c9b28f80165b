"""Convert results to pandas data frames with one row per point, in the scene's or in physical units."""

import numpy as np
import pandas as pd

from ..scene.scales import require_scales
from .table_text import column_header
from .units import LENGTH, SPEED, display_unit, require_unit_system


def make_dataframe(scene, columns, units):
    """Return a DataFrame of some columns.

    Parameters
    ----------
    scene : Scene
        Scene, with scales for physical units.
    columns : mapping of str to tuple
        Unit and values of each column.
    units : {"scene", "physical"}
        Units. In physical units the names of columns with units end with the unit in brackets.

    Returns
    -------
    pandas.DataFrame
        Table.

    Raises
    ------
    ArgumentError
        If `units` is unknown, or physical units are requested of a scene without scales.
    """
    require_unit_system(units)
    if units == "scene":
        return pd.DataFrame({name: values for name, (_, values) in columns.items()})
    scales, table = require_scales(scene), {}
    for name, (unit, values) in columns.items():
        unit_text, factor = display_unit(unit, scales)
        table[column_header(name, unit_text, units)] = values * factor if factor != 1.0 else values
    return pd.DataFrame(table)


def multiplier_columns(multipliers):
    """Return the columns of the Floquet multipliers.

    Parameters
    ----------
    multipliers : ndarray
        Complex multipliers. Array of shape (points, 2).

    Returns
    -------
    dict of str to tuple
        Unit and values of each column.
    """
    return {
        f"multiplier{k + 1}_{part}": ("1", getattr(multipliers[:, k], part))
        for k in (0, 1)
        for part in ("real", "imag")
    }


def minimum_columns(data):
    """Return the columns of the smallest impact speed and the minimum clearance, nan where there is none.

    Parameters
    ----------
    data : xarray.Dataset
        Dataset with ``least_speed`` and ``least_clearance``.

    Returns
    -------
    dict of str to tuple
        Unit and values of each column.
    """
    units = {"least_speed": SPEED, "least_clearance": LENGTH}
    return {key: (unit, np.where(np.isfinite(data[key]), data[key], np.nan)) for key, unit in units.items()}


def special_kinds(special_points, n_points):
    """Return the kind of the special point at each point of a curve, ``""`` for an ordinary point.

    Parameters
    ----------
    special_points : sequence
        Special points with `place` and `kind`.
    n_points : int
        Number of points.

    Returns
    -------
    ndarray
        Kinds. Array of shape (n_points,).
    """
    kinds = np.full(n_points, "", dtype=object)
    for point in special_points:
        kinds[point.place] = point.kind
    return kinds
