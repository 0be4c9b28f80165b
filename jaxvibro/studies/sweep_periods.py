"""Stretches of a swept diagram: neighbouring values at which the state comes back after the same number of periods."""

from dataclasses import dataclass

import numpy as np

from ..output.runs import runs
from ..scene.check import MOST_PERIODS

NEAR = 1e-6  # of the largest x and v of the diagram: a return as near as this counts


@dataclass(frozen=True)
class Stretch:
    """Values of one leg, in the order of the sweep, from `first` to `last`, `count` of them.

    periods: the least number of drive periods after which the states kept at each of these values come back; 0 where
    they do not, which may be chaos, a longer orbit, or a motion that has not settled; None where the status was bad.
    """

    leg: str
    first: float
    last: float
    count: int
    periods: int | None


def stretches(swept):
    """The stretches of a Dataset of `sweep` with dimensions (step, leg, period), leg by leg."""
    values = swept[swept.attrs["swept"]].transpose("step", "leg").values
    found = recurrence(swept)
    return [
        Stretch(str(leg), float(values[first, k]), float(values[last - 1, k]), last - first, _periods(found[first, k]))
        for k, leg in enumerate(swept["leg"].values)
        for first, last in runs(found[:, k])
    ]


def longest(swept):
    """The largest number of periods looked for: half of those kept, MOST_PERIODS at most."""
    return min(MOST_PERIODS, swept.sizes["period"] // 2)


def _periods(number):
    return None if number < 0 else int(number)


def recurrence(swept):
    """After how many periods the states kept come back, 0 where they do not, -1 on a bad status: (step, leg)."""
    points = np.stack([swept[key].transpose("period", "step", "leg").values for key in ("x", "v")])
    near = NEAR * np.nanmax(abs(points), initial=0.0)
    found = np.where(np.isnan(points).any(axis=(0, 1)), -1, 0)
    for n in range(1, longest(swept) + 1):
        left = found == 0
        some = points[:, :, left]
        found[left] = np.where(abs(some[:, n:] - some[:, :-n]).max(axis=(0, 1)) <= near, n, 0)
    return found
