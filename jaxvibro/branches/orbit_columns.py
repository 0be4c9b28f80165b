"""The columns of a table of orbits, a row each, with their units."""

import numpy as np

from ..output.frames import of_least, of_multipliers
from ..output.units import LENGTH, POWER, SPEED, unit_of
from ..problem import loads, stability
from ..scene.scene import changed


def orbit_columns(scene, values, data, labels, multipliers):
    """{column: (unit, values)} of orbits. values: {parameter: (points,)}, which the scenes of the orbits have; data: as
    of a `Branch`; labels: (points,); multipliers: (points, 2)."""
    sides, speeds, least = data["side"].values, data["speed"].values, of_least(data)
    return {
        **{name: (unit_of(name), each) for name, each in values.items()},
        "label": ("", labels),
        "stability": ("", stability.words(multipliers)),
        "x": (LENGTH, data["x"].values[:, 0]),
        "v": (SPEED, data["v"].values[:, 0]),
        "least_speed": least["least_speed"],
        "largest_speed": (SPEED, loads.largest_speed(sides, speeds)),
        "least_clearance": least["least_clearance"],
        "work_rate": (POWER, loads.work_rate(sides, speeds, *_rebounds_and_spans(scene, values, data))),
        **of_multipliers(multipliers),
    }


def _rebounds_and_spans(scene, values, data):
    """({side: R at each point, nan of a soft wall}, how long each orbit lasts)."""
    scenes, count = changed(scene, values), data.sizes["point"]
    rebounds = {
        side: np.broadcast_to(np.nan if wall.soft else scenes.parameter(f"{side}.restitution"), count)
        for side, wall in scenes.walls.items()
    }
    periods = np.isfinite(data["x"].values).sum(axis=1)
    return rebounds, 2.0 * np.pi * periods / np.broadcast_to(scenes.frequency, count)
