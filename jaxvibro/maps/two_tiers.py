"""The stroboscopic map in two tiers: lean steps first, full ones for the lanes that those give up.

Which tier does a lane's period depends on the lane alone, so that a batch may be cut and permuted as one likes. A
period of many begins with the state that the one before has ended with: it is a strobe of its own.
"""

from dataclasses import replace
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from ..compiled.blocks import in_blocks
from ..compiled.compiler_hints import choose
from ..compiled.kernels import narrow_width, one_kernel
from ..flight import impact_log, lean, lean_numbers, lean_tangent
from ..flight.coefficients import frame
from ..flight.entry import enter
from ..flight.lean_tangent import Tangent
from ..scene.codes import Contact, Status
from ..scene.state import Impacts, State
from . import one_period
from .one_period import Past
from .replayed_slopes import known_impacts, replayed_slopes, slots_first

STRIP = 8  # blocks of one kernel: what is launched around a kernel takes a tenth of a block's time


class Asked(NamedTuple):
    """What is asked for, static: how many slots, whether the least clearance, derivatives by which leaves of (scene,
    state), and how many slots of a `one_period.Past` a period, which is for a replay."""

    slots: int
    clearance: bool = False
    chosen: tuple[int, ...] = ()
    late: int = 0


def strobe(scene, state, periods, slots, least, clearance=False):
    """(State, Impacts) of numbers that broadcast, in blocks of so many lanes at least."""
    return recorded(scene, state, periods, slots, least, clearance)[0]


def recorded(scene, state, periods, slots, least, clearance=False, late=0):
    """((State, Impacts), `one_period.Past`), as `strobe`; late: slots of the past, not more than of the impacts."""
    if not takes(scene):
        return one_period.recorded(scene, state, periods, slots, least, clearance, late)
    scene, state, shape = _flat(scene, state)
    out, past, _ = _periods(scene, state, (), periods, Asked(slots, clearance, late=late), least)
    return _shaped((out, past), shape)


def sloped(tree, *leaves, periods, slots, least, chosen):
    """((State, Impacts), (those of x, of v)): with derivatives by the chosen ones of the leaves of (scene, state).

    An axis for each choice, last. The scene is one that the lean tier `takes`.
    """
    scene, state, shape = _flat(*tree.unflatten(leaves))
    none, one = jnp.zeros_like(state.x), jnp.ones_like(state.x)
    start = tuple(Tangent(*(one if place == k else none for k in _own(tree))) for place in chosen)
    out, _, tangents = _periods(scene, state, start, periods, Asked(slots, chosen=chosen), least)
    slopes = tuple(jnp.stack(ways, axis=-1) for ways in zip(*tangents, strict=True))
    return _shaped((out, slopes), shape)


def _own(tree):
    """The places of x and v among the leaves of (scene, state)."""
    return tree.num_leaves - 4, tree.num_leaves - 3


def _periods(scene, state, start, periods, asked, least):
    out = _tried(scene, state, start, asked, least)
    if periods > 1:
        out = lax.fori_loop(1, periods, partial(_again, scene, asked, least), out)
    return out


def _shaped(tree, shape):
    return jax.tree.map(lambda leaf: leaf.reshape(*shape, *leaf.shape[1:]) if shape else leaf, tree)


def lean_alone(scene, state, slots, least, clearance=False):
    """((State, Impacts), whether a lane was given up: then the rest of what is said of it is of no meaning)."""
    scene, state, shape = _flat(scene, state)
    out, _, given_up = _in_blocks(scene, state, (), Asked(slots, clearance), least)
    return _shaped((out, given_up), shape)


def takes(scene):
    """Whether the lean tier knows such a scene: spring, damper, a drive of one term and rigid walls, in double
    precision."""
    walls = [wall for wall in (scene.left, scene.right) if wall is not None]
    plain = scene.force is None and not scene.drive
    return plain and bool(walls) and not any(wall.soft for wall in walls) and scene.dtype == np.float64


