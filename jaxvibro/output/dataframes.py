"""Convert results to pandas data frames with one row per point, in the scene's or in physical units."""

import numpy as np
import pandas as pd

from ..scene.scales import require_scales
from .table_text import column_header
from .units import LENGTH, SPEED, display_unit, require_unit_system


def make_dataframe(scene, columns_with_units, units):
    """Return a DataFrame of the given columns in the scene's or in physical units.

    Parameters
    ----------
    scene : Scene
        Scene, with scales for physical units.
    columns_with_units : mapping of str to tuple
        Unit and values of each column.
    units : {"scene", "physical"}
        Unit system. With physical units the unit follows the name of each column in brackets, except for dimensionless
        columns.

    Returns
    -------
    pandas.DataFrame
        Table.

    Raises
    ------
    ArgumentError
        If `units` is unknown, or is "physical" for a scene without scales.
    """
    require_unit_system(units)
    if units == "scene":
        return pd.DataFrame(
            {column_name: column_values for column_name, (_, column_values) in columns_with_units.items()}
        )
    scales, physical_columns = require_scales(scene), {}
    for column_name, (unit, column_values) in columns_with_units.items():
        unit_text, unit_factor = display_unit(unit, scales)
        physical_columns[column_header(column_name, unit_text, units)] = (
            column_values * unit_factor if unit_factor != 1.0 else column_values
        )
    return pd.DataFrame(physical_columns)


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
        f"multiplier{index + 1}_{part_name}": ("1", getattr(multipliers[:, index], part_name))
        for index in (0, 1)
        for part_name in ("real", "imag")
    }


def speed_clearance_columns(data):
    """Return the columns of the smallest impact speed and the minimum clearance, with nan for missing values.

    Parameters
    ----------
    data : xarray.Dataset
        Dataset with ``least_speed`` and ``least_clearance``.

    Returns
    -------
    dict of str to tuple
        Unit and values of each column.
    """
    unit_by_column = {"least_speed": SPEED, "least_clearance": LENGTH}
    return {
        column_name: (unit, np.where(np.isfinite(data[column_name]), data[column_name], np.nan))
        for column_name, unit in unit_by_column.items()
    }


def special_kind_per_point(special_points, n_points):
    """Return the kind of special point at each point of a curve, ``""`` for an ordinary point.

    Parameters
    ----------
    special_points : sequence
        Special points with `place` and `kind`.
    n_points : int
        Number of points of the curve.

    Returns
    -------
    ndarray
        Kinds. Array of shape (n_points,).
    """
    kind_per_point = np.full(n_points, "", dtype=object)
    for special_point in special_points:
        kind_per_point[special_point.place] = special_point.kind
    return kind_per_point
