"""The states of a sample and their derivatives of any order: where it is flown, each piece is replayed at once.

A derivative goes from piece to piece as a Taylor polynomial of x and v in the numbers that it is by: a replay that
starts with it gives that of the piece's end. The times where pieces end are constants; one more number is how much
later than its stop a sample is, by which alone it depends on its own time.
"""

from functools import cache, partial
from itertools import repeat
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Float

from ..compiled.blocks import batched, in_blocks
from ..compiled.compiler_hints import choose, two_sum
from ..compiled.kernels import one_kernel
from ..flight import flow, impact_log, integrate
from ..flight.coefficients import frame, product_error
from ..flight.entry import enter
from ..flight.flight_state import CAPPED, absolute
from ..scene.codes import Contact, Status
from ..scene.state import State
from .one_period import SLOTS, contact_at_end
from .replay import KnownImpacts, replay_for
from .replayed_slopes import towered
from .stops import Stops, walk
from .tensors import contracted, moving_places, some

MOST_PERIODS = 1e6  # up to the last time: more would be a hang
SOON = 0.5  # of the exponents: a time that is 0 is later by so little that an impact at the start has been


class Request(NamedTuple):
    """What is asked for, static. tree: of (scene, state); order: of the derivatives; chosen: the places of the numbers
    that they are by, of the leaves but the contact, then the times."""

    tree: jax.tree_util.PyTreeDef
    order: int = 0
    chosen: tuple[int, ...] = ()


class Slopes(NamedTuple):
    """What is carried along. orders: the derivatives of (x, v), order 1 first, an axis for each choice, last; later:
    the same at the last stop, by its own time as well; began: the time since the start; lost: whether there are
    none."""

    orders: tuple[tuple[Float[jax.Array, "..."], Float[jax.Array, "..."]], ...]
    later: tuple[tuple[Float[jax.Array, "..."], Float[jax.Array, "..."]], ...]
    began: Float[jax.Array, "..."]
    lost: Float[jax.Array, "..."]


@cache
def sampled(task):
    """((contact, status), ((x, v), their derivatives of order 1, ...)) of the leaves of (scene, state) and the times.

    All real; lanes first, then the times, of the status lanes alone.
    """
    inner = jax.jit(partial(in_lanes, task))
    run = jax.custom_jvp(batched(lambda *given: inner(*given), rows=1))

    def rule(primals, tangents):
        moving = moving_places(_numbers(tangents))
        if not moving:
            out = run(*primals)
            return out, jax.tree.map(jnp.zeros_like, out)
        above = task._replace(order=task.order + 1, chosen=tuple(sorted({*task.chosen, *moving})))
        told, found = sampled(above)(*primals)
        values = tuple(some(each, above, [*repeat(task.chosen, m)]) for m, each in enumerate(found[:-1]))
        slopes = (some(each, above, [*repeat(task.chosen, m), moving]) for m, each in enumerate(found[1:]))
        wide = [_widened(_numbers(each)) for each in (primals, tangents)]
        changes = tuple(contracted(each, *wide) for each in slopes)
        return (told, values), (jax.tree.map(jnp.zeros_like, told), changes)

    run.defjvp(rule, symbolic_zeros=True)
    return run


def _numbers(given):
    """What derivatives are by, then the contact."""
    return (*given[:-2], given[-1], given[-2])


def _widened(numbers):
    """Those of lanes with an axis for the times, as these have."""
    *leaves, times, contact = numbers
    wide = [each if isinstance(each, SymbolicZero) else jnp.asarray(each)[..., None] for each in leaves]
    return (*wide, times, contact)


