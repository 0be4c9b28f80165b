"""Group the motions of the initial states of a cell into attractors."""

import numpy as np

from ..orbits.orbit_comparison import samples_fill_same_set
from ..stores.study_protocol import blank_columns
from . import map_columns
from .motion_classification import CHAOTIC, UNDECIDED, MotionResults


def attractor_columns(scene, motions: MotionResults, n_starts: int, study_columns) -> dict[str, np.ndarray]:
    """Return the columns {name: array}, cells on the first axis, of the attractors of `n_starts` motions per cell."""
    n_cells, label_codes = len(motions.periods) // n_starts, map_columns.motion_label_codes(motions)
    columns = blank_columns(study_columns, (n_cells,))
    cell_index_lane_triples: list[tuple[int, int, int]] = []  # cell, index and lane of each stored attractor
    columns["label"][:], columns["share"][:] = 0, 0.0
    for cell_index in range(n_cells):
        lanes = np.arange(cell_index * n_starts, (cell_index + 1) * n_starts)
        attractor_lanes = group_by_attractor(motions, label_codes, lanes)
        columns["status"][cell_index] = motions.status[lanes].max()
        columns["unresolved"][cell_index] = 1.0 - sum(map(len, attractor_lanes)) / n_starts
        if "attractors" in columns:
            columns["attractors"][cell_index] = len(attractor_lanes)
        for attractor_index, lane_group in enumerate(attractor_lanes[: map_columns.MAX_ATTRACTORS]):
            columns["share"][cell_index, attractor_index] = len(lane_group) / n_starts
            cell_index_lane_triples.append((cell_index, attractor_index, lane_group[0]))
    if cell_index_lane_triples:
        cell_indices, attractor_indices, lane = np.array(cell_index_lane_triples).T
        attractor_scenes, attractor_motions = map_columns.select_motion_lanes(scene, motions, lane)
        attractor_values = map_columns.motion_columns(attractor_scenes, attractor_motions, study_columns)
        for name, array in attractor_values.items():
            if name != "status":
                columns[name][cell_indices, attractor_indices] = array
    return columns


def group_by_attractor(motions: MotionResults, label_codes, lanes) -> list[list[int]]:
    """Return the lanes of each attractor, in order of decreasing number of lanes, label code and first lane.

    Undecided lanes are omitted. Two orbits are the same if they have a point on the section in common. Two chaotic
    motions are on the same attractor if they fill the same set (`orbit_comparison.samples_fill_same_set`).
    """
    attractor_lanes: list[list[int]] = []
    max_state_magnitude = np.nanmax(abs(motions.points[-1, lanes]), initial=1.0)
    tolerance = np.finfo(motions.points.dtype).eps ** 0.4 * max_state_magnitude
    for lane in lanes[motions.periods[lanes] != UNDECIDED].tolist():
        lane_group = next(
            (
                lane_group
                for lane_group in attractor_lanes
                if _are_on_same_attractor(motions, lane_group[0], lane, tolerance)
            ),
            None,
        )
        if lane_group is None:
            attractor_lanes.append([lane])
        else:
            lane_group.append(lane)
    return sorted(attractor_lanes, key=lambda group: (-len(group), int(label_codes[group[0]]), group[0]))


def _are_on_same_attractor(motions, first_lane, second_lane, tolerance):
    """Return True if two lanes are on the same attractor."""
    n_periods = motions.periods[first_lane]
    if n_periods != motions.periods[second_lane]:
        return False
    if n_periods == CHAOTIC:
        lane_points = (motions.points[:, lane] for lane in (first_lane, second_lane))
        return samples_fill_same_set(*(points[np.isfinite(points).all(axis=1)] for points in lane_points))
    return bool(
        (abs(motions.points[-n_periods:, first_lane] - motions.points[-1, second_lane]).max(axis=1) <= tolerance).any()
    )
