"""Stretches of a swept diagram: neighbouring values at which the state comes back after the same number of periods."""

from dataclasses import dataclass

import numpy as np

from ..output.equal_runs import find_equal_runs
from ..scene.check import MAX_ORBIT_PERIODS
from ..scene.state import State
from ..surveys.motions import UNDECIDED as MOTION_UNDECIDED
from ..surveys.motions import classify_motions

RETURN_TOLERANCE = 1e-6  # of the largest x and v of the diagram: a return as near as this counts
BAD_STATUS, NOT_SETTLED, UNDECIDED = -1, -2, -3  # in place of a number of periods; 0: chaotic
MOTION_WORDS = {0: "chaotic", BAD_STATUS: "bad status", NOT_SETTLED: "not settled", UNDECIDED: "undecided"}
MIN_TRANSIENT = (
    MAX_ORBIT_PERIODS  # periods left out: after fewer, a motion that does not come back counts as not settled
)
MAX_EXTRA_PERIODS = 1024  # drive periods that a motion which does not come back is run on for


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


def find_stretches(sweep_data, scene, settle):
    """The stretches of a Dataset of `sweep` with dimensions (step, leg, period), leg by leg. settle: the periods left
    out at each value."""
    values = sweep_data[sweep_data.attrs["swept"]].transpose("step", "leg").values
    periods = motion_periods(sweep_data, scene, settle)
    return [
        Stretch(
            str(leg),
            float(values[start, leg_index]),
            float(values[stop - 1, leg_index]),
            stop - start,
            *_stretch_fields(int(periods[start, leg_index])),
        )
        for leg_index, leg in enumerate(sweep_data["leg"].values)
        for start, stop in find_equal_runs(periods[:, leg_index])
    ]


def max_recorded_period(sweep_data):
    """The largest number of periods looked for: half of those kept, MOST_PERIODS at most."""
    return min(MAX_ORBIT_PERIODS, sweep_data.sizes["period"] // 2)


def _stretch_fields(code):
    """(periods, motion) of a `Stretch`."""
    return None if code == BAD_STATUS else max(code, 0), MOTION_WORDS.get(code, "periodic")


def motion_periods(sweep_data, scene, settle):
    """Periods of the motion at each value, or a code of `MOTION_WORDS`: (step, leg).

    Where the recorded states do not come back the motion is run on from the last of them, until it comes back or its
    largest Lyapunov exponent is known (`surveys.motions`).
    """
    periods = recurrence_periods(sweep_data)
    unresolved = np.nonzero(periods == 0)
    if not len(unresolved[0]) or settle < MIN_TRANSIENT:
        return np.where(periods == 0, NOT_SETTLED, periods)
    parameter, last_states = sweep_data.attrs["swept"], sweep_data.isel(period=-1)
    values, x, v = (
        array.transpose("step", "leg").values[unresolved]
        for array in (sweep_data[parameter], last_states["x"], last_states["v"])
    )
    phase = np.full_like(x, float(sweep_data.attrs["phase"]))
    swept_scenes = scene.replace(**{parameter: values.astype(scene.dtype)})
    further_periods = classify_motions(swept_scenes, State(x, v, phase, np.zeros_like(x)), 0, MAX_EXTRA_PERIODS).periods
    is_transient = (further_periods > 0) & (further_periods <= max_recorded_period(sweep_data))
    periods[unresolved] = np.select(
        [is_transient, further_periods == MOTION_UNDECIDED], [NOT_SETTLED, UNDECIDED], further_periods
    )
    return periods


def recurrence_periods(sweep_data):
    """After how many periods the states kept come back, 0 where they do not, -1 on a bad status: (step, leg)."""
    points = np.stack([sweep_data[key].transpose("period", "step", "leg").values for key in ("x", "v")])
    tolerance = RETURN_TOLERANCE * np.nanmax(abs(points), initial=0.0)
    periods = np.where(np.isnan(points).any(axis=(0, 1)), -1, 0)
    for n in range(1, max_recorded_period(sweep_data) + 1):
        unresolved = periods == 0
        candidates = points[:, :, unresolved]
        periods[unresolved] = np.where(abs(candidates[:, n:] - candidates[:, :-n]).max(axis=(0, 1)) <= tolerance, n, 0)
    return periods
