"""Compute the mirror image of a branch of a symmetric scene.

The symmetry maps (x, v, phase) to (-x, -v, phase + pi). The impacts of the mirror image are on the other walls, half a
drive period later, with the same speeds (paper, section 1).
"""

from dataclasses import replace

import numpy as np

from ..problem.orbit_curve import dataset_row, unknowns_of_rows
from ..problem.orbit_diagnostics import diagnose
from ..problem.orbit_point import label_of_point
from ..problem.orbit_problem import make_orbit_problem
from .branch import make_special, multipliers_of_row, point_of_row


def mirror_branch(branch):
    """Return the branch of the mirror images of a branch's orbits.

    The scene and the parameter of the branch must satisfy `stays_symmetric`.
    """
    template = make_orbit_problem(branch.scene, branch.name, periods=1)
    data = _mirrored_data(branch, template)
    rows = [special.place for special in branch.special] + [segment.first for segment in branch.segments]
    points = {row: point_of_row(template, branch.name, dataset_row(data, row)) for row in rows}
    return replace(
        branch,
        data=data,
        segments=tuple(_mirrored_segment(branch, points[segment.first], segment) for segment in branch.segments),
        special=tuple(_mirrored_special(branch, data, points[special.place], special) for special in branch.special),
    )


def _mirrored_data(branch, template):
    """Move the impacts to the other walls half a drive period later, and recompute x and v at phase 0."""
    data, name = branch.data, branch.name
    frequencies = branch.values if name == "frequency" else float(branch.scene.frequency)
    half_period = np.broadcast_to(np.pi / frequencies, branch.values.shape)
    mirrored_times = half_period[:, None] + data["time"]
    time_slopes = data["time_slope"]
    if name == "frequency":
        time_slopes = time_slopes - (half_period / branch.values * data["value_slope"].values)[:, None]
    mirrored_data = data.assign(time=mirrored_times, side=-data["side"], time_slope=time_slopes)
    x, v = data["x"].values.copy(), data["v"].values.copy()
    for segment in branch.segments:
        rows = slice(segment.first, segment.last + 1)
        problem = point_of_row(template, name, dataset_row(mirrored_data, segment.first)).problem
        if problem.n_rows:
            diagnostics = diagnose(problem, unknowns_of_rows(mirrored_data.isel(point=rows), name, problem))
            x[rows], v[rows] = diagnostics.x, diagnostics.v
    return mirrored_data.assign(x=data["x"].copy(data=x), v=data["v"].copy(data=v))


def _mirrored_special(branch, data, orbit_point, special):
    neighbours = [
        neighbour.mirror().with_section_state() if neighbour.problem.n_rows else neighbour
        for neighbour in special.joins
    ]
    return make_special(
        branch.scene,
        branch.name,
        branch.bounds,
        special.place,
        orbit_point,
        multipliers_of_row(dataset_row(data, special.place)),
        special.kind,
        special.residual,
        neighbours,
        special.aside,
    )


def _mirrored_segment(branch, orbit_point, segment):
    itinerary = orbit_point.itinerary
    return replace(segment, label=label_of_point(branch.scene, orbit_point, itinerary), itinerary=itinerary)