def in_lanes(task, *given):
    """What `sampled` gives, block by block."""
    *leaves, times = given
    _, state = task.tree.unflatten(leaves)
    shape = jnp.broadcast_shapes(*map(jnp.shape, leaves), times.shape[:-1])
    leaves[task.tree.num_leaves - 4] = jnp.broadcast_to(state.x, shape)
    count, choices = times.shape[-1], len(task.chosen)

    def blank(lanes):
        shapes = [(lanes, count, *[choices] * order) for order in range(task.order + 1)]
        pairs = tuple((jnp.zeros(each, times.dtype), jnp.zeros(each, times.dtype)) for each in shapes)
        return (jnp.zeros((lanes, count), times.dtype), jnp.zeros(lanes, times.dtype)), pairs

    def run(leaves, times):
        return one_kernel(_flown, leaves, times, task=task)

    return in_blocks(run, leaves, blank, 1, [jnp.broadcast_to(times, (*shape, count))])


def _flown(leaves, times, task):
    """The same of one block."""
    scene, state = task.tree.unflatten(leaves)
    times = jnp.moveaxis(times, -1, 0)
    built = frame(scene)
    path, fault = enter(built, state)
    fault = choose(fault == Status.OK, _order(times), fault)
    far = times[-1] > MOST_PERIODS * built.period
    path = path._replace(to_go=choose(far & (fault == Status.OK), CAPPED, path.to_go))
    stops = _stops(built, state, times, (fault == Status.OK) & ~far)
    told = integrate.begin(built, path, 0, built.period + 0.0 * path.x, late=SLOTS if task.order else 0)
    slopes = _begun(task, path.x, stops.span[0] * 0.0) if task.order else ()
    note = partial(_replayed, task, leaves, fault) if task.order else _cleared
    (told, _), seen = walk(built, told, slopes, stops, integrate.cap(built, 1), note, partial(_seen, built, fault))
    status, contact, pair, later = seen
    out = [jnp.moveaxis(each, 0, state.x.ndim) for each in (contact, *pair)]
    later = jax.tree.map(lambda each: jnp.moveaxis(each, 0, state.x.ndim), later)
    return (out[0], status[-1]), (tuple(out[1:]), *later)


def _order(times):
    """INVALID where times are not finite, negative or not in order, else OK."""
    good = jnp.all(jnp.isfinite(times), 0) & (times[0] >= 0) & jnp.all(times[1:] >= times[:-1], 0)
    return choose(good, lax.full_like(times[0], Status.OK), Status.INVALID)


def _stops(frame, state, times, good):
    """The `Stops` at these times; none is flown to where that is not good."""
    before = jnp.concatenate([jnp.zeros_like(times[:1]), times[:-1]])
    span, low = (choose(good + (times < 0), each, 0.0) for each in two_sum(times, -before))
    soon = float(jnp.finfo(times.dtype).tiny) ** SOON
    span = span.at[0].set(choose(good, jnp.maximum(span[0], soon), 0.0))
    angle = frame.frequency * times
    cosine, sine = flow.rotated(jnp.cos(angle), jnp.sin(angle), product_error(frame.frequency, times, angle))
    start, across = jnp.cos(state.phase), jnp.sin(state.phase)
    return Stops(span, low, cosine * start - sine * across, sine * start + cosine * across, None)


def _seen(frame, fault, told, slopes):
    """(status, contact, (x, v), derivatives) at a stop: nan where there is none."""
    path = told.path
    x, v = absolute(frame, path)
    status = choose(path.to_go == CAPPED, lax.full_like(x, Status.CAP), Status.OK)
    finite = jnp.isfinite(x) & jnp.isfinite(v) & jnp.isfinite(path.cosine)
    status = choose(finite, status, Status.NONFINITE)
    status = choose(fault == Status.OK, status, fault)
    good = status == Status.OK
    pair = tuple(choose(good, each, jnp.nan) for each in (x, v))
    later = _where(good & (slopes.lost == 0), slopes.later, jnp.nan) if slopes else ()
    return status, choose(good, contact_at_end(path), 0.0), pair, later


def _where(good, tree, other):
    """The arrays of lanes where that is good, else another number."""
    return jax.tree.map(
        lambda each: jnp.where(good.reshape(*good.shape, *[1] * (each.ndim - good.ndim)), each, other), tree
    )


