"""Find stretches of a swept diagram: consecutive values at which the motion has the same period."""

from dataclasses import dataclass

import numpy as np

from ..output.equal_runs import find_equal_runs
from ..scene.check import MAX_ORBIT_PERIODS
from ..scene.state import State
from ..surveys.motion_classification import UNDECIDED as MOTION_UNDECIDED
from ..surveys.motion_classification import classify_motions

RETURN_TOLERANCE = 1e-6  # distance of a return, relative to the largest x and v of the diagram
BAD_STATUS, NOT_SETTLED, UNDECIDED = -1, -2, -3  # codes in place of a number of periods; 0: chaotic
MOTION_WORDS = {0: "chaotic", BAD_STATUS: "bad status", NOT_SETTLED: "not settled", UNDECIDED: "undecided"}
# Periods that must be discarded; after fewer, a motion that does not recur counts as not settled.
MIN_TRANSIENT = MAX_ORBIT_PERIODS
MAX_EXTRA_PERIODS = 1024  # further drive periods of a motion that does not recur


@dataclass(frozen=True)
class SweepStretch:
    """Stretch of a swept diagram: consecutive values of a leg with the same period or kind of motion.

    Attributes
    ----------
    leg : str
        Name of the leg.
    first, last : float
        First and last value, in the order of the sweep.
    count : int
        Number of values.
    periods : int or None
        Period of the motion, in drive periods. Long periods are found by continuing the motion. 0 means that the motion
        does not recur, and None a bad status.
    motion : str
        "periodic", "chaotic" (the largest Lyapunov exponent is certainly positive), "not settled" (a transient: the
        motion reaches a short orbit later, or fewer than 32 periods were discarded), "undecided" (no decision within
        1,024 further periods), or "bad status".
    """

    leg: str
    first: float
    last: float
    count: int
    periods: int | None
    motion: str


def find_sweep_stretches(sweep_data, scene, settle):
    """Return the stretches of a sweep with dimensions (step, leg, period).

    `settle` is the number of drive periods that the sweep discarded at each value.
    """
    parameter_values = sweep_data[sweep_data.attrs["swept"]].transpose("step", "leg").values
    periods = find_motion_periods(sweep_data, scene, settle)
    return [
        SweepStretch(
            str(leg),
            float(parameter_values[start, leg_index]),
            float(parameter_values[stop - 1, leg_index]),
            stop - start,
            *_stretch_fields(int(periods[start, leg_index])),
        )
        for leg_index, leg in enumerate(sweep_data["leg"].values)
        for start, stop in find_equal_runs(periods[:, leg_index])
    ]


def max_recurrence_period(sweep_data):
    """Return the longest period for which recurrence is tested.

    The result is half the number of recorded periods, and at most `MAX_ORBIT_PERIODS`.
    """
    return min(MAX_ORBIT_PERIODS, sweep_data.sizes["period"] // 2)


def _stretch_fields(period_code):
    """Return the fields (periods, motion) of a `SweepStretch` for a period or a code of `MOTION_WORDS`."""
    return None if period_code == BAD_STATUS else max(period_code, 0), MOTION_WORDS.get(period_code, "periodic")


def find_motion_periods(sweep_data, scene, settle):
    """Return the period of the motion at each value, or a code of `MOTION_WORDS`, shape (step, leg).

    A motion whose recorded states do not recur is continued from its last state by `classify_motions`, until it recurs
    or its largest Lyapunov exponent is known. If the sweep discarded fewer than `MIN_TRANSIENT` periods, the motion is
    not continued and counts as not settled.
    """
    periods = find_recurrence_periods(sweep_data)
    unresolved_indices = np.nonzero(periods == 0)
    if not len(unresolved_indices[0]) or settle < MIN_TRANSIENT:
        return np.where(periods == 0, NOT_SETTLED, periods)
    parameter_name, last_states = sweep_data.attrs["swept"], sweep_data.isel(period=-1)
    parameter_values, x, v = (
        sweep_array.transpose("step", "leg").values[unresolved_indices]
        for sweep_array in (sweep_data[parameter_name], last_states["x"], last_states["v"])
    )
    phase = np.full_like(x, float(sweep_data.attrs["phase"]))
    lane_scenes = scene.replace(**{parameter_name: parameter_values.astype(scene.dtype)})
    continued_periods = classify_motions(
        lane_scenes, State(x, v, phase, np.zeros_like(x)), 0, MAX_EXTRA_PERIODS
    ).periods
    is_transient = (continued_periods > 0) & (continued_periods <= max_recurrence_period(sweep_data))
    periods[unresolved_indices] = np.select(
        [is_transient, continued_periods == MOTION_UNDECIDED], [NOT_SETTLED, UNDECIDED], continued_periods
    )
    return periods


def find_recurrence_periods(sweep_data):
    """Return the number of drive periods after which the recorded states recur.

    Parameters
    ----------
    sweep_data : xarray.Dataset
        Result of `sweep` with dimensions (step, leg, period).

    Returns
    -------
    ndarray of shape (step, leg)
        Number of drive periods; 0 if the states do not recur, -1 for a bad status.
    """
    recorded_states = np.stack(
        [sweep_data[coordinate_name].transpose("period", "step", "leg").values for coordinate_name in ("x", "v")]
    )
    return_tolerance = RETURN_TOLERANCE * np.nanmax(abs(recorded_states), initial=0.0)
    periods = np.where(np.isnan(recorded_states).any(axis=(0, 1)), -1, 0)
    for n_periods in range(1, max_recurrence_period(sweep_data) + 1):
        is_unresolved = periods == 0
        unresolved_states = recorded_states[:, :, is_unresolved]
        periods[is_unresolved] = np.where(
            abs(unresolved_states[:, n_periods:] - unresolved_states[:, :-n_periods]).max(axis=(0, 1))
            <= return_tolerance,
            n_periods,
            0,
        )
    return periods
