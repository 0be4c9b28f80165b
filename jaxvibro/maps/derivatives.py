"""The strobe with derivatives of any order, forward and reverse: simulate, then replay.

The derivatives of one order are a function of their own, a replay of the impacts that a strobe has recorded; its own
derivative is the next order's, contracted with the tangents. That is linear in them, so reverse mode transposes it and
no loop runs backwards. P and Q are used nowhere: `replay` is differentiated, forward, as often as the order says.
"""

from dataclasses import replace as replaced
from functools import cache, partial
from itertools import repeat
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.custom_derivatives import SymbolicZero

from ..compiled.blocks import batched, in_blocks
from ..compiled.compiler_hints import one_kernel
from ..flight.coefficients import frame
from ..scene.codes import Contact, Status
from ..scene.state import State
from . import two_tiers
from .one_period import SLOTS
from .replay import KnownImpacts, replay


class Request(NamedTuple):
    """What is asked for, static. tree: of (scene, state); periods, slots, clearance: as of `strobe`; of_state:
    derivatives of x and v at the end, else of the impacts' times and speeds; order; chosen: the places of the numbers
    that they are by."""

    tree: jax.tree_util.PyTreeDef
    periods: int
    slots: int
    clearance: bool = False
    of_state: bool = True
    order: int = 1
    chosen: tuple[int, ...] = ()


def strobe(scene, state, periods, slots, clearance):
    """The strobe of numbers that are traced: (State, Impacts)."""
    leaves, tree = jax.tree.flatten((scene, state))
    end, impacts = _strobe(Request(tree, periods, slots, clearance))(*leaves)
    whole = {name: getattr(impacts, name).astype(jnp.int32) for name in ("count", "status")}
    return end, replaced(impacts, side=impacts.side.astype(jnp.int8), **whole)


@cache
def _strobe(task):
    """(State, Impacts), all real, of the numbers of scene and state."""
    asked = {"periods": task.periods, "slots": task.slots, "clearance": task.clearance}
    inner = jax.jit(partial(two_tiers.strobe, **asked, least=1))
    run = jax.custom_jvp(batched(lambda *leaves: _real(inner(*task.tree.unflatten(leaves)))))

    def rule(primals, tangents):
        out, known = _recorded(task)(*primals)
        return out, _pushed(task, out, known, primals, tangents)

    run.defjvp(rule, symbolic_zeros=True)
    return run


@cache
def _recorded(task):
    """The same, and what a replay has to know, whose derivatives are not asked for."""
    slots = max(task.slots, SLOTS * task.periods)
    asked = {"periods": task.periods, "slots": slots, "clearance": task.clearance}
    inner = jax.jit(partial(two_tiers.recorded, **asked, least=1))

    def found(*leaves):
        (end, impacts), freed = _real(inner(*task.tree.unflatten(leaves)))
        rests = jnp.where(abs(end.contact) >= Contact.STUCK, end.contact, 0.0)
        lost = (impacts.status >= Status.CAP) | ((impacts.count > slots) & (abs(rests) != Contact.STUCK))
        count = jnp.where(lost, -1.0, impacts.count)
        known = KnownImpacts(impacts.time, impacts.side, count, freed, rests, _slowest(impacts))
        full = (impacts.status == Status.OK) & (impacts.count > task.slots)
        rows = {name: getattr(impacts, name)[..., : task.slots] for name in ("time", "side", "speed")}
        return (end, replaced(impacts, status=jnp.where(full, 1.0 * Status.FULL, impacts.status), **rows)), known

    run = jax.custom_jvp(batched(found))

    def rule(primals, tangents):
        out, known = run(*primals)
        return (out, known), (_pushed(task, out, known, primals, tangents), jax.tree.map(jnp.zeros_like, known))

    run.defjvp(rule, symbolic_zeros=True)
    return run


def _slowest(impacts):
    """The place of the slowest impact, -1 where it is not among those recorded, or has no speed."""
    speeds = jnp.where(impacts.side != 0, impacts.speed, jnp.inf)
    known = jnp.isfinite(impacts.least_speed) & (jnp.min(speeds, axis=-1) == impacts.least_speed)
    return jnp.where(known, jnp.argmin(speeds, axis=-1), -1.0)


@cache
def _tensors(task):
    """Derivatives of all orders up to the task's, by the chosen numbers: of the numbers and what is `KnownImpacts`.

    An order's are two arrays with an axis for each time a number was chosen, last.
    """
    inner = jax.jit(partial(_blocks, task))
    run = jax.custom_jvp(batched(lambda *given: inner(*given), rows=2))

    def rule(primals, tangents):
        given = tangents[: task.tree.num_leaves]
        moving = _moving(given)
        if not moving:
            values = run(*primals)
            return values, jax.tree.map(jnp.zeros_like, values)
        above = task._replace(order=task.order + 1, chosen=tuple(sorted({*task.chosen, *moving})))
        found = list(enumerate(_tensors(above)(*primals)))
        values = tuple(_some(each, above, [*repeat(task.chosen, m + 1)]) for m, each in found[:-1])
        slopes = (_some(each, above, [*repeat(task.chosen, m), moving]) for m, each in found[1:])
        return values, tuple(_contracted(each, primals, given) for each in slopes)

    run.defjvp(rule, symbolic_zeros=True)
    return run


