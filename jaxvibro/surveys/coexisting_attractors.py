"""Group the motions of the initial states of a cell into attractors."""

import numpy as np

from ..orbits.orbit_comparison import is_same_set
from ..stores.study import blank_columns
from . import cell_columns
from .motions import CHAOTIC, UNDECIDED, MotionResults


def attractor_columns(scene, motions: MotionResults, n_starts: int, study_columns) -> dict[str, np.ndarray]:
    """Return {name: array}, cells first, from the motions of the `n_starts` initial states of each cell."""
    n_cells, label_codes = len(motions.periods) // n_starts, cell_columns.motion_labels(motions)
    columns = blank_columns(study_columns, (n_cells,))
    representatives: list[tuple[int, int, int]] = []  # cell, index and lane of each stored attractor
    columns["label"][:], columns["share"][:] = 0, 0.0
    for cell in range(n_cells):
        lanes = np.arange(cell * n_starts, (cell + 1) * n_starts)
        groups = group_lanes(motions, label_codes, lanes)
        columns["status"][cell] = motions.status[lanes].max()
        columns["unresolved"][cell] = 1.0 - sum(map(len, groups)) / n_starts
        if "attractors" in columns:
            columns["attractors"][cell] = len(groups)
        for index, group in enumerate(groups[: cell_columns.MAX_ATTRACTORS]):
            columns["share"][cell, index] = len(group) / n_starts
            representatives.append((cell, index, group[0]))
    if representatives:
        cell, index, lane = np.array(representatives).T
        lane_scenes, lane_motions = cell_columns.select_motions(scene, motions, lane)
        lane_columns = cell_columns.motion_columns(lane_scenes, lane_motions, study_columns)
        for name, array in lane_columns.items():
            if name != "status":
                columns[name][cell, index] = array
    return columns


def group_lanes(motions: MotionResults, label_codes, lanes) -> list[list[int]]:
    """Return the lanes of each attractor, the most frequent first, then by code and first lane.

    Undecided lanes are on none. Orbits are the same if they have a point on the section in common; chaotic motions if
    they fill the same set (`orbit_comparison.is_same_set`).
    """
    groups: list[list[int]] = []
    scale = np.nanmax(abs(motions.points[-1, lanes]), initial=1.0)
    tolerance = np.finfo(motions.points.dtype).eps ** 0.4 * scale
    for lane in lanes[motions.periods[lanes] != UNDECIDED].tolist():
        group = next((group for group in groups if _is_same(motions, group[0], lane, tolerance)), None)
        if group is None:
            groups.append([lane])
        else:
            group.append(lane)
    return sorted(groups, key=lambda group: (-len(group), int(label_codes[group[0]]), group[0]))


def _is_same(motions, first_lane, second_lane, tolerance):
    """Return True if two lanes are on the same attractor."""
    n_periods = motions.periods[first_lane]
    if n_periods != motions.periods[second_lane]:
        return False
    if n_periods == CHAOTIC:
        samples = (motions.points[:, lane] for lane in (first_lane, second_lane))
        return is_same_set(*(points[np.isfinite(points).all(axis=1)] for points in samples))
    return bool(
        (abs(motions.points[-n_periods:, first_lane] - motions.points[-1, second_lane]).max(axis=1) <= tolerance).any()
    )
