"""What very many lanes settle on, each a scene of its own: a periodic orbit, chaos, or nothing that is certain.

Lanes are run on until they recur, or until patience ends; those that have not recurred are put together and sorted by
how much work a period of theirs is, so that no lane of a block waits for long. A lane's result is its own: it does not
depend on the lanes beside it, nor on what the process did before.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Float, Int

from continuation.persistent_jit import persistent_jit

from ..attractors.batch_means import standard_error
from ..attractors.classify import LEAST_EXPONENT
from ..attractors.orbit_exponents import of_orbits
from ..attractors.recurrence import returns, settled_periods
from ..attractors.tangent import LAPS, TangentLanes, begin, run, worse, worse_on_host
from ..compiled.compiler_hints import OPTIONS
from ..compiled.kernels import WIDTH
from ..maps.initial_conditions import box
from ..maps.long_run import padded, some
from ..maps.rests import rests
from ..maps.strobe import strobe
from ..scene.check import MOST_PERIODS
from ..scene.codes import Status
from ..scene.scene import Scene
from ..scene.state import State

BLOCK = 16  # periods whose growth is summed
SURE = 3.0  # standard errors by which the exponent of chaos must exceed `LEAST_EXPONENT`
UNDECIDED, CHAOTIC = -1, 0  # in place of the periods of an orbit
NEAR = 1e-3  # of x and v, the largest: how near a state that has settled is to one before
SAMPLE = 8  # times LAPS periods of a motion that does not recur, which are kept


class Motions(NamedTuple):
    """What lanes have settled on: NumPy arrays, lanes last.

    state: where they are, on Sigma; status: the worst met; periods: of the orbit, CHAOTIC or UNDECIDED; hits: impacts
    on the left and on the right wall in so many periods, (2, lanes), 0 where not periodic; endless: on which walls the
    mass comes to rest by complete chatter, 1 left, 2 right, 3 both; exponent, error: the largest Lyapunov exponent per
    drive period, and its standard error, nan where it is not known; points: x and v on Sigma of the last periods,
    (periods, lanes, 2), nan before what was kept.
    """

    state: State
    status: Int[np.ndarray, " lanes"]
    periods: Int[np.ndarray, " lanes"]
    hits: Int[np.ndarray, "2 lanes"]
    endless: Int[np.ndarray, " lanes"]
    exponent: Float[np.ndarray, " lanes"]
    error: Float[np.ndarray, " lanes"]
    points: Float[np.ndarray, "periods lanes 2"]


def motions(scene: Scene, state: State, settle: int, patience: int) -> Motions:
    """What lanes settle on.

    scene: its numbers single or (lanes,); state: leaves (lanes,); settle: drive periods before recurrence is looked
    for; patience: those after which a lane that has not recurred is taken for what it then looks like.
    """
    count = int(np.size(state.x))
    state, status = _onward(scene, state, settle)
    found = Motions(
        state,
        status,
        np.full(count, UNDECIDED),
        np.zeros((2, count), int),
        np.zeros(count, int),
        np.full(count, np.nan),
        np.full(count, np.nan),
        np.full((SAMPLE * LAPS, count, 2), np.nan, scene.dtype),
    )
    _look(scene, found, np.flatnonzero(status < Status.CAP), settle, patience)
    return found


def _onward(scene, state, periods):
    """(state, worst status) of lanes so many periods later."""
    count = len(state.x)
    blocks = [padded((scene, state), first, WIDTH) for first in range(0, count, WIDTH)]
    runs = [_run_on(*block, periods) for block in blocks]
    return jax.tree.map(lambda *parts: np.concatenate(parts)[:count], *runs)


@persistent_jit(compiler_options=OPTIONS)
def _run_on(scene, state, periods):
    def one(_, carry):
        state, status = carry
        state, impacts = strobe(scene, state, slots=0)
        return state, worse(status, jnp.where(impacts.status >= Status.CAP, impacts.status, Status.OK))

    return lax.fori_loop(0, periods, one, (state, jnp.zeros(state.x.shape, jnp.int32)))


def _look(scene, found, lanes, settle, patience):
    """Runs lanes on until they recur or patience ends, and puts into `found` what is seen of them."""
    here, passed = some(scene, lanes), settle
    if not len(lanes):
        return
    now, laps = run(here, begin(some(found.state, lanes)), LAPS)
    scale, status = _scale(here, laps), laps.status
    before, passed, growth = _returns(laps.points, scale), passed + LAPS, []
    while len(lanes):
        now, laps = run(here, now, LAPS)
        status = worse_on_host(status, laps.status)
        passed += LAPS
        found.points[(turn := len(growth) % SAMPLE * LAPS) : turn + LAPS, lanes] = laps.points
        growth.append(np.ascontiguousarray(laps.growth.T).reshape(len(lanes), -1, BLOCK).sum(axis=-1))
        back = _returns(laps.points, scale)
        periods = settled_periods(back, before, LAPS, scale, scene.dtype)
        ended = (status >= Status.CAP) | (periods > 0) | (passed >= patience)
        well = (periods > 0) & (status < Status.CAP)
        _put(found, lanes[ended], some(now, ended), status[ended])
        found.points[:, lanes[ended]] = np.roll(found.points[:, lanes[ended]], -turn - LAPS, axis=0)
        _orbits(scene, found, lanes[well], periods[well], laps, np.flatnonzero(well))
        _chaos(found, lanes, np.flatnonzero(ended & ~well & (status < Status.CAP)), growth)
        order = np.flatnonzero(~ended)
        order = order[np.argsort(laps.count[:, order].sum(axis=0), kind="stable")]
        lanes, here, scale, status, before = (
            lanes[order],
            some(here, order),
            scale[order],
            status[order],
            back[:, order],
        )
        now, growth = some(now, order), [part[order] for part in growth]


def _returns(points, scale):
    """`returns` of the lanes whose last state has been nearly met before, infinite of others: they have not settled."""
    apart = abs(points[-1] - points[-1 - MOST_PERIODS : -1]).max(axis=-1).min(axis=0)
    near = np.flatnonzero(apart <= NEAR * scale)
    found = np.full((MOST_PERIODS, points.shape[1]), np.inf)
    found[:, near] = returns(points[:, near])
    return found


def _scale(scene, laps):
    """Of x and v, the largest, of each lane."""
    left, right, _ = box(scene)
    fast = np.nanmax(np.where(np.isfinite(laps.v), abs(laps.v), 0.0), axis=0)
    return np.maximum(np.maximum(abs(left), abs(right)), fast)


def _put(found, lanes, ends: TangentLanes, status):
    for old, new in zip(jax.tree.leaves(found.state), jax.tree.leaves(ends.state), strict=True):
        old[lanes] = new
    found.status[lanes] = status


def _orbits(scene, found, lanes, periods, laps, places):
    """Puts periodic orbits into `found`, those that draw in; places: of the lanes among those of the laps."""
    for n in np.unique(periods).tolist():
        alike = periods == n
        here, at = lanes[alike], places[alike]
        rates = of_orbits(some(scene, here), some(found.state, here), periods[alike])
        found.hits[:, here] = [np.rint(each[-n:, at].sum(axis=0)) for each in (laps.left, laps.right)]
        found.exponent[here], found.error[here] = rates.exponent[:, 0], rates.error[:, 0]
        found.periods[here[~(np.isnan(found.exponent[here]) | rates.repels)]] = n
    for lane in lanes[np.isneginf(found.exponent[lanes])].tolist():
        one = some(scene, lane), jax.tree.map(lambda leaf, lane=lane: leaf[lane], found.state)
        letters = rests(*one, int(found.periods[lane])).endless if found.periods[lane] > 0 else ""
        found.endless[lane] = ("L" in letters) + 2 * ("R" in letters)


def _chaos(found, lanes, places, growth):
    """Puts the motions that have not recurred into `found`, as chaotic where their exponent is beyond doubt."""
    if not len(places):
        return
    sums = np.concatenate([part[places] for part in growth], axis=1)  # a row a lane: the order of a sum is its own
    rate = sums.mean(axis=1) / BLOCK
    error = np.array([standard_error(row[:, None], BLOCK) for row in sums])
    sure = rate - SURE * error > LEAST_EXPONENT
    here = lanes[places]
    found.exponent[here], found.error[here] = rate, error
    found.periods[here[sure]] = CHAOTIC
