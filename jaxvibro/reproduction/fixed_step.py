"""Integrate with the method of the paper: fixed-step Runge-Kutta of order 4, vectorised in NumPy.

Cheng and Xu 2007: at a crossing the step is halved and reversed until the contact lies within 1e-6 of a step. The walls
are at -1 and 1, and the motion starts at phase 0.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

BLOCK_SIZE = 8192
BRACKET_WIDTH = 1e-6
MAX_IMPACTS = 30  # impacts per period; complete chatter has infinitely many, and a lane stops here


class DriveParameters(NamedTuple):
    """Parameters that all lanes share: omega, gamma, R."""

    frequency: float
    damping: float
    restitution: float


class SteppedLanes(NamedTuple):
    """Unfinished lanes; `step` is the next step, and `is_beyond` is True if the last one ended beyond a wall."""

    row: Int[np.ndarray, " lanes"]
    x: Float[np.ndarray, " lanes"]
    v: Float[np.ndarray, " lanes"]
    amplitude: Float[np.ndarray, " lanes"]
    time: Float[np.ndarray, " lanes"]
    step: Float[np.ndarray, " lanes"]
    is_searching: Bool[np.ndarray, " lanes"]
    is_beyond: Bool[np.ndarray, " lanes"]
    count: Int[np.ndarray, " lanes"]  # type: ignore[assignment]  # hides tuple's method


class StrobeResult(NamedTuple):
    """States after a period, of shape (n, 2), and sides and times of the impacts, of shape (n, max_impacts).

    Empty slots have side 0 and time inf.
    """

    ends: Float[np.ndarray, "rows 2"]
    sides: Int[np.ndarray, "rows room"]
    times: Float[np.ndarray, "rows room"]


def fixed_step_strobe(params, states, steps, bracket=BRACKET_WIDTH, max_impacts=MAX_IMPACTS):
    """Return the `StrobeResult` of rows (x, v, A) after one drive period with a number of steps per period.

    `bracket` is the final width of a contact bracket relative to a step.
    """
    shape = len(states), max_impacts
    result = StrobeResult(states[:, :2].copy(), np.zeros(shape, np.int8), np.full(shape, np.inf))
    for start in range(0, len(states), BLOCK_SIZE):
        _run_block(params, np.arange(start, min(start + BLOCK_SIZE, len(states))), states, result, steps, bracket)
    return result


def _run_block(params, rows, states, result, steps, bracket):
    """Fill in the results of some rows."""
    period, max_impacts = 2.0 * np.pi / params.frequency, result.sides.shape[1]
    step_length = period / steps
    x, v, amplitude = states[rows].T.copy()
    zeros, false = np.zeros(len(rows)), np.zeros(len(rows), dtype=bool)
    counts = np.zeros(len(rows), dtype=int)
    lanes = SteppedLanes(rows, x, v, amplitude, zeros, np.full(len(rows), step_length), false, false, counts)
    while lanes.row.size:
        lanes, hit_lanes = _step_lanes(params, lanes, step_length, period, bracket)
        if hit_lanes.size:
            _apply_impacts(params, lanes, hit_lanes, result)
        # The last step equals the remaining time, so that the difference is rounding.
        is_done = (lanes.count == max_impacts) | (~lanes.is_searching & (period - lanes.time < 1e-9 * step_length))
        if is_done.any():
            result.ends[lanes.row[is_done]] = np.stack([lanes.x[is_done], lanes.v[is_done]], axis=1)
            lanes = SteppedLanes(*(column[~is_done] for column in lanes))


def _step_lanes(params, lanes, step_length, period, bracket):
    """Return all lanes after one step, and the indices of those whose contact is found."""
    x, v = _runge_kutta_step(params, lanes.x, lanes.v, lanes.amplitude, lanes.time, lanes.step)
    time = lanes.time + lanes.step
    is_beyond = np.abs(x) > 1
    is_searching = lanes.is_searching | is_beyond
    is_hit = is_searching & (np.abs(lanes.step) <= bracket * step_length)
    search_step = np.where(is_beyond == lanes.is_beyond, 0.5, -0.5) * lanes.step
    is_flying = is_hit | ~is_searching
    step = np.where(is_flying, np.minimum(step_length, period - time), search_step)
    lanes = lanes._replace(
        x=x, v=v, time=time, step=step, is_searching=is_searching & ~is_hit, is_beyond=is_beyond & ~is_hit
    )
    return lanes, np.flatnonzero(is_hit)


def _runge_kutta_step(params, x, v, amplitude, time, step_length):
    """Return (x, v) after a Runge-Kutta step of order 4, whose length may be negative."""
    half_step, twice_damping = 0.5 * step_length, 2 * params.damping
    drive_start, drive_middle, drive_end = (
        amplitude * np.cos(params.frequency * (time + offset)) for offset in (0.0, half_step, step_length)
    )
    a1 = drive_start - x - twice_damping * v
    v2 = v + half_step * a1
    a2 = drive_middle - (x + half_step * v) - twice_damping * v2
    v3 = v + half_step * a2
    a3 = drive_middle - (x + half_step * v2) - twice_damping * v3
    v4 = v + step_length * a3
    a4 = drive_end - (x + step_length * v3) - twice_damping * v4
    return x + step_length / 6 * (v + 2 * (v2 + v3) + v4), v + step_length / 6 * (a1 + 2 * (a2 + a3) + a4)


def _apply_impacts(params, lanes, hit_lanes, result):
    """Place lanes with a contact on the wall, apply the restitution law and record the impact."""
    side = np.sign(lanes.x[hit_lanes])
    lanes.x[hit_lanes] = side
    lanes.v[hit_lanes] *= -params.restitution
    slot = lanes.row[hit_lanes], lanes.count[hit_lanes]
    result.sides[slot], result.times[slot] = side, lanes.time[hit_lanes]
    lanes.count[hit_lanes] += 1
