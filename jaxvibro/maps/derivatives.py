"""The strobe with derivatives of any order, forward and reverse: simulate, then replay, or carry the first along.

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
import numpy as np
from jax.custom_derivatives import SymbolicZero

from ..compiled.blocks import batched, in_blocks
from ..compiled.kernels import WIDTH, one_kernel
from ..scene import check
from ..scene.state import State
from . import two_tiers
from .one_period import SLOTS
from .replay import KnownImpacts
from .replayed_slopes import cut, known_impacts, replayed_slopes, slots_first
from .tensors import contracted, moving_places, some


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
        moving = moving_places(tangents)
        if moving and _carries(task, primals):
            out, slopes = _sloped(task._replace(chosen=moving))(*primals)
            return out, _pushed(task, out, _recorded(task)(*primals)[1], primals, tangents, slopes)
        out, known = _recorded(task)(*primals)
        return out, _pushed(task, out, known, primals, tangents)

    run.defjvp(rule, symbolic_zeros=True)
    return run


def _carries(task, leaves):
    """Whether derivatives of these numbers are carried along: not those of a few known lanes, as the replay, which the
    impacts' derivatives need, is compiled sooner than both."""
    few = not check.is_traced(*leaves) and max(map(np.size, leaves)) <= WIDTH
    return not (few or task.clearance) and two_tiers.takes(task.tree.unflatten(leaves)[0])


@cache
def _sloped(task):
    """((State, Impacts), derivatives of x and v at the end by the chosen numbers, an axis for these, last).

    By lean steps, which carry them along; its own derivatives are those of the replay.
    """
    asked = {"periods": task.periods, "slots": task.slots, "chosen": task.chosen}
    inner = jax.jit(partial(two_tiers.sloped, task.tree, **asked, least=1))
    run = jax.custom_jvp(batched(lambda *leaves: _real(inner(*leaves))))

    def rule(primals, tangents):
        moving = moving_places(tangents)

        def again(*numbers):
            leaves = list(primals)
            for place, number in zip(moving, numbers, strict=True):
                leaves[place] = number
            out, known = _recorded(task._replace(chosen=()))(*leaves)
            return out, _replayed(task, known, leaves, of_state=True)

        return jax.jvp(again, *([each[place] for place in moving] for each in (primals, tangents)))

    run.defjvp(rule, symbolic_zeros=True)
    return run


@cache
def _recorded(task):
    """The same, and what a replay has to know, whose derivatives are not asked for."""
    late = SLOTS * task.periods
    asked = {"periods": task.periods, "slots": max(task.slots, late), "clearance": task.clearance, "late": late}
    inner = jax.jit(partial(two_tiers.recorded, **asked, least=1))

    def found(*leaves):
        (end, impacts), past = _real(inner(*task.tree.unflatten(leaves)))
        return (end, cut(impacts, task.slots)), known_impacts(end, impacts, past)

    run = jax.custom_jvp(batched(found))

    def rule(primals, tangents):
        out, known = run(*primals)
        return (out, known), (_pushed(task, out, known, primals, tangents), jax.tree.map(jnp.zeros_like, known))

    run.defjvp(rule, symbolic_zeros=True)
    return run


@cache
def _tensors(task):
    """Derivatives of all orders up to the task's, by the chosen numbers: of the numbers and what is `KnownImpacts`.

    An order's are two arrays with an axis for each time a number was chosen, last.
    """
    inner = jax.jit(partial(_blocks, task))
    run = jax.custom_jvp(batched(lambda *given: inner(*given), rows=2 if task.of_state else 3))

    def rule(primals, tangents):
        given = tangents[: task.tree.num_leaves]
        moving = moving_places(given)
        if not moving:
            values = run(*primals)
            return values, jax.tree.map(jnp.zeros_like, values)
        above = task._replace(order=task.order + 1, chosen=tuple(sorted({*task.chosen, *moving})))
        found = list(enumerate(_tensors(above)(*primals)))
        values = tuple(some(each, above, [*repeat(task.chosen, m + 1)]) for m, each in found[:-1])
        slopes = (some(each, above, [*repeat(task.chosen, m), moving]) for m, each in found[1:])
        return values, tuple(contracted(each, primals, given) for each in slopes)

    run.defjvp(rule, symbolic_zeros=True)
    return run


def _pushed(task, out, known, primals, tangents, slopes=None):
    """The tangents of (State, Impacts); slopes: those of x and v by what moves, where they are known."""
    (end, impacts), moving = out, moving_places(tangents)
    if not moving:
        return jax.tree.map(jnp.zeros_like, out)
    task = task._replace(chosen=moving)
    x, v = contracted(slopes or _replayed(task, known, primals, of_state=True), primals, tangents)
    time, speed = contracted(_replayed(task, known, primals, of_state=False), primals, tangents)
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


def _replayed(task, known, leaves, of_state):
    """The first derivatives by the chosen numbers: of x and v at the end, or of the impacts' times and speeds."""
    known = known.of_state if of_state else known.of_impacts
    told = known.count, known.freed, known.rests, known.times, known.sides
    rows = () if of_state else (known.before,)
    return _tensors(task._replace(of_state=of_state))(*leaves, *told, *rows)[0]


def _real(out):
    """The same with every array of the state's type."""
    return jax.tree.map(lambda part: part.astype(jax.tree.leaves(out)[0].dtype), out)


def _blocks(task, *given):
    """What `_tensors` gives, computed block by block; given: the leaves, then the fields of `KnownImpacts`."""
    leaves, (count, freed, rests, *rest) = given[: task.tree.num_leaves], given[task.tree.num_leaves :]
    times = rest[0]
    choices, rows = len(task.chosen), [] if task.of_state else [times.shape[-1]]

    def blank(lanes):
        shapes = [(lanes, *rows, *[choices] * order) for order in range(1, task.order + 1)]
        return tuple((jnp.zeros(shape, times.dtype), jnp.zeros(shape, times.dtype)) for shape in shapes)

    def run(tree, times, sides, *before):
        leaves, told = tree
        known = slots_first(KnownImpacts(times, sides, *told, *before))
        asked = {name: getattr(task, name) for name in ("tree", "chosen", "periods", "order", "of_state")}
        return one_kernel(replayed_slopes, leaves, known, **asked)

    return in_blocks(run, (leaves, (count, freed, rests)), blank, 1, rest)
