"""Find the point of the branches in a diagram that is nearest to a click."""

from collections.abc import Iterable, Sequence

import numpy as np

from ..branches.branch import Branch
from ..branches.curves import variable_columns

SPECIAL_RADIUS = 0.02  # relative to the panel: a special point within this distance is selected
MAX_DISTANCE = 0.08  # relative to the panel: no point beyond this distance is selected


def nearest_point(
    curves: Iterable[tuple[str, Branch]], variable: str, click: Sequence[float], axis_limits: Sequence[Sequence[float]]
) -> tuple[str, int | None] | None:
    """Return (reference, index) of the nearest point of branches; None if no point is near.

    The index of a special point is None, and a special point that is near takes precedence. `click` is (x, y), and
    `axis_limits` are the limits of the x and y axes.
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
