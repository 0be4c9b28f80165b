"""The mirror image of a branch of a symmetric scene: `mirrored`.

(x, v, phase) -> (-x, -v, phase + pi): the other walls half a drive period later, with the same speeds (paper, section
1).
"""

from dataclasses import replace

import numpy as np

from ..problem.diagnostics import diagnose
from ..problem.orbit_on_branch import itinerary, label_of, place_orbit
from ..problem.orbit_rows import row_of, spot_of
from .branch import frequency_at, special_of


def mirrored(branch):
    """The `Branch` of the mirror images of a branch's orbits; its scene is one that `stays_symmetric`."""
    data = _data(branch)
    special = (_special(branch, data, one) for one in branch.special)
    segments = (_segment(branch, data, one) for one in branch.segments)
    return replace(branch, data=data, segments=tuple(segments), special=tuple(special))


def _data(branch):
    """The data with the impacts half a period later on the other walls, x and v at phase 0 anew."""
    data, name = branch.data, branch.name
    half = np.broadcast_to(np.pi / frequency_at(branch.scene, name, branch.values), branch.values.shape)
    late = half[:, None] + data["time"]
    slopes = data["time_slope"]
    if name == "frequency":
        slopes = slopes - (half / branch.values * data["value_slope"].values)[:, None]
    turned = data.assign(time=late, side=-data["side"], time_slope=slopes)
    x, v = data["x"].values.copy(), data["v"].values.copy()
    for one in branch.segments:
        rows = slice(one.first, one.last + 1)
        spot = spot_of(row_of(turned, one.first), name)
        if len(spot.times):
            look = _look(branch, spot, turned.isel(point=rows))
            x[rows], v[rows] = look.x, look.v
    return turned.assign(x=data["x"].copy(data=x), v=data["v"].copy(data=v))


def _look(branch, spot, rows):
    """The `Diagnostics` at rows of one itinerary, that of a `OrbitPoint`."""
    along, z = place_orbit(branch.scene, branch.name, spot)
    count, wide = len(spot.times), len(along.cycle.sides)
    hit = rows["side"].values[0] != 0
    zs = np.zeros((rows.sizes["point"], len(z)))
    zs[:, :count], zs[:, wide : wide + count] = rows["time"].values[:, hit], rows["speed"].values[:, hit]
    zs[:, -1] = rows[branch.name].values
    return diagnose(along, zs)


def _special(branch, data, one):
    row, joins = row_of(data, one.place), [_reflected(one.scene, one.name, spot) for spot in one.joins]
    return special_of(
        branch.scene, branch.name, branch.bounds, one.place, row, one.kind, one.residual, joins, one.aside
    )


def _reflected(scene, name, spot):
    """The mirror image of a `OrbitPoint`; without impacts it is its own."""
    if not len(spot.times):
        return spot
    late = spot.times + np.pi / frequency_at(scene, name, spot.value)
    turned = spot._replace(times=late, sides=-spot.sides)
    along, z = place_orbit(scene, name, turned)
    look = diagnose(along, z[None])
    return turned._replace(x=float(look.x[0, 0]), v=float(look.v[0, 0]))


def _segment(branch, data, one):
    row = row_of(data, one.first)
    spot = spot_of(row, branch.name)
    walls = itinerary(spot, float(frequency_at(branch.scene, branch.name, row[branch.name])))
    return replace(one, label=label_of(branch.scene, spot, walls), itinerary=walls)
