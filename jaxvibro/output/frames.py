"""Tables for spreadsheets: pandas' frames, one row a point, in the scene's units or in physical ones."""

import numpy as np
import pandas as pd

from ..scene.scales import require_scales
from .table_text import headed
from .units import LENGTH, SPEED, require_system, told


def frame(scene, columns, units):
    """A DataFrame of {name: (unit, values)}; in physical units the names of columns with units end with these in
    brackets. Raises ArgumentError for other units, and where the scene has no scales."""
    require_system(units)
    if units == "scene":
        return pd.DataFrame({name: values for name, (_, values) in columns.items()})
    scales, found = require_scales(scene), {}
    for name, (unit, values) in columns.items():
        text, size = told(unit, scales)
        found[headed(name, text, units)] = values * size if size != 1.0 else values
    return pd.DataFrame(found)


def of_multipliers(pairs):
    """The columns of Floquet's multipliers, (points, 2), complex."""
    return {f"multiplier{k + 1}_{part}": ("1", getattr(pairs[:, k], part)) for k in (0, 1) for part in ("real", "imag")}


def of_least(data):
    """The columns of the least speed before an impact and the least clearance, nan where there is none."""
    units = {"least_speed": SPEED, "least_clearance": LENGTH}
    return {key: (unit, np.where(np.isfinite(data[key]), data[key], np.nan)) for key, unit in units.items()}


def kinds_at(special, count):
    """The kind of the special point at each of so many points, "" where there is none."""
    found = np.full(count, "", dtype=object)
    for one in special:
        found[one.place] = one.kind
    return found
