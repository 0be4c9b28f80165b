"""The attractors of a cell: the motions of its many starts, put together where they are on the same one."""

import numpy as np

from ..orbits.orbit_comparison import is_same_set
from ..stores.study import blank
from . import cell_columns
from .motions import CHAOTIC, UNDECIDED, Motions


def of_starts(scene, found: Motions, starts: int, asked) -> dict[str, np.ndarray]:
    """{name: numbers}, the cells first, from the motions of so many starts of each cell, one after the other."""
    cells, codes = len(found.periods) // starts, cell_columns.labels(found)
    columns = blank(asked, (cells,))
    told: list[tuple[int, int, int]] = []  # cell, place, lane of each attractor that is told
    columns["label"][:], columns["share"][:] = 0, 0.0
    for cell in range(cells):
        lanes = np.arange(cell * starts, (cell + 1) * starts)
        groups = told_apart(found, codes, lanes)
        columns["status"][cell] = found.status[lanes].max()
        columns["unresolved"][cell] = 1.0 - sum(map(len, groups)) / starts
        if "attractors" in columns:
            columns["attractors"][cell] = len(groups)
        for place, group in enumerate(groups[: cell_columns.MOST]):
            columns["share"][cell, place] = len(group) / starts
            told.append((cell, place, group[0]))
    if told:
        cell, place, lane = np.array(told).T
        here, these = cell_columns.of_lanes(scene, found, lane)
        own = cell_columns.of_motions(here, these, asked)
        for name, each in own.items():
            if name != "status":
                columns[name][cell, place] = each
    return columns


def told_apart(found: Motions, codes, lanes) -> list[list[int]]:
    """The lanes of each attractor, those that are undecided on none: the most first, then by code and first lane.

    Orbits are the same where they have a point on Sigma in common; chaotic motions where they fill the same set
    (`orbit_comparison.is_same_set`).
    """
    groups: list[list[int]] = []
    scale = np.nanmax(abs(found.points[-1, lanes]), initial=1.0)
    near = np.finfo(found.points.dtype).eps ** 0.4 * scale
    for lane in lanes[found.periods[lanes] != UNDECIDED].tolist():
        home = next((one for one in groups if _is_same(found, one[0], lane, near)), None)
        if home is None:
            groups.append([lane])
        else:
            home.append(lane)
    return sorted(groups, key=lambda one: (-len(one), int(codes[one[0]]), one[0]))


def _is_same(found, one, other, near):
    n = found.periods[one]
    if n != found.periods[other]:
        return False
    if n == CHAOTIC:
        samples = (found.points[:, lane] for lane in (one, other))
        return is_same_set(*(points[np.isfinite(points).all(axis=1)] for points in samples))
    return bool((abs(found.points[-n:, one] - found.points[-1, other]).max(axis=1) <= near).any())
