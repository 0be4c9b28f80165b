"""The lanes' way through drive periods, from their start to their end and impacts."""

from dataclasses import replace
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Float

from ..compiled.blocks import in_blocks
from ..compiled.compiler_hints import choose, positive, stage
from ..compiled.kernels import one_kernel
from ..flight import impact_log, integrate
from ..flight.coefficients import frame
from ..flight.entry import enter
from ..flight.flight_state import CAPPED, absolute
from ..flight.soft_contact import is_inside
from ..scene.codes import Contact, Status
from ..scene.state import Impacts, State

SLOTS = 32  # impacts of a period whose derivatives can be told


class Past(NamedTuple):
    """freed: when the mass was last released from a wall, -1: never. What a replay has to know besides, else None:
    count, times, sides of the impacts since then, and before: freed at each of the impacts from the start on."""

    freed: Float[jax.Array, "*lanes"]
    count: Float[jax.Array, "*lanes"] | None = None  # type: ignore[assignment]  # a tuple has a method of this name
    times: Float[jax.Array, "*lanes late"] | None = None
    sides: Float[jax.Array, "*lanes late"] | None = None
    before: Float[jax.Array, "*lanes slots"] | None = None


def strobe(scene, state, periods, slots, least, clearance=False, due=None):
    """(State, Impacts) of numbers that broadcast, in blocks of so many lanes at least; due: see `in_blocks`."""
    return _in_blocks(_seen, scene, state, periods, slots, least, clearance, due)


def recorded(scene, state, periods, slots, least, clearance=False, late=0):
    """((State, Impacts), `Past`), as `strobe`."""
    return _in_blocks(through, scene, state, periods, slots, least, clearance, late=late)


def _in_blocks(function, scene, state, periods, slots, least, clearance, due=None, **more):
    shape = jnp.broadcast_shapes(*map(jnp.shape, jax.tree.leaves((scene, state))))

    def run(given):
        return one_kernel(function, *given, periods=periods, slots=slots, clearance=clearance, **more)

    def empty(count):
        out = blank(count, slots, scene.dtype, clearance)
        return out if function is _seen else (out, nothing(count, slots, scene.dtype, **more))

    return in_blocks(run, (scene, replace(state, x=jnp.broadcast_to(state.x, shape))), empty, least, due=due)


def _seen(scene, state, periods, slots, clearance):
    return through(scene, state, periods, slots, clearance)[0]


def through(scene, state, periods, slots, clearance=False, late=0):
    """((State, Impacts), `Past`): numbers are scalars or of one shape.

    state.x is of that shape. clearance: whether to measure the least one; None if not. late: slots of the `Past`.
    """
    built = frame(scene)
    path, fault = stage(enter, built, state)
    start = path.motion
    path = path._replace(to_go=choose(fault == Status.OK, built.period, 0.0))
    end = built.period if periods == 1 else built.period + lax.full_like(path.x, 0.0)
    limit = integrate.cap(built, periods)
    again = partial(_again, built, start, (periods - 0.5) * built.period) if periods > 1 else None
    told = integrate.run(built, integrate.begin(built, path, slots, end, clearance, late), limit, again)
    past = _past(told) if late else Past(told.freed)
    return finish(built, told, state, fault, clearance), past


def _past(told):
    times, speeds, count = impact_log.late(told.log, told.slots)
    times, sides, before = (jnp.moveaxis(each, 0, -1) for each in (times, jnp.sign(speeds), told.slots.freed))
    return Past(told.freed, count, times, sides, before)


def _again(frame, start, last, told):
    """A path that has ended a period begins the next, its drive turned back by what rounding left of the last one."""
    path, book = told.path, told.log
    over = (path.to_go == 0) & (book.end < last)
    low = path.to_go_low + frame.period_low
    angle = -frame.frequency * low
    cosine, sine = start.cosine - angle * start.sine, start.sine + angle * start.cosine
    turned = path.motion._replace(cosine=choose(over, cosine, path.cosine), sine=choose(over, sine, path.sine))
    to_go, low = choose(over, frame.period, path.to_go), choose(over, low, path.to_go_low)
    path = path._replace(motion=turned, to_go=to_go, to_go_low=low)
    end = choose(over, book.end + frame.period, book.end)
    return told._replace(path=path, log=book._replace(end=end))


def finish(frame, told, state, fault, clearance=False):
    """(State, Impacts) of a journey at its end, with its least clearance where that was asked for."""
    path, book, slots, calls = told[:4]
    x, v = absolute(frame, path)
    full = (book.count > len(slots.times)) | (book.least_speed < 0)
    status = choose(full, lax.full_like(book.count, Status.FULL), Status.OK)
    status = choose(path.to_go == CAPPED, Status.CAP, status)
    finite = jnp.isfinite(x) & jnp.isfinite(v) & jnp.isfinite(path.cosine)
    status = choose(finite, status, Status.NONFINITE)
    status = choose(fault == Status.OK, status, fault)
    good = status < Status.CAP
    contact = contact_at_end(path)
    phase = jnp.broadcast_to(state.phase, status.shape)
    end = State(choose(good, x, jnp.nan), choose(good, v, jnp.nan), phase, choose(good, contact, 0.0))
    times, sides, speeds = impact_log.rows(slots)
    closest = jnp.full_like(path.x, jnp.inf) if calls is None else calls.least
    return end, Impacts(
        time=times,
        side=sides,
        speed=speeds,
        count=book.count.astype(jnp.int32),
        least_speed=positive(book.least_speed),
        least_clearance=closest if clearance else None,
        status=status.astype(jnp.int32),
    )


def contact_at_end(path):
    """The contact as a `State` has it: what has entered a wall is within it, what is released has landed."""
    kind = choose(is_inside(path.contact), Contact.WITHIN, abs(jnp.sign(path.contact)))
    return jnp.sign(path.contact) * choose(abs(path.contact) == Contact.STUCK, Contact.STUCK, kind)


def nothing(count, slots, dtype, late=0):
    """The same of the `Past`."""
    none = jnp.zeros(count, dtype)
    if not late:
        return Past(none)
    times, sides = jnp.full((count, late), jnp.inf, dtype), jnp.zeros((count, late), dtype)
    return Past(none, none, times, sides, jnp.full((count, slots), -1.0, dtype))


def unreleased(impacts, late):
    """The `Past` of lanes that never rest."""
    times, none = impacts.time, jnp.zeros_like(impacts.least_speed)
    if not late:
        return Past(none - 1.0)
    count, sides = impacts.count.astype(none.dtype), impacts.side.astype(none.dtype)
    return Past(none - 1.0, count, times[..., :late], sides[..., :late], jnp.full_like(times, -1.0))


def blank(count, slots, dtype, clearance=False):
    """Results to fill in; arrays of one content would be filled once and copied, so times begin as they end, empty."""
    none = jnp.zeros(count, dtype)
    whole = jnp.zeros(count, jnp.int32)
    times, speeds = jnp.full((count, slots), jnp.inf, dtype), jnp.zeros((count, slots), dtype)
    sides = jnp.zeros((count, slots), jnp.int8)
    return State(none, none, none, none), Impacts(times, sides, speeds, whole, none, none if clearance else None, whole)
