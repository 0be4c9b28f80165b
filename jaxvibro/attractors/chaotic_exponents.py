"""Average the Lyapunov exponents of motions that do not recur, over many copies of a motion.

The first exponent is the mean growth of a tangent vector. The second is the rest of ``ln abs det M``, which follows
from impacts and damping (`orbit_exponents.log_determinant`). With one tangent and the determinant this is Benettin's
method for two exponents.
"""

from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float, Int

from ..compiled.kernels import BLOCK_WIDTH
from ..maps.initial_conditions import initial_box
from ..scene.codes import Contact, Status
from ..scene.state import State
from .batch_means import standard_error
from .orbit_exponents import ExponentEstimate, log_determinant, measured_area_growth, undefined_estimate
from .recurrence import recurrence_distances, recurrence_periods
from .tangent import RECORDED_PERIODS, TangentLanes, run_tangents, start_tangents, worse_status_on_host

BLOCK_PERIODS = 16  # periods whose growth is summed
INITIAL_CHUNKS = 16  # times `RECORDED_PERIODS` before the first check of the error
MIN_GROWTH_RATE = 0.02  # growth per period below which copies may stay together for thousands of periods


class SettledLanes(NamedTuple):
    """Lanes after a transient, as NumPy arrays, lanes last.

    Attributes
    ----------
    lanes : TangentLanes
        States and tangents.
    status : ndarray
        Worst status.
    periods : ndarray
        Periods after which each lane recurs; 0 if it does not.
    growth_rate : ndarray
        Mean growth per period.
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
    def is_valid(self) -> bool:
        """True if a single lane has a finite state."""
        return bool(np.isfinite(np.ravel(self.lanes.state.x)[0]))

    @property
    def is_unsettled(self) -> bool:
        """True if a single lane has a finite state and does not recur yet."""
        return self.is_valid and not self.periods[0]


def run_until_recurrence(scene, lanes, settle, max_rounds):
    """Return `SettledLanes` after `settle` periods and up to `max_rounds` rounds of `RECORDED_PERIODS`.

    The rounds end once all lanes recur. scene: a single one, or one with a lane of its own for each lane.
    """
    lanes, records = run_tangents(scene, lanes, settle + RECORDED_PERIODS)
    previous_distances, status, dtype = recurrence_distances(records.points), records.status, lanes.state.x.dtype
    x_min, x_max, _ = initial_box(scene)
    max_speed = np.max(abs(records.v), where=np.isfinite(records.v), initial=0.0)
    scale = max(abs(x_min).max(), abs(x_max).max(), max_speed)
    periods, growth_rates, visited_states = np.zeros(len(lanes.state.x), int), [], []
    for _ in range(max_rounds):
        lanes, records = run_tangents(scene, lanes, RECORDED_PERIODS)
        distances = recurrence_distances(records.points)
        periods = np.where(
            periods > 0, periods, recurrence_periods(distances, previous_distances, RECORDED_PERIODS, scale, dtype)
        )
        growth_rates.append(records.growth.mean(axis=0))
        visited_states.append(lanes.state)
        previous_distances, status = distances, worse_status_on_host(status, records.status)
        if np.all((periods > 0) | ~np.isfinite(lanes.state.x)):
            break
    visited_states = jax.tree.map(lambda *leaves: np.stack(leaves), *visited_states)
    return SettledLanes(
        lanes, status, periods, np.mean(growth_rates, axis=0), visited_states, np.full(len(periods), scale)
    )


def estimate_exponents(scene, settled_lanes, target_error, max_periods):
    """Return (`ExponentEstimate`, None) of the motion of a single scene.

    If the motion ends on a periodic orbit, its `SettledLanes` take the place of None. settled_lanes: of one lane;
    target_error: standard error at which the average ends, after at most about `max_periods`. `BLOCK_WIDTH` copies of
    the motion are simulated: from visited states with slightly different velocities, until they have separated. If they
    hardly separate, all start at one state, so that their correlation is visible.
    """
    scale = settled_lanes.scale[0]
    lanes = _make_copies(settled_lanes, scale)
    dtype = lanes.state.x.dtype
    growth_rate = settled_lanes.growth_rate[0] if settled_lanes.growth_rate[0] > MIN_GROWTH_RATE else MIN_GROWTH_RATE
    separation_periods = np.log(np.finfo(dtype).eps ** -0.5) / growth_rate
    lanes, records = run_tangents(scene, lanes, RECORDED_PERIODS * (1 + int(separation_periods / RECORDED_PERIODS)))
    block_sums, status, n_chunks = (
        [],
        records.status,
        max(2, min(INITIAL_CHUNKS, max_periods // (RECORDED_PERIODS * BLOCK_WIDTH))),
    )
    while True:
        for _ in range(n_chunks - len(block_sums)):
            previous_records, (lanes, records) = records, run_tangents(scene, lanes, RECORDED_PERIODS)
            time_within = np.moveaxis(records.time_within, -1, 0)
            quantities = np.stack(
                [
                    records.growth,
                    records.left_impacts,
                    records.right_impacts,
                    records.n_impacts,
                    measured_area_growth(scene, records),
                    *time_within,
                ]
            )
            block_sums.append(quantities.reshape(len(quantities), -1, BLOCK_PERIODS, BLOCK_WIDTH).sum(2))
            status = worse_status_on_host(status, records.status)
        estimate = _average_blocks(scene, np.concatenate(block_sums, axis=1), int(status.max()))
        periods = recurrence_periods(
            recurrence_distances(records.points),
            recurrence_distances(previous_records.points),
            RECORDED_PERIODS,
            scale,
            dtype,
        )
        if status.max() < Status.CAP and periods.any():
            recurrent_lane = np.flatnonzero(periods)[:1]
            return estimate, settled_lanes._replace(
                lanes=_select_lanes(lanes, recurrent_lane), periods=periods[recurrent_lane]
            )
        max_error = estimate.error.max()
        if not max_error > target_error or estimate.count >= max_periods:
            return estimate, None
        n_chunks_needed = len(block_sums) * min(2.0, 1.05 * (max_error / target_error) ** 2)
        n_chunks = min(
            max(len(block_sums) + 1, int(np.ceil(n_chunks_needed))), -(-max_periods // (RECORDED_PERIODS * BLOCK_WIDTH))
        )


def _select_lanes(lanes, selection):
    return jax.tree.map(lambda leaf: leaf[selection], lanes)


def _make_copies(settled_lanes, scale):
    """Return the `TangentLanes` of `BLOCK_WIDTH` copies of a motion."""
    n_visits = len(settled_lanes.visited_states.x) if settled_lanes.growth_rate[0] > MIN_GROWTH_RATE else 1
    visit_indices = -1 - np.arange(BLOCK_WIDTH) % n_visits
    state = jax.tree.map(lambda leaf: leaf[visit_indices, 0], settled_lanes.visited_states)
    dtype = state.x.dtype
    speed_offsets = np.random.default_rng(0).normal(size=BLOCK_WIDTH) * np.finfo(dtype).eps ** 0.4 * scale
    is_movable = (state.contact == 0) | (abs(state.contact) == Contact.WITHIN)
    v = np.where(is_movable, state.v + speed_offsets.astype(dtype), state.v)
    return start_tangents(State(state.x, v, state.phase, state.contact))


def _average_blocks(scene, block_sums, status):
    """Return the `ExponentEstimate` of sums over blocks, shape (7, blocks, copies).

    The sums are of growth, impacts (left, right, all), `measured_area_growth` and the time inside each wall.
    """
    growth, left_impacts, right_impacts, all_impacts, area_growth, *time_within = block_sums
    n_periods = growth.size * BLOCK_PERIODS
    if status >= Status.CAP or np.isnan(growth).any() or np.isposinf(growth).any():
        return undefined_estimate(status if status else Status.NONFINITE)
    exponent, exponent_sum = (
        growth.sum() / n_periods,
        log_determinant(scene, left_impacts.sum(), right_impacts.sum(), n_periods, area_growth.sum()) / n_periods,
    )
    impact_rates, time_within = (
        np.array([block_values.sum() for block_values in quantities]) / n_periods
        for quantities in ((all_impacts, left_impacts, right_impacts), time_within)
    )
    if np.isneginf(exponent):
        return ExponentEstimate(np.full(2, -np.inf), np.zeros(2), impact_rates, time_within, 0, status, n_periods)
    errors = np.array([standard_error(growth, BLOCK_PERIODS), 0.0])
    if np.isfinite(exponent_sum):
        errors[1] = standard_error(
            log_determinant(scene, left_impacts, right_impacts, BLOCK_PERIODS, area_growth) - growth, BLOCK_PERIODS
        )
    if abs(exponent) < MIN_GROWTH_RATE:
        errors = np.maximum(
            errors, 1.0 / (len(growth) * BLOCK_PERIODS)
        )  # a mere shear grows like ln(time), which looks like a steady rate
    return ExponentEstimate(
        np.array([exponent, exponent_sum - exponent]), errors, impact_rates, time_within, 0, status, n_periods
    )
