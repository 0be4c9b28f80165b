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


def largest_exponents(scene, state, scale):
    """Return (mean, standard error) of each lane's largest exponent per period, shape (lanes,).

    scene: a single one; state: leaves (lanes,), after the transient; scale: largest magnitude of x and v. Both are nan
    if a lane or its companion gets a bad status. The mean is -inf if the distance shrinks to rounding within
    `RENORMALISATION_PERIODS`, as after an impact without rebound: it is too low to be measured.
    """
    eps = np.finfo(scene.dtype).eps
    n_lanes, separation = len(state.x), eps**0.5 * scale
    direction = np.tile(np.array([[0.6], [0.8]], scene.dtype), n_lanes)
    growth_rates, invalid = [], np.zeros(n_lanes, bool)
    for _ in range(N_RENORMALISATIONS):
        pairs = _add_companions(scene, state, separation * direction)
        old_difference = _pair_differences(pairs, n_lanes)
        pairs, status = final_states(scene, pairs, RENORMALISATION_PERIODS, max_single_lanes=0)
        invalid |= (status >= Status.CAP).reshape(2, n_lanes).any(axis=0)
        difference = _pair_differences(pairs, n_lanes)
        distance = abs(difference).max(axis=0)
        resolvable = distance > 16.0 * eps * scale
        growth_rates.append(
            np.log(distance / abs(old_difference).max(axis=0), where=resolvable, out=np.full(n_lanes, -np.inf))
            / RENORMALISATION_PERIODS
        )
        direction = np.where(distance > 0, difference / np.where(distance > 0, distance, 1.0), direction)
        state = jax.tree.map(lambda leaf: leaf[:n_lanes], pairs)
    late_rates = np.stack(growth_rates[N_RENORMALISATIONS // 2 :])
    resolvable = np.isfinite(late_rates).all(axis=0)
    mean, error = late_rates.mean(axis=0), np.where(resolvable, late_rates, 0.0).std(axis=0) / len(late_rates) ** 0.5
    return np.where(invalid, np.nan, mean), np.where(invalid, np.nan, error)


def _add_companions(scene, state, step):
    """Return the lanes followed by their companions one step away, on the other side if the step crosses a wall."""
    (x_min, _), (x_max, _) = jax.tree.map(np.asarray, wall_states(scene, state.phase[0]))
    x = state.x + step[0]
    signed_step = np.where((x < x_min) | (x > x_max), -step, step)
    companion = State(state.x + signed_step[0], state.v + signed_step[1], state.phase, np.zeros_like(state.contact))
    return jax.tree.map(lambda *leaves: np.concatenate(leaves), state, companion)


def _pair_differences(pairs, n_lanes):
    """Return the differences of companions and lanes, (2, lanes)."""
    return np.stack([pairs.x[n_lanes:] - pairs.x[:n_lanes], pairs.v[n_lanes:] - pairs.v[:n_lanes]])
