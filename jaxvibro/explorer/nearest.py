"""Which point of the branches in a diagram is the nearest to a click."""

from collections.abc import Iterable, Sequence

import numpy as np

from ..branches.branch import Branch
from ..branches.curves import columns_of

SPECIAL = 0.02  # of the panel's width and height: so near to a special point that is meant
FARTHEST = 0.08  # the same: beyond it no point is meant


def nearest(
    curves: Iterable[tuple[str, Branch]], variable: str, at: Sequence[float], box: Sequence[Sequence[float]]
) -> tuple[str, int | None] | None:
    """(reference, place) of the nearest point of branches; of a special point that is near its own and None; None where
    nothing is near.

    at: (across, up); box: the limits of the axes, of (across, up).
    """
    found: list[tuple[float, str, int | None]] = []
    for reference, one in curves:
        across = one.values[:, None]
        gaps = [
            (part - place) / (high - low)
            for part, place, (low, high) in zip((across, columns_of(one, variable)), at, box, strict=True)
        ]
        apart = np.nan_to_num(np.hypot(*gaps), nan=np.inf).min(axis=1)
        places = {k: each.place for k, each in enumerate(one.special) if each.kind != "EP"}
        found += [(apart[p] - 1.0, f"{reference}.special[{k}]", None) for k, p in places.items() if apart[p] <= SPECIAL]
        found.append((apart.min(), reference, int(apart.argmin())))
    best = min(found, key=lambda each: each[0], default=None)
    return None if best is None or best[0] > FARTHEST else best[1:]
