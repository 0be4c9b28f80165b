"""Which attractor each of very many starts ends on: they are run on together, and dropped once a trap holds them."""

from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Float

from continuation.persistent_jit import persistent_jit

from ..compiled.compiler_hints import OPTIONS
from ..compiled.kernels import WIDTH
from ..maps import two_tiers
from ..maps.iterate import iterate
from ..maps.phase_shift import shift_phase
from ..scene.codes import Status
from ..scene.state import State
from ..stores.engines import cores
from .trapping_region import Cloud, Trap, cloud, trap

ROUND = 8  # drive periods between two looks
LANES = 1 << 14  # of one compiled call
STAYS = 8  # looks in a row at which a start must be near a chaotic attractor
UNRESOLVED, OUTSIDE = -1, -2
FAR = 1e18  # where lanes without an end are put, on no attractor


class Home(NamedTuple):
    """An attractor at a phase: points on Sigma (n, 2), a sample where chaotic; its `Trap` or `Cloud`, or None."""

    points: Float[np.ndarray, "points 2"]
    trap: Trap | Cloud | None


def homes(scene, attractors, phase, scale):
    """The `Home` of each of some attractors, at a phase of the drive (rad); scale: of x and v, the largest."""
    return [_home(scene, one, phase, scale) for one in attractors]


def _home(scene, one, phase, scale):
    if one.kind == "unresolved":
        return Home(one.points, None)
    if one.kind == "chaotic":
        found = cloud(scene, one.points, phase)
        return Home(np.asarray(found.tree.data[:: len(one.points)]), found)
    given = (one.state.x, one.state.v, 0.0, one.state.contact)
    state, _ = shift_phase(scene, State(*(np.full(1, each, scene.dtype) for each in given)), phase)
    points = iterate(scene, state, one.periods).points[:, 0]
    return Home(points, trap(scene, points, phase, scale))


def assign_labels(scene, x, v, phase, homes, patience):
    """`labelled` by all processor cores."""
    with ThreadPoolExecutor(cores()) as pool:
        return labelled(pool, scene, x, v, phase, homes, patience)


def labelled(pool, scene, x, v, phase, homes, patience):
    """(label, periods): where each start (lanes,) ends, and the drive periods after which that was seen.

    label: the place in `homes`; UNRESOLVED where no trap held the start within so many periods, and OUTSIDE beyond a
    wall. pool: of threads.
    """
    label, seen = np.full(len(x), UNRESOLVED, np.int32), np.zeros(len(x), np.int32)
    lanes = np.arange(len(x))
    now = np.stack([x, v, np.zeros(len(x))]).astype(scene.dtype)
    near = np.zeros((len(homes), len(x)), np.int8)
    for passed in range(ROUND, patience + ROUND, ROUND):
        parts = [slice(first, first + LANES) for first in range(0, len(lanes), LANES)]
        some = [[each[..., part] for part in parts] for each in (now, near)]
        looks = pool.map(partial(_look, scene, phase, homes), *some)
        now, near, found, status = (np.concatenate(each, axis=-1) for each in zip(*looks, strict=True))
        found = np.where(status == Status.INVALID, OUTSIDE, found)
        done = (found != UNRESOLVED) | (status >= Status.CAP)
        label[lanes[done]], seen[lanes[done]] = found[done], passed
        lanes, now, near = lanes[~done], now[:, ~done], near[:, ~done]
        if not len(lanes):
            break
    return label, seen


def _look(scene, phase, homes, now, near):
    """((x, v, contact), looks in a row near each home, its place or UNRESOLVED, status) one round later, lanes last."""
    count = now.shape[1]
    padded = [np.pad(each, (0, LANES - count)) for each in now]
    *ends, status = (
        each[:count] for each in jax.device_get(_round(scene, *padded, scene.dtype.type(phase), -(-count // WIDTH)))
    )
    z, found = np.stack(ends[:2], -1), np.full(count, UNRESOLVED, np.int32)
    z[status >= Status.CAP] = scene.dtype.type(FAR)
    near = near.copy()
    for place, home in enumerate(homes):
        if home.trap is None:
            continue
        held = home.trap.holds(z)
        if isinstance(home.trap, Cloud):
            near[place] = np.where(held, near[place] + 1, 0)
            held = near[place] >= STAYS
        found[held] = place
    return np.stack(ends), near, found, status


@persistent_jit(compiler_options=OPTIONS)
def _round(scene, x, v, contact, phase, blocks):
    """(x, v, contact, status) a round later, of so many blocks of lanes; the rest stays as it is."""

    def block(k, carry):
        start = k * WIDTH
        given = [lax.dynamic_slice_in_dim(each, start, WIDTH) for each in carry[:3]]
        end, impacts = two_tiers.strobe(scene, State(given[0], given[1], phase, given[2]), ROUND, 0, WIDTH)
        new = (end.x, end.v, end.contact, impacts.status)
        return [lax.dynamic_update_slice_in_dim(old, part, start, 0) for old, part in zip(carry, new, strict=True)]

    return lax.fori_loop(0, blocks, block, [x, v, contact, jnp.zeros(x.shape, jnp.int32)])
