"""Stretches of a swept diagram: neighbouring values at which the state comes back after the same number of periods."""

from dataclasses import dataclass

import numpy as np

from ..output.runs import runs
from ..scene.check import MOST_PERIODS
from ..scene.state import State
from ..surveys.motions import UNDECIDED as MOTION_UNDECIDED
from ..surveys.motions import motions

NEAR = 1e-6  # of the largest x and v of the diagram: a return as near as this counts
BAD, NOT_SETTLED, UNDECIDED = -1, -2, -3  # in place of a number of periods; 0: chaotic
WORDS = {0: "chaotic", BAD: "bad status", NOT_SETTLED: "not settled", UNDECIDED: "undecided"}
TRANSIENT = MOST_PERIODS  # periods left out: after fewer, a motion that does not come back counts as not settled
PATIENCE = 1024  # drive periods that a motion which does not come back is run on for


@dataclass(frozen=True)
class Stretch:
    """Values of one leg, in the order of the sweep, from `first` to `last`, `count` of them.

    periods: the least number of drive periods after which the states come back, of a long orbit found by running on; 0
    where they do not; None where the status was bad. motion: "periodic", "chaotic" (the largest Lyapunov exponent is
    positive beyond doubt), "not settled" (a transient: the motion settles on a short orbit later, or fewer than 32
    periods were left out), "undecided" (none of these within 1,024 periods more), or "bad status".
    """

    leg: str
    first: float
    last: float
    count: int
    periods: int | None
    motion: str


def stretches(swept, scene, settle):
    """The stretches of a Dataset of `sweep` with dimensions (step, leg, period), leg by leg. settle: the periods left
    out at each value."""
    values = swept[swept.attrs["swept"]].transpose("step", "leg").values
    found = kinds(swept, scene, settle)
    return [
        Stretch(
            str(leg),
            float(values[first, k]),
            float(values[last - 1, k]),
            last - first,
            *_told(int(found[first, k])),
        )
        for k, leg in enumerate(swept["leg"].values)
        for first, last in runs(found[:, k])
    ]


def longest(swept):
    """The largest number of periods looked for: half of those kept, MOST_PERIODS at most."""
    return min(MOST_PERIODS, swept.sizes["period"] // 2)


def _told(number):
    """(periods, motion) of a `Stretch`."""
    return None if number == BAD else max(number, 0), WORDS.get(number, "periodic")


def kinds(swept, scene, settle):
    """Periods of the motion at each value, or a code of `WORDS`: (step, leg).

    Where the recorded states do not come back the motion is run on from the last of them, until it comes back or its
    largest Lyapunov exponent is known (`surveys.motions`).
    """
    found = recurrence(swept)
    lost = np.nonzero(found == 0)
    if not len(lost[0]) or settle < TRANSIENT:
        return np.where(found == 0, NOT_SETTLED, found)
    name, last = swept.attrs["swept"], swept.isel(period=-1)
    values, x, v = (each.transpose("step", "leg").values[lost] for each in (swept[name], last["x"], last["v"]))
    phase = np.full_like(x, float(swept.attrs["phase"]))
    there = scene.replace(**{name: values.astype(scene.dtype)})
    onward = motions(there, State(x, v, phase, np.zeros_like(x)), 0, PATIENCE).periods
    short = (onward > 0) & (onward <= longest(swept))
    found[lost] = np.select([short, onward == MOTION_UNDECIDED], [NOT_SETTLED, UNDECIDED], onward)
    return found


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