def _cleared(piece, told, more):
    """A journey whose impacts are told anew, from 0 on."""
    late = 0 if told.slots.late is None else SLOTS
    log, slots = impact_log.empty(told.path.x, 0, piece.length, late)
    return told._replace(log=log, slots=slots, freed=jnp.full_like(told.freed, -1.0), steps=told.steps * 0.0), more


def _begun(task, x, none):
    """The `Slopes` of a start."""
    own, choices = task.tree.num_leaves - 4, len(task.chosen)

    def blank(order):
        return jnp.zeros((*x.shape, *[choices] * order), x.dtype)

    rows = [jnp.array([float(place == own + k) for place in task.chosen], x.dtype) for k in (0, 1)]
    first = tuple(blank(1) + row for row in rows)
    orders = (first, *((blank(k), blank(k)) for k in range(2, task.order + 1)))
    return Slopes(orders, orders, none + 0.0 * x, none + 0.0 * x)


def _replayed(task, leaves, fault, piece, told, slopes):
    """A piece's end: its impacts are known, and made again."""
    path, (hits, speeds, count) = told.path, impact_log.late(told.log, told.slots)
    times, old = task.tree.num_leaves - 1, frame(task.tree.unflatten(leaves)[0])
    contact = contact_at_end(path)
    rests = choose(abs(contact) >= Contact.STUCK, contact, 0.0)
    gone = (path.to_go == CAPPED) | (fault != Status.OK)
    still = abs(contact) == Contact.STUCK
    lost = gone | ((count > SLOTS) & ~still)
    count = choose(lost, -1.0, choose(still, 0.0, count))
    known = KnownImpacts(hits, jnp.sign(speeds), count, told.freed, rests)
    start = absolute(old, piece.path)

    def end(*numbers):
        changes = [number - lax.stop_gradient(number) for number in numbers]
        full = [*leaves[:-1], jnp.zeros_like(slopes.began)]
        for place, number in zip(task.chosen, numbers, strict=True):
            full[place] = number
        scene, state = task.tree.unflatten([*full[:-1], leaves[-1]])
        built = frame(scene)
        rows = zip(*slopes.orders, strict=True)
        x, v = (_polynomial(value, each, changes) for value, each in zip(start, rows, strict=True))
        phase = state.phase + built.frequency * slopes.began
        begun = State(x, v, phase, contact_at_end(piece.path))
        return replay_for(built, begun, known, piece.length + full[times], task.order)

    full = [*leaves[:-1], jnp.zeros_like(slopes.began)]
    later = towered(end, task.order)(*(full[place] for place in task.chosen))[1:]
    forgets = still | (told.freed >= 0)
    lost = choose(lost, 1.0, choose(forgets, 0.0, slopes.lost))
    lasting = _where(lost == 0, jax.tree.map(partial(_kept, task.chosen, times, path.x.ndim), later), 0.0)
    return _cleared(piece, told, Slopes(lasting, later, slopes.began + piece.length, lost))


def _polynomial(value, rows, changes):
    """A value with its derivatives of order 1, ... by the changes, which are 0."""
    total = rows[-1]
    for order in range(len(rows), 0, -1):
        shape = total.ndim - 1
        ways = [
            total[..., k] * jnp.reshape(each, (*jnp.shape(each), *[1] * (shape - jnp.ndim(each))))
            for k, each in enumerate(changes)
        ]
        total = (rows[order - 2] if order > 1 else value) + sum(ways) / order
    return total


def _kept(chosen, times, lanes, tensor):
    """The derivatives with those by the sample's own time left out, which no later one depends on."""
    stays = jnp.array([float(place != times) for place in chosen], tensor.dtype)
    for axis in range(tensor.ndim - lanes):
        tensor = tensor * stays.reshape(-1, *[1] * axis)
    return tensor
