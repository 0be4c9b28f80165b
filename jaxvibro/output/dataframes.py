"""Tables for spreadsheets: pandas' frames, one row a point, in the scene's units or in physical ones."""

import numpy as np
import pandas as pd

from ..scene.scales import require_scales
from .table_text import column_header
from .units import LENGTH, SPEED, display_unit, require_unit_system


def make_dataframe(scene, columns, units):
    """A DataFrame of {name: (unit, values)}; in physical units the names of columns with units end with these in
    brackets. Raises ArgumentError for other units, and where the scene has no scales."""
    require_unit_system(units)
    if units == "scene":
        return pd.DataFrame({name: values for name, (_, values) in columns.items()})
    scales, table = require_scales(scene), {}
    for name, (unit, values) in columns.items():
        unit_text, factor = display_unit(unit, scales)
        table[column_header(name, unit_text, units)] = values * factor if factor != 1.0 else values
    return pd.DataFrame(table)


def multiplier_columns(multipliers):
    """The columns of Floquet's multipliers, (points, 2), complex."""
    return {
        f"multiplier{k + 1}_{part}": ("1", getattr(multipliers[:, k], part))
        for k in (0, 1)
        for part in ("real", "imag")
    }


def minimum_columns(data):
    """The columns of the least speed before an impact and the least clearance, nan where there is none."""
    units = {"least_speed": SPEED, "least_clearance": LENGTH}
    return {key: (unit, np.where(np.isfinite(data[key]), data[key], np.nan)) for key, unit in units.items()}


def special_kinds(special_points, n_points):
    """The kind of the special point at each of so many points, "" where there is none."""
    kinds = np.full(n_points, "", dtype=object)
    for point in special_points:
        kinds[point.place] = point.kind
    return kinds
