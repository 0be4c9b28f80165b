"""Make the columns of a table of orbits, with units."""

import numpy as np

from ..output.dataframes import multiplier_columns, speed_clearance_columns
from ..output.units import LENGTH, POWER, SPEED, unit_of
from ..problem import impact_loads, stability_descriptions
from ..scene.scene import replace_unchecked


def orbit_columns(scene, values_by_parameter, data, labels, multipliers):
    """Return ``{column: (unit, values)}`` of orbits.

    `values_by_parameter` maps parameters to arrays of shape (points,). `data` is the dataset of a branch. `labels` has
    the shape (points,), and `multipliers` has the shape (points, 2)."""
    sides, speeds, minimum_columns = data["side"].values, data["speed"].values, speed_clearance_columns(data)
    return {
        **{name: (unit_of(name), parameter_values) for name, parameter_values in values_by_parameter.items()},
        "label": ("", labels),
        "stability": ("", stability_descriptions.stability_words(multipliers)),
        "x": (LENGTH, data["x"].values[:, 0]),
        "v": (SPEED, data["v"].values[:, 0]),
        "least_speed": minimum_columns["least_speed"],
        "largest_speed": (SPEED, impact_loads.largest_speed(sides, speeds)),
        "least_clearance": minimum_columns["least_clearance"],
        "work_rate": (
            POWER,
            impact_loads.work_rate(sides, speeds, *_work_rate_arguments(scene, values_by_parameter, data)),
        ),
        **multiplier_columns(multipliers),
    }


def _work_rate_arguments(scene, values_by_parameter, data):
    """Return the restitution of each wall at each point, nan if soft, and the duration of each orbit."""
    scenes, n_points = replace_unchecked(scene, values_by_parameter), data.sizes["point"]
    restitutions_by_wall = {
        side: np.broadcast_to(np.nan if wall.soft else scenes.parameter(f"{side}.restitution"), n_points)
        for side, wall in scenes.walls.items()
    }
    periods = np.isfinite(data["x"].values).sum(axis=1)
    return restitutions_by_wall, 2.0 * np.pi * periods / np.broadcast_to(scenes.frequency, n_points)
