"""Make the columns of a table of orbits, with units."""

import numpy as np

from ..output.dataframes import minimum_columns, multiplier_columns
from ..output.units import LENGTH, POWER, SPEED, unit_of
from ..problem import impact_loads, stability
from ..scene.scene import replace_unchecked


def orbit_columns(scene, values, data, labels, multipliers):
    """Return ``{column: (unit, values)}`` of orbits.

    `values` maps parameters to arrays of shape (points,); `data` is that of a branch; `labels` has shape (points,) and
    `multipliers` (points, 2).
    """
    sides, speeds, minima = data["side"].values, data["speed"].values, minimum_columns(data)
    return {
        **{name: (unit_of(name), parameter_values) for name, parameter_values in values.items()},
        "label": ("", labels),
        "stability": ("", stability.stability_words(multipliers)),
        "x": (LENGTH, data["x"].values[:, 0]),
        "v": (SPEED, data["v"].values[:, 0]),
        "least_speed": minima["least_speed"],
        "largest_speed": (SPEED, impact_loads.largest_speed(sides, speeds)),
        "least_clearance": minima["least_clearance"],
        "work_rate": (POWER, impact_loads.work_rate(sides, speeds, *_restitution_and_time(scene, values, data))),
        **multiplier_columns(multipliers),
    }


def _restitution_and_time(scene, values, data):
    """Return the restitution of each wall at each point, nan if soft, and the duration of each orbit."""
    scenes, n_points = replace_unchecked(scene, values), data.sizes["point"]
    restitutions = {
        side: np.broadcast_to(np.nan if wall.soft else scenes.parameter(f"{side}.restitution"), n_points)
        for side, wall in scenes.walls.items()
    }
    periods = np.isfinite(data["x"].values).sum(axis=1)
    return restitutions, 2.0 * np.pi * periods / np.broadcast_to(scenes.frequency, n_points)
