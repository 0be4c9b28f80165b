"""Find stretches of a swept diagram: neighbouring values at which the motion has the same period."""

from dataclasses import dataclass

import numpy as np

from ..output.equal_runs import find_equal_runs
from ..scene.check import MAX_ORBIT_PERIODS
from ..scene.state import State
from ..surveys.motions import UNDECIDED as MOTION_UNDECIDED
from ..surveys.motions import classify_motions

RETURN_TOLERANCE = 1e-6  # distance of a return, relative to the largest x and v of the diagram
BAD_STATUS, NOT_SETTLED, UNDECIDED = -1, -2, -3  # codes in place of a number of periods; 0: chaotic
MOTION_WORDS = {0: "chaotic", BAD_STATUS: "bad status", NOT_SETTLED: "not settled", UNDECIDED: "undecided"}
# Periods that must be discarded; after fewer, a motion that does not recur counts as not settled.
MIN_TRANSIENT = MAX_ORBIT_PERIODS
MAX_EXTRA_PERIODS = 1024  # further drive periods of a motion that does not recur


@dataclass(frozen=True)
class Stretch:
    """Neighbouring values of one leg with the same kind of motion, in the order of the sweep.

    Attributes
    ----------
    leg : str
        Name of the leg.
    first, last : float
        First and last value.
    count : int
        Number of values.
    periods : int or None
        Period of the motion, in drive periods; for a long orbit found by continuing the motion. 0 for a motion that
        does not recur, None for a bad status.
    motion : str
        "periodic", "chaotic" (the largest Lyapunov exponent is certainly positive), "not settled" (a transient: the
        motion reaches a short orbit later, or fewer than 32 periods were discarded), "undecided" (none of these within
        1,024 further periods), or "bad status".
    """

    leg: str
    first: float
    last: float
    count: int
    periods: int | None
    motion: str


def find_stretches(sweep_data, scene, settle):
    """Return the stretches of a sweep (step, leg, period) for which `settle` periods were discarded per value."""
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
    """Return the longest period in the search: half of the kept periods, at most `MAX_ORBIT_PERIODS`."""
    return min(MAX_ORBIT_PERIODS, sweep_data.sizes["period"] // 2)


def _stretch_fields(code):
    """Return (periods, motion) of a `Stretch`."""
    return None if code == BAD_STATUS else max(code, 0), MOTION_WORDS.get(code, "periodic")


def motion_periods(sweep_data, scene, settle):
    """Return the period of the motion at each value, or a code of `MOTION_WORDS`: shape (step, leg).

    A motion whose recorded states do not recur continues from the last of them until it recurs or its largest Lyapunov
    exponent is known (`surveys.motions`).
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
    """Return the number of periods after which the kept states recur.

    Parameters
    ----------
    sweep_data : xarray.Dataset
        Result of `sweep` with dimensions (step, leg, period).

    Returns
    -------
    ndarray of shape (step, leg)
        Number of periods, 0 without recurrence, -1 for a bad status.
    """
    points = np.stack([sweep_data[key].transpose("period", "step", "leg").values for key in ("x", "v")])
    tolerance = RETURN_TOLERANCE * np.nanmax(abs(points), initial=0.0)
    periods = np.where(np.isnan(points).any(axis=(0, 1)), -1, 0)
    for n in range(1, max_recorded_period(sweep_data) + 1):
        unresolved = periods == 0
        candidates = points[:, :, unresolved]
        periods[unresolved] = np.where(abs(candidates[:, n:] - candidates[:, :-n]).max(axis=(0, 1)) <= tolerance, n, 0)
    return periods
