"""The largest Lyapunov exponent, from the distance between two nearby trajectories (Benettin, Galgani and Strelcyn).

The distance is brought back to its first size every few periods, and the logarithms of its growth are averaged.
"""

import jax
import numpy as np

from ..flight.wall_positions import places
from ..maps.iterate import ends
from ..scene.codes import Status
from ..scene.state import State

EVERY = 5  # periods between two renormalisations
TIMES = 200  # renormalisations; the second half is averaged


def exponents(scene, state, scale):
    """(mean, error) per period of each lane's largest exponent: growth rates and their standard errors, shape (lanes,).

    scene: a single one; state: leaves (lanes,), on what the exponent is asked of; scale: of x and v, the largest. Where
    a lane or its companion gets a bad status both are nan. Where the distance shrinks to rounding within EVERY periods,
    as after an impact that leaves no speed, the mean is -inf: it is below what can be measured.
    """
    eps = np.finfo(scene.dtype).eps
    size, apart = len(state.x), eps**0.5 * scale
    heading = np.tile(np.array([[0.6], [0.8]], scene.dtype), size)
    growth, bad = [], np.zeros(size, bool)
    for _ in range(TIMES):
        both = _beside(scene, state, apart * heading)
        before = _between(both, size)
        both, status = ends(scene, both, EVERY, few=0)
        bad |= (status >= Status.CAP).reshape(2, size).any(axis=0)
        after = _between(both, size)
        largest = abs(after).max(axis=0)
        seen = largest > 16.0 * eps * scale
        growth.append(np.log(largest / abs(before).max(axis=0), where=seen, out=np.full(size, -np.inf)) / EVERY)
        heading = np.where(largest > 0, after / np.where(largest > 0, largest, 1.0), heading)
        state = jax.tree.map(lambda leaf: leaf[:size], both)
    late = np.stack(growth[TIMES // 2 :])
    seen = np.isfinite(late).all(axis=0)
    mean, error = late.mean(axis=0), np.where(seen, late, 0.0).std(axis=0) / len(late) ** 0.5
    return np.where(bad, np.nan, mean), np.where(bad, np.nan, error)


def _beside(scene, state, step):
    """The lanes, then their companions a step away; to the other side where the step leads through a wall."""
    (low, _), (high, _) = jax.tree.map(np.asarray, places(scene, state.phase[0]))
    x = state.x + step[0]
    turned = np.where((x < low) | (x > high), -step, step)
    companion = State(state.x + turned[0], state.v + turned[1], state.phase, np.zeros_like(state.contact))
    return jax.tree.map(lambda *parts: np.concatenate(parts), state, companion)


def _between(both, size):
    return np.stack([both.x[size:] - both.x[:size], both.v[size:] - both.v[:size]])
