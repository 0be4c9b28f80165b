"""Lanes run on with a tangent vector each, which the strobe's derivative turns and stretches: periods of one kernel.

A lane's vector is brought back to unit length every period and the logarithm of its growth recorded (Benettin et al.,
Meccanica 15, 1980, 9-20). The derivative is that of `monodromy`, saltation at impacts included (Mueller, Chaos,
Solitons and Fractals 5, 1995, 1671-1681).
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Float, Int

from continuation.arrays import Array
from continuation.persistent_jit import persistent_jit

from ..compiled.compiler_hints import OPTIONS, choose
from ..compiled.kernels import WIDTH, one_kernel
from ..maps.long_run import padded
from ..maps.monodromy import passage
from ..maps.one_period import SLOTS
from ..scene.codes import Status
from ..scene.scene import SIDES
from ..scene.state import State

LAPS = 64  # periods recorded, of however many are run
STRIP = 4  # blocks of a call: what the host does about each call would keep other threads waiting
MATRIX = slice(6, 10)  # of the numbers recorded of a period


class TangentLanes(NamedTuple):
    """Where lanes are: a `State` with leaves (lanes,), unit tangent vectors along x and v (lanes,)."""

    state: State
    along_x: Float[Array, " lanes"]
    along_v: Float[Array, " lanes"]


class Laps(NamedTuple):
    """The last periods of lanes, at most LAPS, NumPy arrays (periods, lanes).

    x, v: at a period's end; growth: the logarithm of the tangent's growth, -inf where the mass has rested; left, right:
    impacts on each wall, at most `one_period.SLOTS` together; count: all impacts; matrix: the derivative of each period
    by rows, (periods, lanes, 4); within: the time spent within each wall, left and right, 0 in rigid ones, (periods,
    lanes, 2); status: the worst of all periods run, (lanes,).
    """

    x: Float[np.ndarray, "periods lanes"]
    v: Float[np.ndarray, "periods lanes"]
    growth: Float[np.ndarray, "periods lanes"]
    left: Float[np.ndarray, "periods lanes"]
    right: Float[np.ndarray, "periods lanes"]
    count: Float[np.ndarray, "periods lanes"]  # type: ignore[assignment]  # hides tuple's method
    matrix: Float[np.ndarray, "periods lanes 4"]
    within: Float[np.ndarray, "periods lanes 2"]
    status: Int[np.ndarray, " lanes"]

    @property
    def points(self) -> Float[np.ndarray, "periods lanes 2"]:
        """Positions and velocities at the ends of the periods, (periods, lanes, 2)."""
        return np.stack([self.x, self.v], -1)


def begin(state):
    """`TangentLanes` at a state, their tangents along no direction that is special."""
    one = np.ones_like(state.x)
    return TangentLanes(state, 0.6 * one, 0.8 * one)


def worse(old, new):
    """The worse of two statuses, one after the other: a lane that has met its end keeps the reason."""
    return jnp.where(old >= Status.CAP, old, jnp.maximum(old, new))


def worse_on_host(old, new):
    """The same of what the host has, whatever its shape: nothing is compiled for it."""
    return np.where(np.asarray(old) >= Status.CAP, old, np.maximum(old, new))


def run(scene, lanes, periods):
    """(TangentLanes, Laps) so many periods later.

    scene: a single one or a lane of a batch each, which is compiled on its own; lanes: any number, run in blocks of
    WIDTH, STRIP of them a call; periods: whole number >= 1, no compilation of its own. The status of a lane is
    `Impacts.status`; FULL where a period had more than `one_period.SLOTS` impacts, NONFINITE where the derivative is
    none, as at an impact without speed.
    """
    size, width = len(lanes.state.x), STRIP * WIDTH
    runs = [_run(*padded((scene, lanes), first, width), size - first, periods) for first in range(0, size, width)]
    ends, rows, worst = jax.tree.map(_put_together, *runs)
    rows = rows[..., :size][:periods]
    if periods > LAPS:
        rows = np.roll(rows, -(periods % LAPS), axis=0)
    ends, worst = jax.tree.map(lambda leaf: leaf[:size], (ends, worst))
    within = np.zeros((*rows[:, 0].shape, 2), rows.dtype)
    for k, side in enumerate(scene.soft_sides):
        within[..., SIDES.index(side)] = rows[:, MATRIX.stop + k]
    return ends, Laps(*np.moveaxis(rows, 1, 0)[: MATRIX.start], np.moveaxis(rows[:, MATRIX], 1, 2), within, worst)


def _put_together(*parts):
    """Lanes, the last axis, one strip after the other; a copy costs, so a single strip is left as it is."""
    return np.asarray(parts[0]) if len(parts) == 1 else np.concatenate(parts, axis=-1)


@persistent_jit(compiler_options=OPTIONS)
def _run(scene, lanes, due, periods):
    """As `_block`, of a strip's first so many lanes, all where it has fewer; 0 of the others."""
    size, dtype = STRIP * WIDTH, lanes.state.x.dtype

    def one(k, out):
        def cut(leaf):
            return lax.dynamic_slice_in_dim(leaf, k * WIDTH, WIDTH) if jnp.ndim(leaf) else leaf

        def put(whole, part):
            return lax.dynamic_update_slice_in_dim(whole, part, k * WIDTH, -1)

        return jax.tree.map(put, out, _block(*jax.tree.map(cut, (scene, lanes)), periods))

    rows = jnp.zeros((LAPS, MATRIX.stop + len(scene.soft_sides), size), dtype)
    blank = jax.tree.map(jnp.zeros_like, lanes), rows, jnp.zeros(size, jnp.int32)
    return lax.fori_loop(0, jnp.minimum(STRIP, -(-due // WIDTH)), one, blank)


def _block(scene, lanes, periods):
    """(lanes, the last periods as a ring (LAPS, numbers, lanes): period i is row i modulo LAPS, the worst status)."""
    size = lanes.state.x.shape

    def one(k, carry):
        lanes, ring, worst = carry
        x, v, contact, along_x, along_v, status, *rest = one_kernel(_period, scene, lanes)
        lanes = TangentLanes(State(x, v, lanes.state.phase, contact), along_x, along_v)
        row = jnp.stack([x, v, *rest])  # a ring for each number costs as much as all else
        return lanes, lax.dynamic_update_index_in_dim(ring, row, k % LAPS, 0), worse(worst, status)

    ring = jnp.zeros((LAPS, MATRIX.stop + len(scene.soft_sides), *size), lanes.state.x.dtype)
    return lax.fori_loop(0, periods, one, (lanes, ring, jnp.zeros(size, jnp.int32)))


def _period(scene, lanes):
    """x, v, contact and tangent a period later, the status; growth, impacts on the left, on the right, all; M; the time
    within each soft wall."""
    end, impacts, rests, way = passage(scene, lanes.state, 1, SLOTS)
    full = (impacts.count > SLOTS) & ~rests
    matrix = [choose(full, jnp.nan, choose(rests, 0.0, each)) for each in way.matrix]
    a, b, c, d = matrix
    along, across = a * lanes.along_x + b * lanes.along_v, c * lanes.along_x + d * lanes.along_v
    size = lax.sqrt(along * along + across * across)
    grown = (size > 0) & jnp.isfinite(size)
    status = choose(full, Status.FULL, choose(jnp.isfinite(size), lax.full_like(impacts.count, 0), Status.NONFINITE))
    status = choose(impacts.status >= Status.CAP, impacts.status, status)
    held = lax.min(impacts.count, jnp.int32(SLOTS)).astype(size.dtype)
    balance = jnp.sum(impacts.side.astype(size.dtype), axis=-1)
    return (
        *(end.x, end.v, end.contact),
        *(choose(grown, along / size, lanes.along_x), choose(grown, across / size, lanes.along_v)),
        status,
        *(lax.log(size), 0.5 * (held - balance), 0.5 * (held + balance)),
        impacts.count.astype(size.dtype),
        *matrix,
        *way.within,
    )