def _flat(scene, state):
    """(scene, state, shape): numbers that are scalars or of all lanes in one axis, and the shape of the lanes."""
    shape = jnp.broadcast_shapes(*map(jnp.shape, jax.tree.leaves((scene, state))))
    state = replace(state, x=jnp.broadcast_to(state.x, shape))

    def flat(leaf):
        return jnp.broadcast_to(leaf, shape).reshape(-1) if jnp.ndim(leaf) else leaf

    return *jax.tree.map(flat, (scene, state)), shape


def _in_blocks(scene, state, start, asked, least):
    def run(given):
        return one_kernel(_strip, *given, asked=asked, least=least)

    return in_blocks(run, (scene, state, start), partial(_empty, scene.dtype, asked), least, strip=STRIP)


def _empty(dtype, asked, count):
    none = jnp.zeros(count, dtype)
    out = one_period.blank(count, asked.slots, dtype, asked.clearance)
    return out, (Tangent(none, none),) * len(asked.chosen), jnp.zeros(count, bool)


def _strip(scene, state, start, asked, least):
    """`_lean`, a block after the other."""
    empty = partial(_empty, scene.dtype, asked)
    return in_blocks(lambda given: _lean(*given, asked), (scene, state, start), empty, least)


def _lean(scene, state, start, asked):
    """((State, Impacts), tangents by the chosen numbers, whether a lane was given up) of a period by lean steps."""
    built = frame(scene)
    numbers = lean_numbers.numbers(built)
    path, fault = enter(built, state)
    lanes = lean.begin(numbers, path, fault == Status.OK)
    shifts = tuple(_shift(numbers, scene, state, place) for place in asked.chosen)
    start = tuple(Tangent(x, v * numbers.reach) for x, v in start)
    empty = impact_log.empty(state.x, asked.slots, built.period)
    lanes, log, rows, ways, clear = lean.run(numbers, lanes, *empty, shifts, start, asked.clearance)
    times, sides, speeds = impact_log.rows(rows)
    good = fault == Status.OK
    full = choose(log.count > asked.slots, lax.full_like(fault, Status.FULL), Status.OK)
    x, v = choose(good, lanes.x, jnp.nan), choose(good, lanes.v * numbers.pace, jnp.nan)
    impacts = Impacts(
        time=times,
        side=sides,
        speed=speeds,
        count=log.count.astype(jnp.int32),
        least_speed=log.least_speed,
        least_clearance=clear,
        status=choose(good, full, fault).astype(jnp.int32),
    )
    end = State(x, v, jnp.broadcast_to(state.phase, x.shape), jnp.zeros_like(x))
    ways = tuple(Tangent(choose(good, x, jnp.nan), choose(good, v * numbers.pace, jnp.nan)) for x, v in ways)
    return (end, impacts), ways, lanes.left == lean_numbers.GIVEN_UP


def _shift(numbers, scene, state, place):
    """The `lean_tangent.Shift` where one number of scene and state moves."""
    leaves, tree = jax.tree.flatten((scene, state))
    rates = [jnp.ones_like(leaf) if k == place else None for k, leaf in enumerate(leaves)]
    rates, start = tree.unflatten(rates)
    return lean_tangent.shift(numbers, scene, rates, start.phase)


def _tried(scene, state, start, asked, least):
    """((State, Impacts), `Past`, tangents) of one period, of flat numbers: by lean steps, else by full ones."""
    out, tangents, given_up = _in_blocks(scene, state, start, asked, least)
    again = partial(_full, (scene, state, start), asked, given_up)
    past = one_period.unreleased(out[1], asked.late)
    return lax.cond(jnp.any(given_up), again, lambda same: same, (out, past, tangents))


