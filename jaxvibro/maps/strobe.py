"""The stroboscopic map: the state one or more drive periods later, and the impacts on the way."""

import math
from functools import partial

import jax
import numpy as np

from continuation.persistent_jit import persistent_jit

from ..compiled.blocks import LEAST
from ..compiled.compiler_hints import OPTIONS
from ..scene import check
from ..scene.scene import Scene
from ..scene.state import Impacts, State, real_state
from . import derivatives, one_period, two_tiers

SOME = 256  # lanes of which one is nearly always given up: up to a chunk of them are done by both tiers in one call
CHUNK = 1024  # lanes that lean steps have given up are done so many at a time


@persistent_jit(static_argnums=(2, 3, 4), compiler_options=OPTIONS)
def _at_once(scene, state, periods, slots, clearance):
    return two_tiers.strobe(scene, state, periods, slots, LEAST, clearance)


@persistent_jit(static_argnums=(2, 3), compiler_options=OPTIONS)
def _lean(scene, state, slots, clearance):
    return two_tiers.lean_alone(scene, state, slots, LEAST, clearance)


@persistent_jit(static_argnums=(2, 3), compiler_options=OPTIONS)
def _lean_of_one(scene, numbers, slots, clearance):
    """The same of one state, its numbers in a row: each array that is handed over takes some microseconds."""
    return two_tiers.lean_alone(scene, State(*numbers), slots, LEAST, clearance)


@persistent_jit(static_argnums=(2, 3), compiler_options=OPTIONS)
def _full(scene, state, slots, clearance, due):
    return one_period.strobe(scene, state, 1, slots, LEAST, clearance, due)


@partial(jax.jit, donate_argnums=0)
def _put(whole, places, part):
    """The results with those of some lanes replaced, in place; a place beyond the end is none."""
    return jax.tree.map(lambda old, new: old.at[places].set(new, mode="drop"), whole, part)


def _at(tree, places, shape):
    """The lanes at some places of numbers that broadcast to a shape."""
    return jax.tree.map(lambda leaf: np.broadcast_to(leaf, shape)[places] if leaf.ndim else leaf, tree)


def from_host(scene, state, periods, slots, clearance):
    """The strobe of numbers that are known: what the lean tier does not need is not compiled."""
    numbers = (state.x, state.v, state.phase, state.contact)
    shapes = [scene.shape, *map(np.shape, numbers)]
    shape = np.broadcast_shapes(*shapes) if any(shapes) else ()
    if periods > 1 or not two_tiers.takes(scene) or SOME <= math.prod(shape) <= CHUNK:
        return _at_once(scene, state, periods, slots, clearance)
    if not shape:
        found, given_up = _lean_of_one(scene, np.array(numbers), slots, clearance)
        return _full(scene, state, slots, clearance, None) if np.asarray(given_up) else found
    found, given_up = _lean(scene, state, slots, clearance)
    due = np.flatnonzero(given_up)
    if not due.size:
        return found
    given = jax.tree.map(np.asarray, (scene, state))
    width = min(CHUNK, np.size(given_up))
    for first in range(0, due.size, width):
        some = due[first : first + width]
        spare = width - some.size
        lanes = np.unravel_index(np.pad(some, (0, spare), mode="edge"), shape)
        part = _full(*_at(given, lanes, shape), slots, clearance, np.int32(some.size))
        places = (np.where(np.arange(width) < some.size, lanes[0], shape[0]), *lanes[1:])
        found = _put(found, places, part)
    return found


@check.typed
def strobe(
    scene: Scene, state: State, periods: int = 1, slots: int = 4, clearance: bool = False
) -> tuple[State, Impacts]:
    """The state after a number of drive periods, and the impacts on the way: (State, Impacts).

    scene: a `Scene`; state: a `State` at its phase; their numbers broadcast together, and the results have that shape.
    periods: whole number >= 1; slots: impacts to record, >= 0: with more of them the status is FULL, and all else is
    right; clearance: whether to measure `Impacts.least_clearance`, which else is None. What is not asked for costs no
    time. The state's phase comes back unchanged. An impact at the end belongs to the period that ends: the state is the
    one after it, and its contact says so. A start on a wall and moving into it rebounds at time 0. A flight that turns
    back within 8 ulp of its largest length (x, v, A, the walls') of a wall may count as a contact or as none. n periods
    in one call are n strobes: between rigid walls in double precision bit for bit; elsewhere
    but for roundings, which it carries on: they differ by less than 16 eps (1 + T) s (1 + the sum of abs M), T = 2 pi /
    omega, s the largest length or speed, M the derivative from each strobe on to the end (docs/numbers.md).

    jax.grad, jacfwd, jacrev, hessian and the rest go through it, at any order: by x, v, phase and every number of the
    scene; of the state, the impacts' times and speeds and the least speed. The rest of `Impacts` counts as constant.
    A derivative is nan where there is no end: the status says so. An impact at the end, and an entry into a soft wall
    or an exit from it at the end, make derivatives one-sided: they are those of the state and contact returned. With
    more than 32 impacts a period since the last rest that of the state may be nan, and is where it is of higher order.
    At an impact without speed there is none: what comes is that of the flight past it. A mass at rest forgets its
    start, and the impacts before it.

    Raises ArgumentError for periods, slots, clearance or a state that cannot be; all else is a status of each lane
    (`Impacts`).
    """
    periods, slots = check.whole("periods", periods, 1), check.whole("slots", slots, 0)
    if not isinstance(clearance, bool | np.bool_):
        raise check.ArgumentError("clearance", "must be True or False", clearance)
    state = real_state(scene, state)
    traced = any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves((scene, state)))
    return (derivatives.strobe if traced else from_host)(scene, state, periods, slots, bool(clearance))
