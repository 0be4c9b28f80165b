"""The Lyapunov exponents of motions that do not recur: averages of a tangent's growth, over many copies of a motion.

The first exponent is the mean growth of a tangent vector, the second what is left of ln abs det M, which impacts and
damping tell (`orbit_exponents.shrinkage`). With one tangent and the determinant this is Benettin's method for two
exponents.
"""

from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float, Int

from ..compiled.kernels import WIDTH
from ..maps.initial_conditions import box
from ..scene.codes import Contact, Status
from ..scene.state import State
from .batch_means import standard_error
from .orbit_exponents import Rates, areas, lost, shrinkage
from .recurrence import returns, settled_periods
from .tangent import LAPS, TangentLanes, begin, run, worse_on_host

BLOCK = 16  # periods whose growth is summed
FIRST = 16  # times LAPS periods before the error is first looked at
SLOWEST = 0.02  # growth a period below which copies of a motion may stay together for thousands of periods


class Settled(NamedTuple):
    """Lanes that have been run for a while, NumPy arrays, lanes last.

    lanes: where they are; status: the worst met; periods: after which each recurs, 0 for not at all; rate: mean growth;
    visits: states on the way, LAPS periods apart, leaves (visits, lanes); scale: of x and v, the largest.
    """

    lanes: TangentLanes
    status: Int[np.ndarray, " lanes"]
    periods: Int[np.ndarray, " lanes"]
    rate: Float[np.ndarray, " lanes"]
    visits: State
    scale: Float[np.ndarray, " lanes"]

    @property
    def is_well(self) -> bool:
        """Whether a single lane has not met its end."""
        return bool(np.isfinite(np.ravel(self.lanes.state.x)[0]))

    @property
    def goes_on(self) -> bool:
        """Whether a single lane has yet to settle."""
        return self.is_well and not self.periods[0]


def settled(scene, lanes, settle, rounds):
    """`Settled`: lanes run on for `settle` periods, then for LAPS, so many times or until all recur.

    scene: a single one or a lane of a batch each.
    """
    lanes, laps = run(scene, lanes, settle + LAPS)
    before, status, dtype = returns(laps.points), laps.status, lanes.state.x.dtype
    left, right, _ = box(scene)
    fast = np.max(abs(laps.v), where=np.isfinite(laps.v), initial=0.0)
    scale = max(abs(left).max(), abs(right).max(), fast)
    periods, rate, visits = np.zeros(len(lanes.state.x), int), [], []
    for _ in range(rounds):
        lanes, laps = run(scene, lanes, LAPS)
        now = returns(laps.points)
        periods = np.where(periods > 0, periods, settled_periods(now, before, LAPS, scale, dtype))
        rate.append(laps.growth.mean(axis=0))
        visits.append(lanes.state)
        before, status = now, worse_on_host(status, laps.status)
        if np.all((periods > 0) | ~np.isfinite(lanes.state.x)):
            break
    visits = jax.tree.map(lambda *parts: np.stack(parts), *visits)
    return Settled(lanes, status, periods, np.mean(rate, axis=0), visits, np.full(len(periods), scale))


def of_motion(scene, start, goal, most):
    """(`Rates`, None) of the motion of a single scene; where it ends on a periodic orbit after all, `Settled` as well.

    start: `Settled`, of one lane; goal: the standard error to come to, with at most about so many periods. WIDTH
    copies of the motion are run: from states that it visited, with speeds a little off, until the copies have gone
    their own ways; where they hardly part, from one state, so that what they have in common is seen as such.
    """
    scale = start.scale[0]
    lanes = _copies(start, scale)
    dtype = lanes.state.x.dtype
    pace = start.rate[0] if start.rate[0] > SLOWEST else SLOWEST
    span = np.log(np.finfo(dtype).eps ** -0.5) / pace
    lanes, laps = run(scene, lanes, LAPS * (1 + int(span / LAPS)))
    sums, status, chunks = [], laps.status, max(2, min(FIRST, most // (LAPS * WIDTH)))
    while True:
        for _ in range(chunks - len(sums)):
            before, (lanes, laps) = laps, run(scene, lanes, LAPS)
            within = np.moveaxis(laps.within, -1, 0)
            rows = np.stack([laps.growth, laps.left, laps.right, laps.count, areas(scene, laps), *within])
            sums.append(rows.reshape(len(rows), -1, BLOCK, WIDTH).sum(2))
            status = worse_on_host(status, laps.status)
        rates = _averaged(scene, np.concatenate(sums, axis=1), int(status.max()))
        periods = settled_periods(returns(laps.points), returns(before.points), LAPS, scale, dtype)
        if status.max() < Status.CAP and periods.any():
            lane = np.flatnonzero(periods)[:1]
            return rates, start._replace(lanes=_some(lanes, lane), periods=periods[lane])
        worst = rates.error.max()
        if not worst > goal or rates.count >= most:
            return rates, None
        wanted = len(sums) * min(2.0, 1.05 * (worst / goal) ** 2)
        chunks = min(max(len(sums) + 1, int(np.ceil(wanted))), -(-most // (LAPS * WIDTH)))


def _some(lanes, index):
    return jax.tree.map(lambda leaf: leaf[index], lanes)


def _copies(start, scale):
    """The `TangentLanes` of WIDTH copies of a motion."""
    count = len(start.visits.x) if start.rate[0] > SLOWEST else 1
    places = -1 - np.arange(WIDTH) % count
    state = jax.tree.map(lambda leaf: leaf[places, 0], start.visits)
    dtype = state.x.dtype
    off = np.random.default_rng(0).normal(size=WIDTH) * np.finfo(dtype).eps ** 0.4 * scale
    held = (state.contact == 0) | (abs(state.contact) == Contact.WITHIN)
    v = np.where(held, state.v + off.astype(dtype), state.v)
    return begin(State(state.x, v, state.phase, state.contact))


def _averaged(scene, sums, status):
    """The `Rates` of sums of growth, impacts (left, right, all), `areas` and the time within each wall over blocks,
    shape (7, blocks, copies)."""
    growth, left, right, hits, area, *within = sums
    count = growth.size * BLOCK
    if status >= Status.CAP or np.isnan(growth).any() or np.isposinf(growth).any():
        return lost(status if status else Status.NONFINITE)
    first, both = growth.sum() / count, shrinkage(scene, left.sum(), right.sum(), count, area.sum()) / count
    impacts, within = (np.array([part.sum() for part in each]) / count for each in ((hits, left, right), within))
    if np.isneginf(first):
        return Rates(np.full(2, -np.inf), np.zeros(2), impacts, within, 0, status, count)
    error = np.array([standard_error(growth, BLOCK), 0.0])
    if np.isfinite(both):
        error[1] = standard_error(shrinkage(scene, left, right, BLOCK, area) - growth, BLOCK)
    if abs(first) < SLOWEST:
        error = np.maximum(error, 1.0 / (len(growth) * BLOCK))  # a shear alone grows like ln(time), which looks steady
    return Rates(np.array([first, both - first]), error, impacts, within, 0, status, count)
