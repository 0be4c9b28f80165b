"""Integrate with the method of the paper, and check the accuracy of this method.

After a step across a wall, the method of Cheng and Xu (2007) halves the step repeatedly, and reverses its direction at
each crossing of the wall, until the step is at most 1e-6 of the regular step. The walls are at -1 and 1, and the motion
starts at phase 0.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from ..maps.strobe import strobe
from ..scene.state import State
from .claim import additional_claim, statement_claim

BLOCK_SIZE = 8192
BRACKET_WIDTH = 1e-6
MAX_IMPACTS = 30  # impacts per period; complete chatter has infinitely many, and a lane stops here


class OscillatorParameters(NamedTuple):
    """Parameters that all lanes share.

    Attributes
    ----------
    frequency : float
        Drive frequency omega.
    damping : float
        Damping gamma.
    restitution : float
        Coefficient of restitution R.
    """

    frequency: float
    damping: float
    restitution: float


class UnfinishedLanes(NamedTuple):
    """State of the unfinished lanes.

    Attributes
    ----------
    row : ndarray of shape (lanes,)
        Row of the result.
    x, v, amplitude : ndarray of shape (lanes,)
        Position, velocity and drive amplitude.
    time : ndarray of shape (lanes,)
        Time since the start.
    step : ndarray of shape (lanes,)
        Length of the next step; negative if the step goes back in time.
    is_searching : ndarray of shape (lanes,)
        True while a contact is being bracketed.
    is_beyond : ndarray of shape (lanes,)
        True if the last step ended beyond a wall.
    count : ndarray of shape (lanes,)
        Number of impacts.
    """

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
    """States and impacts of a drive period.

    Attributes
    ----------
    ends : ndarray of shape (rows, 2)
        States (x, v) at the end of the period, or after the last impact of a row with `max_impacts` impacts.
    sides : ndarray of shape (rows, max_impacts)
        Sides of the impacts; 0 for empty slots.
    times : ndarray of shape (rows, max_impacts)
        Times of the impacts; inf for empty slots.
    """

    ends: Float[np.ndarray, "rows 2"]
    sides: Int[np.ndarray, "rows room"]
    times: Float[np.ndarray, "rows room"]


def fixed_step_strobe(
    oscillator_params, state_rows, steps_per_period, bracket_width=BRACKET_WIDTH, max_impacts=MAX_IMPACTS
):
    """Integrate over one drive period; return the `StrobeResult`.

    The rows of `state_rows` are (x, v, A). `steps_per_period` is the number of steps per period, and `bracket_width` is
    the step length, relative to a regular step, at which the search for a contact ends."""
    record_shape = len(state_rows), max_impacts
    strobe_result = StrobeResult(
        state_rows[:, :2].copy(), np.zeros(record_shape, np.int8), np.full(record_shape, np.inf)
    )
    for first_row in range(0, len(state_rows), BLOCK_SIZE):
        _run_block(
            oscillator_params,
            np.arange(first_row, min(first_row + BLOCK_SIZE, len(state_rows))),
            state_rows,
            strobe_result,
            steps_per_period,
            bracket_width,
        )
    return strobe_result


def _run_block(oscillator_params, row_indices, state_rows, strobe_result, steps_per_period, bracket_width):
    """Integrate some rows and write their results to `strobe_result`."""
    period, max_impacts = 2.0 * np.pi / oscillator_params.frequency, strobe_result.sides.shape[1]
    step_length = period / steps_per_period
    n_lanes = len(row_indices)
    lanes = UnfinishedLanes(
        row_indices,
        *state_rows[row_indices].T.copy(),
        time=np.zeros(n_lanes),
        step=np.full(n_lanes, step_length),
        is_searching=np.zeros(n_lanes, dtype=bool),
        is_beyond=np.zeros(n_lanes, dtype=bool),
        count=np.zeros(n_lanes, dtype=int),
    )
    while lanes.row.size:
        lanes, contact_lane_indices = _step_lanes(oscillator_params, lanes, step_length, period, bracket_width)
        if contact_lane_indices.size:
            _apply_impacts(oscillator_params, lanes, contact_lane_indices, strobe_result)
        # The last step equals the remaining time, so that the difference is rounding.
        is_done = (lanes.count == max_impacts) | (~lanes.is_searching & (period - lanes.time < 1e-9 * step_length))
        if is_done.any():
            strobe_result.ends[lanes.row[is_done]] = np.stack([lanes.x[is_done], lanes.v[is_done]], axis=1)
            lanes = UnfinishedLanes(*(lane_field[~is_done] for lane_field in lanes))


def _step_lanes(oscillator_params, lanes, step_length, period, bracket_width):
    """Return (lanes after one step, indices of the lanes whose contact is located)."""
    x, v = _runge_kutta_step(oscillator_params, lanes.x, lanes.v, lanes.amplitude, lanes.time, lanes.step)
    time = lanes.time + lanes.step
    is_beyond = np.abs(x) > 1
    is_searching = lanes.is_searching | is_beyond
    has_contact = is_searching & (np.abs(lanes.step) <= bracket_width * step_length)
    bracketing_step = np.where(is_beyond == lanes.is_beyond, 0.5, -0.5) * lanes.step
    takes_regular_step = has_contact | ~is_searching
    next_step_length = np.where(takes_regular_step, np.minimum(step_length, period - time), bracketing_step)
    lanes = lanes._replace(
        x=x,
        v=v,
        time=time,
        step=next_step_length,
        is_searching=is_searching & ~has_contact,
        is_beyond=is_beyond & ~has_contact,
    )
    return lanes, np.flatnonzero(has_contact)


def _runge_kutta_step(oscillator_params, x, v, amplitude, time, step_length):
    """Return (x, v) after a Runge-Kutta step of order 4; the step may be negative."""
    half_step, twice_damping = 0.5 * step_length, 2 * oscillator_params.damping
    drive_start, drive_middle, drive_end = (
        amplitude * np.cos(oscillator_params.frequency * (time + time_offset))
        for time_offset in (0.0, half_step, step_length)
    )
    acceleration_1 = drive_start - x - twice_damping * v
    velocity_2 = v + half_step * acceleration_1
    acceleration_2 = drive_middle - (x + half_step * v) - twice_damping * velocity_2
    velocity_3 = v + half_step * acceleration_2
    acceleration_3 = drive_middle - (x + half_step * velocity_2) - twice_damping * velocity_3
    velocity_4 = v + step_length * acceleration_3
    acceleration_4 = drive_end - (x + step_length * velocity_3) - twice_damping * velocity_4
    return x + step_length / 6 * (v + 2 * (velocity_2 + velocity_3) + velocity_4), v + step_length / 6 * (
        acceleration_1 + 2 * (acceleration_2 + acceleration_3) + acceleration_4
    )


def _apply_impacts(oscillator_params, lanes, contact_lane_indices, strobe_result):
    """Move lanes with a contact onto the wall, apply the restitution law and record the impacts."""
    wall_side = np.sign(lanes.x[contact_lane_indices])
    lanes.x[contact_lane_indices] = wall_side
    lanes.v[contact_lane_indices] *= -oscillator_params.restitution
    record_index = lanes.row[contact_lane_indices], lanes.count[contact_lane_indices]
    strobe_result.sides[record_index], strobe_result.times[record_index] = wall_side, lanes.time[contact_lane_indices]
    lanes.count[contact_lane_indices] += 1


N_STARTS, STEPS_PER_PERIOD = 4096, (100, 400, 1600)  # the paper does not state the steps per period
FINE_BRACKET = 1e-12  # relative to a step: the remaining error is that of the integrator


def accuracy_claims(scene):
    """Yield the claims on the accuracy of contacts and of the stroboscopic map; the walls must be at -1 and 1."""
    rng = np.random.default_rng(0)
    lower_bounds, upper_bounds = [-1.0, -3.0, 0.0], [1.0, 3.0, 6.0]
    state_rows = rng.uniform(lower_bounds, upper_bounds, (N_STARTS, len(lower_bounds)))
    end_state, impacts = strobe(
        scene.replace(amplitude=state_rows[:, 2]), State(state_rows[:, 0], state_rows[:, 1]), slots=MAX_IMPACTS
    )
    exact_end_states, exact_sides = (
        np.stack([np.asarray(end_state.x), np.asarray(end_state.v)], axis=1),
        np.asarray(impacts.side),
    )
    oscillator_params = OscillatorParameters(
        *(float(getattr(scene, parameter_name)) for parameter_name in ("frequency", "damping", "restitution"))
    )
    fixed_step_runs = [
        [
            fixed_step_strobe(oscillator_params, state_rows, steps_per_period, bracket_width)
            for bracket_width in (BRACKET_WIDTH, FINE_BRACKET)
        ]
        for steps_per_period in STEPS_PER_PERIOD
    ]
    yield _bracket_claim(fixed_step_runs, 2.0 * np.pi / oscillator_params.frequency)
    median_errors = np.array(
        [
            [_median_error(fixed_step_run, exact_end_states, exact_sides) for fixed_step_run in runs_by_bracket]
            for runs_by_bracket in fixed_step_runs
        ]
    )
    errors_text = "; ".join(
        f"{steps_per_period} steps per period: {paper_bracket_error:.2g}, the integrator alone {fine_bracket_error:.2g}"
        for steps_per_period, (paper_bracket_error, fine_bracket_error) in zip(
            STEPS_PER_PERIOD, median_errors, strict=True
        )
    )
    convergence_order = np.log(median_errors[-2, 0] / median_errors[-1, 0]) / np.log(
        STEPS_PER_PERIOD[-1] / STEPS_PER_PERIOD[-2]
    )
    claim_text = (
        "with that bracket the error of a strobe decreases like the step, not like its fourth power:"
        f" {errors_text} (order)"
    )
    yield additional_claim("method", claim_text, (float(convergence_order), 0.1), low=0.8, high=1.2)


def _bracket_claim(fixed_step_runs, period):
    """Return the claim on the error of the first contact times with the paper's bracket, in units of a step."""
    contact_time_errors = []
    for (paper_bracket_run, fine_bracket_run), steps_per_period in zip(fixed_step_runs, STEPS_PER_PERIOD, strict=True):
        is_same_wall = (paper_bracket_run.sides[:, 0] == fine_bracket_run.sides[:, 0]) & (
            paper_bracket_run.sides[:, 0] != 0
        )
        contact_time_errors.append(
            abs(paper_bracket_run.times[is_same_wall, 0] - fine_bracket_run.times[is_same_wall, 0]).max()
            * steps_per_period
            / period
        )
    steps_text = ", ".join(f"{steps_per_period}" for steps_per_period in STEPS_PER_PERIOD)
    claim_text = (
        f"a contact is bracketed to 1e-6 of a step (first contacts of {N_STARTS} starts, {steps_text} steps"
        " per period; largest "
        "distance from the crossing of the integrator, in steps)"
    )
    return statement_claim(
        "method", claim_text, (float(max(contact_time_errors)), 2.0 * FINE_BRACKET), high=BRACKET_WIDTH
    )


def _median_error(fixed_step_run, exact_end_states, exact_sides):
    """Return the median error of the final states over the motions with impacts whose sequence of walls is exact."""
    n_impact_slots = min(exact_sides.shape[1], fixed_step_run.sides.shape[1])
    has_exact_sequence = (fixed_step_run.sides[:, :n_impact_slots] == exact_sides[:, :n_impact_slots]).all(axis=1) & (
        exact_sides[:, 0] != 0
    )
    return float(np.median(abs(fixed_step_run.ends - exact_end_states)[has_exact_sequence].max(axis=1)))
