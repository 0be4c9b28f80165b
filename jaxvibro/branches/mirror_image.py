"""Compute the mirror image of a branch of a symmetric scene.

The symmetry maps (x, v, phase) to (-x, -v, phase + pi). The impacts of the mirror image are on the other walls, half a
drive period later, with the same speeds (paper, section 1).
"""

from dataclasses import replace

import numpy as np

from ..problem.orbit_curve import dataset_row, parse_orbit_point
from ..problem.orbit_diagnostics import diagnose
from ..problem.orbit_point import itinerary_of_point, label_of_point, set_up_equations
from .branch import frequency_at, make_special


def mirror_branch(branch):
    """Return the branch of the mirror images of a branch's orbits.

    The scene and the parameter of the branch must satisfy `stays_symmetric`.
    """
    data = _mirrored_data(branch)
    special_points = (_mirrored_special(branch, data, entry) for entry in branch.special)
    segments = (_mirrored_segment(branch, data, entry) for entry in branch.segments)
    return replace(branch, data=data, segments=tuple(segments), special=tuple(special_points))


def _mirrored_data(branch):
    """Move the impacts to the other walls half a drive period later, and recompute x and v at phase 0."""
    data, name = branch.data, branch.name
    half_period = np.broadcast_to(np.pi / frequency_at(branch.scene, name, branch.values), branch.values.shape)
    mirrored_times = half_period[:, None] + data["time"]
    time_slopes = data["time_slope"]
    if name == "frequency":
        time_slopes = time_slopes - (half_period / branch.values * data["value_slope"].values)[:, None]
    mirrored_data = data.assign(time=mirrored_times, side=-data["side"], time_slope=time_slopes)
    x, v = data["x"].values.copy(), data["v"].values.copy()
    for segment in branch.segments:
        rows = slice(segment.first, segment.last + 1)
        orbit_row = parse_orbit_point(dataset_row(mirrored_data, segment.first), name)
        if len(orbit_row.times):
            diagnostics = _diagnose_rows(branch, orbit_row, mirrored_data.isel(point=rows))
            x[rows], v[rows] = diagnostics.x, diagnostics.v
    return mirrored_data.assign(x=data["x"].copy(data=x), v=data["v"].copy(data=v))


def _diagnose_rows(branch, orbit_row, segment_data):
    """Compute the `Diagnostics` at rows with the itinerary of an `OrbitPoint`."""
    problem, z = set_up_equations(branch.scene, branch.name, orbit_row)
    n_impacts, n_sequence_rows = len(orbit_row.times), len(problem.sequence.sides)
    is_impact = segment_data["side"].values[0] != 0
    zs = np.zeros((segment_data.sizes["point"], len(z)))
    zs[:, :n_impacts], zs[:, n_sequence_rows : n_sequence_rows + n_impacts] = (
        segment_data["time"].values[:, is_impact],
        segment_data["speed"].values[:, is_impact],
    )
    zs[:, -1] = segment_data[branch.name].values
    return diagnose(problem, zs)


def _mirrored_special(branch, data, special):
    row, neighbours = (
        dataset_row(data, special.place),
        [_mirrored_orbit_row(special.scene, special.name, orbit_row) for orbit_row in special.joins],
    )
    return make_special(
        branch.scene,
        branch.name,
        branch.bounds,
        special.place,
        row,
        special.kind,
        special.residual,
        neighbours,
        special.aside,
    )


def _mirrored_orbit_row(scene, name, orbit_row):
    """Return the mirror image of an `OrbitPoint`; an orbit without impacts is its own mirror image."""
    if not len(orbit_row.times):
        return orbit_row
    mirrored_times = orbit_row.times + np.pi / frequency_at(scene, name, orbit_row.value)
    mirrored_row = orbit_row._replace(times=mirrored_times, sides=-orbit_row.sides)
    problem, z = set_up_equations(scene, name, mirrored_row)
    diagnostics = diagnose(problem, z[None])
    return mirrored_row._replace(x=float(diagnostics.x[0, 0]), v=float(diagnostics.v[0, 0]))


def _mirrored_segment(branch, data, segment):
    row = dataset_row(data, segment.first)
    orbit_row = parse_orbit_point(row, branch.name)
    itinerary = itinerary_of_point(orbit_row, float(frequency_at(branch.scene, branch.name, row[branch.name])))
    return replace(segment, label=label_of_point(branch.scene, orbit_row, itinerary), itinerary=itinerary)
