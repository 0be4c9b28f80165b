"""Which point of the branches in a diagram is the nearest to a click."""

from collections.abc import Iterable, Sequence

import numpy as np

from ..branches.branch import Branch
from ..branches.curves import variable_columns

SPECIAL_RADIUS = 0.02  # of the panel's width and height: so near to a special point that is meant
MAX_DISTANCE = 0.08  # the same: beyond it no point is meant


def nearest_point(
    curves: Iterable[tuple[str, Branch]], variable: str, click: Sequence[float], axis_limits: Sequence[Sequence[float]]
) -> tuple[str, int | None] | None:
    """(reference, place) of the nearest point of branches; of a special point that is near its own and None; None where
    nothing is near.

    click: (across, up); axis_limits: the limits of the axes, of (across, up).
    """
    candidates: list[tuple[float, str, int | None]] = []
    for reference, branch in curves:
        parameter_column = branch.values[:, None]
        offsets = [
            (column - coordinate) / (upper - lower)
            for column, coordinate, (lower, upper) in zip(
                (parameter_column, variable_columns(branch, variable)), click, axis_limits, strict=True
            )
        ]
        distances = np.nan_to_num(np.hypot(*offsets), nan=np.inf).min(axis=1)
        special_rows = {k: special.place for k, special in enumerate(branch.special) if special.kind != "EP"}
        candidates += [
            (distances[row] - 1.0, f"{reference}.special[{k}]", None)
            for k, row in special_rows.items()
            if distances[row] <= SPECIAL_RADIUS
        ]
        candidates.append((distances.min(), reference, int(distances.argmin())))
    closest = min(candidates, key=lambda candidate: candidate[0], default=None)
    return None if closest is None or closest[0] > MAX_DISTANCE else closest[1:]