def _full(given, asked, due, out):
    """The results with those of some lanes replaced, a block at a time."""
    run = partial(_through, asked=asked)
    if not due.shape:
        return run(*given)
    count, width = len(due), min(narrow_width(), len(due))
    places = jnp.append(jnp.nonzero(due, size=count, fill_value=count)[0], jnp.full(width, count))

    def block(k, out):
        some = lax.dynamic_slice_in_dim(places, k * width, width)
        lanes = jax.tree.map(lambda leaf: leaf.at[some].get(mode="clip") if jnp.ndim(leaf) else leaf, given)
        return jax.tree.map(lambda all, new: all.at[some].set(new, mode="drop"), out, run(*lanes))

    return lax.fori_loop(0, -(-jnp.sum(due) // width), block, out)


def _through(scene, state, start, asked):
    """As `_tried`, by full steps; derivatives by a replay."""
    chosen = asked.chosen
    told = {"slots": asked.slots, "clearance": asked.clearance, "late": one_period.SLOTS if chosen else asked.late}
    (end, impacts), past = one_kernel(one_period.through, scene, state, periods=1, **told)
    if not chosen:
        return (end, impacts), past, ()
    leaves, tree = jax.tree.flatten((scene, state))
    known = slots_first(known_impacts(end, impacts, past).of_state)
    own = _own(tree)
    moving = tuple(sorted({*chosen, *own}))
    ((x, v),) = one_kernel(replayed_slopes, leaves, known, tree=tree, chosen=moving, periods=1, order=1, of_state=True)
    by = {place: (x[..., k], v[..., k]) for k, place in enumerate(moving)}
    forgets = (past.freed >= 0) | (abs(end.contact) == Contact.STUCK)

    def later(place, tangent):
        way = [sum(by[k][row] * rate for k, rate in zip(own, tangent, strict=True)) for row in (0, 1)]
        way = [choose(forgets, 0.0, each) for each in way]  # whatever the start was, nan too
        return Tangent(*way) if place in own else Tangent(*(a + b for a, b in zip(way, by[place], strict=True)))

    tangents = tuple(later(*each) for each in zip(chosen, start, strict=True))
    return (end, impacts), Past(past.freed), tangents


def _again(scene, asked, least, k, past):
    """The results with those of one period more, the k-th from 0."""
    slots = asked.slots
    (state, seen), before, tangents = past
    (end, new), after, tangents = _tried(scene, state, tangents, asked, least)
    begun = k * frame(scene).period
    lost = seen.status >= Status.CAP
    status = jnp.where(lost, seen.status, jnp.maximum(seen.status, new.status))
    put = partial(_put, seen.count)
    impacts = Impacts(
        time=put(seen.time, _later(new.time, begun)),
        side=put(seen.side, new.side),
        speed=put(seen.speed, new.speed),
        count=seen.count + new.count,
        least_speed=jnp.minimum(seen.least_speed, new.least_speed),
        least_clearance=jnp.minimum(seen.least_clearance, new.least_clearance) if asked.clearance else None,
        status=jnp.where((status == Status.OK) & (seen.count + new.count > slots), Status.FULL, status),
    )
    return (end, impacts), _joined(seen.count, before, after, begun), tangents


def _put(count, old, rows):
    """Rows with others after the first so many; slots last."""
    place = jnp.arange(old.shape[-1]) - count.astype(int)[..., None]
    return jnp.where(place >= 0, jnp.take_along_axis(rows, jnp.maximum(place, 0), -1), old)


def _later(rows, begun):
    return rows + jnp.asarray(begun)[..., None]


def _joined(count, before, after, begun):
    """The `Past` of a path and a period after it; count: the path's impacts."""
    anew = after.freed >= 0
    freed = jnp.where(anew, after.freed + begun, before.freed)
    if after.count is None:
        return Past(freed)

    def since(old, rows):
        return jnp.where(anew[..., None], rows, _put(before.count, old, rows))

    earlier = jnp.where(after.before >= 0, _later(after.before, begun), before.freed[..., None])
    return Past(
        freed,
        jnp.where(anew, after.count, before.count + after.count),
        since(before.times, _later(after.times, begun)),
        since(before.sides, after.sides),
        _put(count, before.before, earlier),
    )
