"""Average the Lyapunov exponents of motions that do not recur, with standard errors.

The first exponent is the mean logarithmic growth of a tangent vector per period. The sum of both exponents is the mean
of ``ln abs det M``, where M is the derivative of the stroboscopic map over one period. The determinant follows from the
impacts and the damping (`orbit_exponents.log_determinant`). This is Benettin's method for two exponents, with the
determinant in place of a second tangent vector.
"""

from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float, Int

from ..compiled.kernel_calls import BLOCK_WIDTH
from ..maps.initial_conditions import initial_box
from ..maps.iterate import take_lanes
from ..scene.state import Contact, State, Status
from .orbit_exponents import ExponentEstimate, log_determinant, measured_area_growth, undefined_estimate
from .tangent_growth import RECORDED_PERIODS, TangentLanes, run_tangents, start_tangents, worse_status
from .transients import compute_return_distances, find_recurrence_periods

MIN_BATCHES = 8  # fewest batches of a copy for a standard error that counts the copies one by one
MIN_TIME_BATCHES = 32  # fewest batches in time for a standard error of the means over the copies
EXCESS_ERRORS = 3.0  # standard errors of its own by which the second estimate must exceed the first


def standard_error(block_sums, block_periods):
    """Estimate the standard error of a mean per period by batch means.

    Parameters
    ----------
    block_sums : ndarray
        Sums of the quantity over blocks of periods, one column per copy of the motion. Array of shape (blocks, copies).
    block_periods : int
        Periods of a block.

    Returns
    -------
    float
        Standard error; inf for fewer than `MIN_BATCHES` blocks.

    Notes
    -----
    Successive blocks of a copy are correlated. Batches of 1, 2, 4, ... blocks are therefore formed. The estimated error
    grows with the length of the batches until the batches are independent. The result is the largest estimate.

    The copies may be correlated as well. A second estimate, from the variation in time of the mean over the copies,
    does not assume independent copies. The second estimate is included if there are at least `MIN_TIME_BATCHES` batches
    and it is significantly larger than the first.
    """
    error_estimates, blocks_per_batch = [np.inf if len(block_sums) < MIN_BATCHES else 0.0], 1
    while (n_batches := len(block_sums) // blocks_per_batch) >= MIN_BATCHES:
        batch_means = (
            block_sums[: n_batches * blocks_per_batch].reshape(n_batches, blocks_per_batch, -1).mean(axis=1)
            / block_periods
        )
        error_estimates.append(batch_means.std(ddof=1) / batch_means.size**0.5)
        time_scatter_error = batch_means.mean(axis=1).std(ddof=1) / n_batches**0.5
        if n_batches >= MIN_TIME_BATCHES and time_scatter_error > error_estimates[-1] * (
            1.0 + EXCESS_ERRORS / (2.0 * n_batches) ** 0.5
        ):
            error_estimates.append(time_scatter_error)
        blocks_per_batch *= 2
    return float(max(error_estimates))


BLOCK_PERIODS = 16  # periods whose growth is summed
INITIAL_CHUNKS = 16  # times `RECORDED_PERIODS` before the first check of the error
MIN_GROWTH_RATE = 0.02  # growth per period below which copies may stay together for thousands of periods


class SettledLanes(NamedTuple):
    """Lanes after a transient, as NumPy arrays whose last axis holds the lanes.

    Attributes
    ----------
    lanes : TangentLanes
        States and tangents.
    status : ndarray
        Worst status.
    periods : ndarray
        Periods after which each lane recurs; 0 if it does not.
    growth_rate : ndarray
        Mean logarithmic growth of the tangent per period.
    visited_states : State
        Visited states, `RECORDED_PERIODS` apart. Leaves of shape (visits, lanes).
    scale : ndarray
        Largest magnitude of x and v.
    """

    lanes: TangentLanes
    status: Int[np.ndarray, " lanes"]
    periods: Int[np.ndarray, " lanes"]
    growth_rate: Float[np.ndarray, " lanes"]
    visited_states: State
    scale: Float[np.ndarray, " lanes"]

    @property
    def has_finite_state(self) -> bool:
        """True if the state is finite; defined for a single lane."""
        return bool(np.isfinite(np.ravel(self.lanes.state.x)[0]))

    @property
    def is_nonrecurrent(self) -> bool:
        """True if the state is finite and has not recurred; defined for a single lane."""
        return self.has_finite_state and not self.periods[0]


def run_until_recurrence(scene, tangent_lanes, transient_periods, max_rounds):
    """Simulate lanes for a transient and then until they recur.

    Parameters
    ----------
    scene : Scene
        Scene, single or with one lane for each of `tangent_lanes`.
    tangent_lanes : TangentLanes
        Initial states and tangents.
    transient_periods : int
        Drive periods of the transient.
    max_rounds : int
        Largest number of rounds of `RECORDED_PERIODS` periods after the transient. The rounds end earlier if all lanes
        with a finite state recur.

    Returns
    -------
    SettledLanes
        Lanes after the last round.
    """
    tangent_lanes, period_records = run_tangents(scene, tangent_lanes, transient_periods + RECORDED_PERIODS)
    previous_distances, status, dtype = (
        compute_return_distances(period_records.points),
        period_records.status,
        tangent_lanes.state.x.dtype,
    )
    start_box_x_min, start_box_x_max, _ = initial_box(scene)
    overall_max_speed = np.max(abs(period_records.v), where=np.isfinite(period_records.v), initial=0.0)
    max_state_magnitude = max(abs(start_box_x_min).max(), abs(start_box_x_max).max(), overall_max_speed)
    periods, growth_rates, visited_states = np.zeros(len(tangent_lanes.state.x), int), [], []
    for _ in range(max_rounds):
        tangent_lanes, period_records = run_tangents(scene, tangent_lanes, RECORDED_PERIODS)
        return_distances = compute_return_distances(period_records.points)
        periods = np.where(
            periods > 0,
            periods,
            find_recurrence_periods(return_distances, previous_distances, RECORDED_PERIODS, max_state_magnitude, dtype),
        )
        growth_rates.append(period_records.log_growth.mean(axis=0))
        visited_states.append(tangent_lanes.state)
        previous_distances, status = return_distances, worse_status(status, period_records.status, np)
        if np.all((periods > 0) | ~np.isfinite(tangent_lanes.state.x)):
            break
    visited_states = jax.tree.map(lambda *leaves: np.stack(leaves), *visited_states)
    return SettledLanes(
        tangent_lanes,
        status,
        periods,
        np.mean(growth_rates, axis=0),
        visited_states,
        np.full(len(periods), max_state_magnitude),
    )


def estimate_exponents(scene, settled_lanes, target_error, max_periods):
    """Estimate the exponents of one motion from `BLOCK_WIDTH` copies of it.

    The copies start from visited states with slightly different velocities. They are simulated until they have
    separated. The exponents are then averaged over time and copies. If the growth rate is small, copies may remain
    correlated. All copies then start near the same state, so that their correlation appears at equal times and enters
    the error estimate (`standard_error`).

    Parameters
    ----------
    scene : Scene
        Scene without lanes.
    settled_lanes : SettledLanes
        One lane after the transient.
    target_error : float
        Standard error at which the averaging ends.
    max_periods : int
        Approximate largest number of drive periods that are averaged, over all copies.

    Returns
    -------
    estimate : ExponentEstimate
        Exponents of the motion.
    settled_lanes : SettledLanes or None
        One lane on the periodic orbit that a copy has reached; None if no copy recurs.
    """
    max_state_magnitude = settled_lanes.scale[0]
    tangent_lanes = _make_perturbed_copies(settled_lanes, max_state_magnitude)
    dtype = tangent_lanes.state.x.dtype
    tangent_growth_rate = (
        settled_lanes.growth_rate[0] if settled_lanes.growth_rate[0] > MIN_GROWTH_RATE else MIN_GROWTH_RATE
    )
    separation_periods = np.log(np.finfo(dtype).eps ** -0.5) / tangent_growth_rate
    tangent_lanes, period_records = run_tangents(
        scene, tangent_lanes, RECORDED_PERIODS * (1 + int(separation_periods / RECORDED_PERIODS))
    )
    block_sums, status, total_rounds_planned = (
        [],
        period_records.status,
        max(2, min(INITIAL_CHUNKS, max_periods // (RECORDED_PERIODS * BLOCK_WIDTH))),
    )
    while True:
        for _ in range(total_rounds_planned - len(block_sums)):
            previous_records, (tangent_lanes, period_records) = (
                period_records,
                run_tangents(scene, tangent_lanes, RECORDED_PERIODS),
            )
            time_in_walls = np.moveaxis(period_records.time_in_walls, -1, 0)
            quantities_to_average = np.stack(
                [
                    period_records.log_growth,
                    period_records.left_impacts,
                    period_records.right_impacts,
                    period_records.n_impacts,
                    measured_area_growth(scene, period_records),
                    *time_in_walls,
                ]
            )
            block_sums.append(
                quantities_to_average.reshape(len(quantities_to_average), -1, BLOCK_PERIODS, BLOCK_WIDTH).sum(2)
            )
            status = worse_status(status, period_records.status, np)
        estimate = _average_blocks(scene, np.concatenate(block_sums, axis=1), int(status.max()))
        periods = find_recurrence_periods(
            compute_return_distances(period_records.points),
            compute_return_distances(previous_records.points),
            RECORDED_PERIODS,
            max_state_magnitude,
            dtype,
        )
        if status.max() < Status.CAP and periods.any():
            recurrent_lane_index = np.flatnonzero(periods)[:1]
            return estimate, settled_lanes._replace(
                lanes=take_lanes(tangent_lanes, recurrent_lane_index), periods=periods[recurrent_lane_index]
            )
        largest_error = estimate.error.max()
        if not largest_error > target_error or estimate.count >= max_periods:
            return estimate, None
        total_rounds_needed = len(block_sums) * min(2.0, 1.05 * (largest_error / target_error) ** 2)
        total_rounds_planned = min(
            max(len(block_sums) + 1, int(np.ceil(total_rounds_needed))),
            -(-max_periods // (RECORDED_PERIODS * BLOCK_WIDTH)),
        )


def _make_perturbed_copies(settled_lanes, max_state_magnitude):
    """Return the `TangentLanes` of `BLOCK_WIDTH` slightly perturbed copies of a motion."""
    n_visited_states = len(settled_lanes.visited_states.x) if settled_lanes.growth_rate[0] > MIN_GROWTH_RATE else 1
    visited_state_indices = -1 - np.arange(BLOCK_WIDTH) % n_visited_states
    state = jax.tree.map(lambda leaf: leaf[visited_state_indices, 0], settled_lanes.visited_states)
    dtype = state.x.dtype
    velocity_offsets = (
        np.random.default_rng(0).normal(size=BLOCK_WIDTH) * np.finfo(dtype).eps ** 0.4 * max_state_magnitude
    )
    can_be_perturbed = (state.contact == 0) | (abs(state.contact) == Contact.WITHIN)
    v = np.where(can_be_perturbed, state.v + velocity_offsets.astype(dtype), state.v)
    return start_tangents(State(state.x, v, state.phase, state.contact))


def _average_blocks(scene, block_sums, status):
    """Compute the `ExponentEstimate` from sums over blocks of periods, of shape (7, blocks, copies).

    The seven quantities are the logarithmic growth, the impacts on the left wall, on the right wall and on both, the
    `measured_area_growth`, and the times inside the left and the right wall.
    """
    log_growth_sums, left_impact_sums, right_impact_sums, impact_sums, area_growth_sums, *time_in_walls = block_sums
    n_periods = log_growth_sums.size * BLOCK_PERIODS
    if status >= Status.CAP or np.isnan(log_growth_sums).any() or np.isposinf(log_growth_sums).any():
        return undefined_estimate(status if status else Status.NONFINITE)
    largest_exponent, exponent_sum = (
        log_growth_sums.sum() / n_periods,
        log_determinant(scene, left_impact_sums.sum(), right_impact_sums.sum(), n_periods, area_growth_sums.sum())
        / n_periods,
    )
    impacts_per_period, time_in_walls = (
        np.array([block_array.sum() for block_array in block_arrays]) / n_periods
        for block_arrays in ((impact_sums, left_impact_sums, right_impact_sums), time_in_walls)
    )
    if np.isneginf(largest_exponent):
        return ExponentEstimate(
            np.full(2, -np.inf), np.zeros(2), impacts_per_period, time_in_walls, 0, status, n_periods
        )
    errors = np.array([standard_error(log_growth_sums, BLOCK_PERIODS), 0.0])
    if np.isfinite(exponent_sum):
        errors[1] = standard_error(
            log_determinant(scene, left_impact_sums, right_impact_sums, BLOCK_PERIODS, area_growth_sums)
            - log_growth_sums,
            BLOCK_PERIODS,
        )
    if abs(largest_exponent) < MIN_GROWTH_RATE:
        errors = np.maximum(
            errors, 1.0 / (len(log_growth_sums) * BLOCK_PERIODS)
        )  # a mere shear grows like ln(time), which looks like a steady rate
    return ExponentEstimate(
        np.array([largest_exponent, exponent_sum - largest_exponent]),
        errors,
        impacts_per_period,
        time_in_walls,
        0,
        status,
        n_periods,
    )