def _moving(tangents):
    """The places of the numbers that have tangents; the contact, the last, is a constant."""
    return tuple(k for k, each in enumerate(tangents[:-1]) if not isinstance(each, SymbolicZero))


def _pushed(task, out, known, primals, tangents):
    """The tangents of (State, Impacts)."""
    (end, impacts), moving = out, _moving(tangents)
    if not moving:
        return jax.tree.map(jnp.zeros_like, out)
    told = (known.count, known.freed, known.rests, known.times, known.sides)

    def slopes(of_state):
        (first,) = _tensors(task._replace(of_state=of_state, chosen=moving))(*primals, *told)
        return _contracted(first, primals, tangents)

    (x, v), (time, speed) = slopes(True), slopes(False)
    place = jnp.maximum(known.slowest, 0.0).astype(int)[..., None]
    slowest = jnp.take_along_axis(speed, place, -1)[..., 0]
    turned = 0.0 if isinstance(tangents[-2], SymbolicZero) else tangents[-2]
    end = State(x, v, jnp.zeros_like(end.phase) + turned, jnp.zeros_like(end.contact))
    return end, replaced(
        jax.tree.map(jnp.zeros_like, impacts),
        time=time[..., : task.slots],
        speed=speed[..., : task.slots],
        least_speed=jnp.where(known.slowest < 0, 0.0, slowest),
    )


def _contracted(tensors, primals, tangents):
    """Each array's last axis, one entry for each number that moves, summed with the tangents."""
    rank = max(map(jnp.ndim, primals))

    def along(tensor):
        total = 0.0
        for k, place in enumerate(_moving(tangents)):
            tangent = jnp.asarray(tangents[place])
            shape = (*[1] * (rank - tangent.ndim), *tangent.shape, *[1] * (tensor.ndim - 1 - rank))
            total = total + tensor[..., k] * tangent.reshape(shape)
        return total

    return jax.tree.map(along, tensors)


def _some(tensors, task, kept):
    """The arrays with the last axes, one for each entry of `kept`, narrowed from the task's chosen numbers to those."""

    def narrow(tensor):
        for axis, places in enumerate(reversed(kept), 1):
            if places != task.chosen:
                tensor = jnp.take(tensor, jnp.array([task.chosen.index(place) for place in places]), tensor.ndim - axis)
        return tensor

    return jax.tree.map(narrow, tensors)


def _real(out):
    """The same with every array of the state's type."""
    return jax.tree.map(lambda part: part.astype(jax.tree.leaves(out)[0].dtype), out)


def _blocks(task, *given):
    """What `_tensors` gives, computed block by block; given: the leaves, then the fields of `KnownImpacts`."""
    leaves, (count, freed, rests, times, sides) = given[: task.tree.num_leaves], given[task.tree.num_leaves :]
    choices, rows = len(task.chosen), [] if task.of_state else [times.shape[-1]]

    def blank(lanes):
        shapes = [(lanes, *rows, *[choices] * order) for order in range(1, task.order + 1)]
        return tuple((jnp.zeros(shape, times.dtype), jnp.zeros(shape, times.dtype)) for shape in shapes)

    def run(tree, times, sides):
        leaves, (count, freed, rests) = tree
        known = KnownImpacts(jnp.moveaxis(times, -1, 0), jnp.moveaxis(sides, -1, 0), count, freed, rests)
        tensors = one_kernel(_replayed, leaves, known, task=task)
        if not task.of_state:
            tensors = jax.tree.map(lambda part: jnp.moveaxis(part, 0, count.ndim), tensors)
        return jax.tree.map(lambda part: jnp.where(_wide(count < 0, part), jnp.nan, part), tensors)

    return in_blocks(run, (leaves, (count, freed, rests)), blank, 1, (times, sides))


def _wide(lanes, like):
    """Lanes with axes of length 1 after theirs, to go with an array that has more."""
    return jnp.reshape(lanes, (*lanes.shape, *[1] * (like.ndim - lanes.ndim)))


def _replayed(leaves, known, task):
    """The replay's derivatives of orders 1, 2, ... by the chosen numbers."""

    def function(*numbers):
        full = list(leaves)
        for place, number in zip(task.chosen, numbers, strict=True):
            full[place] = number
        scene, state = task.tree.unflatten(full)
        end, times, speeds = replay(frame(scene), state, known, task.periods, task.order)
        return end if task.of_state else (times, speeds)

    return _towered(function, task.order)(*(leaves[place] for place in task.chosen))[1:]


def _towered(function, order):
    """The function's values and derivatives up to an order, each lane's by its own numbers."""
    if order == 0:
        return lambda *numbers: (function(*numbers),)
    below = _towered(function, order - 1)

    def upper(*numbers):
        def along(direction):
            ways = zip(direction, numbers, strict=True)
            return jax.jvp(below, numbers, tuple(jnp.broadcast_to(each, jnp.shape(number)) for each, number in ways))

        values, rates = jax.vmap(along, out_axes=(None, -1))(jnp.eye(len(numbers), dtype=numbers[0].dtype))
        return (*values, rates[-1])

    return upper
