"""Estimate the largest Lyapunov exponent from two nearby trajectories (Benettin, Galgani and Strelcyn).

The distance is renormalised every few periods, and the logarithms of its growth are averaged.
"""

import jax
import numpy as np

from ..flight.wall_positions import wall_states
from ..maps.iterate import final_states
from ..scene.codes import Status
from ..scene.state import State

RENORMALISATION_PERIODS = 5  # periods between two renormalisations
N_RENORMALISATIONS = 200  # renormalisations; the second half is averaged


def largest_exponents(scene, state, max_state_magnitude):
    """Return (mean, standard error) of each lane's largest exponent per period, shape (lanes,).

    scene: single; state: leaves (lanes,), after the transient; max_state_magnitude: largest magnitude of x and v. Mean
    and error are nan if a lane or its companion has a status of CAP or worse. The mean is -inf if the exponent is too
    low to be measured: the distance shrinks to rounding within `RENORMALISATION_PERIODS`, as after an impact with R =
    0.
    """
    machine_eps = np.finfo(scene.dtype).eps
    n_lanes, separation = len(state.x), machine_eps**0.5 * max_state_magnitude
    state_direction = np.tile(np.array([[0.6], [0.8]], scene.dtype), n_lanes)
    growth_rates, is_invalid = [], np.zeros(n_lanes, bool)
    for _ in range(N_RENORMALISATIONS):
        lanes_and_companions = _add_companions(scene, state, separation * state_direction)
        initial_difference = _companions_minus_lanes(lanes_and_companions, n_lanes)
        lanes_and_companions, status = final_states(
            scene, lanes_and_companions, RENORMALISATION_PERIODS, max_single_lanes=0
        )
        is_invalid |= (status >= Status.CAP).reshape(2, n_lanes).any(axis=0)
        final_difference = _companions_minus_lanes(lanes_and_companions, n_lanes)
        final_distance = abs(final_difference).max(axis=0)
        is_resolvable = final_distance > 16.0 * machine_eps * max_state_magnitude
        growth_rates.append(
            np.log(
                final_distance / abs(initial_difference).max(axis=0), where=is_resolvable, out=np.full(n_lanes, -np.inf)
            )
            / RENORMALISATION_PERIODS
        )
        state_direction = np.where(
            final_distance > 0, final_difference / np.where(final_distance > 0, final_distance, 1.0), state_direction
        )
        state = jax.tree.map(lambda leaf: leaf[:n_lanes], lanes_and_companions)
    late_growth_rates = np.stack(growth_rates[N_RENORMALISATIONS // 2 :])
    is_resolvable = np.isfinite(late_growth_rates).all(axis=0)
    mean_growth_rate, error = (
        late_growth_rates.mean(axis=0),
        np.where(is_resolvable, late_growth_rates, 0.0).std(axis=0) / len(late_growth_rates) ** 0.5,
    )
    return np.where(is_invalid, np.nan, mean_growth_rate), np.where(is_invalid, np.nan, error)


def _add_companions(scene, state, offset):
    """Return the lanes followed by their companions, whose x and v differ by `offset`.

    The offset is reversed if the companion would be beyond a wall.
    """
    (x_min, _), (x_max, _) = jax.tree.map(np.asarray, wall_states(scene, state.phase[0]))
    x = state.x + offset[0]
    signed_offset = np.where((x < x_min) | (x > x_max), -offset, offset)
    companion_state = State(
        state.x + signed_offset[0], state.v + signed_offset[1], state.phase, np.zeros_like(state.contact)
    )
    return jax.tree.map(lambda *leaves: np.concatenate(leaves), state, companion_state)


def _companions_minus_lanes(lanes_and_companions, n_lanes):
    """Return x and v of the companions minus those of their lanes, shape (2, lanes)."""
    return np.stack(
        [
            lanes_and_companions.x[n_lanes:] - lanes_and_companions.x[:n_lanes],
            lanes_and_companions.v[n_lanes:] - lanes_and_companions.v[:n_lanes],
        ]
    )
