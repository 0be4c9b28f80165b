"""Find the point of the branches in a diagram that is nearest to a click."""

from collections.abc import Iterable, Sequence

import numpy as np

from ..branches.branch import Branch
from ..branches.branch_curves import variable_columns

SPECIAL_RADIUS = 0.02  # relative to the panel: a special point within this distance is selected
MAX_DISTANCE = 0.08  # relative to the panel: no point beyond this distance is selected


def nearest_point(
    branches: Iterable[tuple[str, Branch]],
    variable: str,
    click: Sequence[float],
    axis_limits: Sequence[Sequence[float]],
) -> tuple[str, int | None] | None:
    """Return (reference, index) of the nearest point of branches; None if no point is near.

    The index of a special point is None. A special point within `SPECIAL_RADIUS` takes precedence. `click` is (x, y),
    and `axis_limits` are the limits of the x and y axes.
    """
    candidate_points: list[tuple[float, str, int | None]] = []
    for reference, branch in branches:
        parameter_column = branch.values[:, None]
        relative_offsets = [
            (branch_column - click_coordinate) / (upper - lower)
            for branch_column, click_coordinate, (lower, upper) in zip(
                (parameter_column, variable_columns(branch, variable)), click, axis_limits, strict=True
            )
        ]
        distances = np.nan_to_num(np.hypot(*relative_offsets), nan=np.inf).min(axis=1)
        row_by_special_index = {
            special_index: special_point.place
            for special_index, special_point in enumerate(branch.special)
            if special_point.kind != "EP"
        }
        candidate_points += [
            (distances[row] - 1.0, f"{reference}.special[{special_index}]", None)
            for special_index, row in row_by_special_index.items()
            if distances[row] <= SPECIAL_RADIUS
        ]
        candidate_points.append((distances.min(), reference, int(distances.argmin())))
    nearest_candidate = min(candidate_points, key=lambda candidate: candidate[0], default=None)
    return None if nearest_candidate is None or nearest_candidate[0] > MAX_DISTANCE else nearest_candidate[1:]
