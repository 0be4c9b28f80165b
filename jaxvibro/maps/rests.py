"""Rests: a mass that has lost all of its speed against a wall stays on it until the wall, or the drive, lets it go.

A wall with R > 0 takes the last speed by infinitely many hops, complete chatter; one with R = 0 by one impact. A rest
forgets how it was come by, so the derivative of a period with a rest in it is zero and both exponents are -inf. What
does grow or shrink is between rests: let z be the state just after the mass was let go, at a known phase, and t(z) the
time at which it next comes to rest. A mass that moves on as that one does, but earlier by dt, has another speed by g
dt, g being the press of the wall at t: g abs(dt / dz) is how much a small change of z has grown when the rest begins,
and so the largest growth of tangents there, with all hops. For hops that remain after a last one at time s with speed
u, t = s + 2 R u / ((1 - R) g), as the press hardly changes then (Budd and Dux, Phil. Trans. R. Soc. A 347, 1994,
365-389).
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import ArrayLike, Float

from continuation.persistent_jit import persistent_jit

from ..compiled.compiler_hints import OPTIONS
from ..flight import integrate
from ..flight.coefficients import frame
from ..flight.entry import enter
from ..flight.flows import flow_of
from ..flight.impact import surface
from ..flight.response import by_rows
from ..flight.soft_contact import bounce
from ..flight.step import micro
from ..scene.codes import Contact, Status
from ..scene.state import State
from .contact_duration import product
from .monodromy import saltation
from .strobe import strobe

MOST = 32  # rests of a period that are told apart


class Rests(NamedTuple):
    """The rests of some drive periods of a periodic motion.

    rests: whether there are any; count: how often the mass comes to rest; endless: letters of the walls on which it
    does so by complete chatter, "", "L", "R" or "LR"; rate: the largest growth of tangents between rests, a drive
    period of the time between them, nan where there is none. spans: of each rest the side, the time of the last impact
    before it that was flown, and when the wall lets go, since the start; the first may have begun before it.
    """

    rests: bool
    count: int  # type: ignore[assignment]  # a tuple has a method of this name
    endless: str
    rate: float
    spans: tuple[tuple[float, float, float], ...]


NO_RESTS = Rests(False, 0, "", np.nan, ())


def may_rest(scene, status, contact):
    """Whether the mass may rest on a wall: in some periods it chatters, ends one there, or a wall takes all its speed.

    status, contact: of the periods, the statuses with slots enough for all impacts.
    """
    plastic = any(float(scene.bounce(side)) == 0 for side in scene.walls)
    return bool(plastic or np.any(np.asarray(status) == Status.FULL) or np.any(np.abs(contact) == Contact.STUCK))


def rests(scene, state, periods):
    """The `Rests` of a periodic motion from a `State` of it on, numbers, over its so many periods."""
    dtype = scene.dtype
    state = State(*(np.asarray(each, dtype).reshape(()) for each in (state.x, state.v, state.phase, state.contact)))
    on, since, seen, freed = (
        abs(state.contact) == Contact.STUCK,
        SinceRelease(*np.array([1.0, 0.0, 0.0, 1.0, 0.0, np.nan], dtype)),
        [],
        [],
    )
    length = 2.0 * np.pi / float(scene.frequency)
    for k in range(2 * periods):  # the first time round tells since when the mass is free
        since, rows, ends = jax.device_get(_watched(scene, state, since))
        if k >= periods:
            late = length * (k - periods)
            seen += [(*row, late + begin) for *row, begin in zip(*rows, strict=True) if row[0]]
            freed += [late + float(end) for end in ends if end >= 0]
        state = jax.device_get(strobe(scene, state))[0]
    letters = {"L" if side < 0 else "R" for side, hops, *_ in seen if hops}
    span = float(sum(time for *_, time, _ in seen))
    rate = sum(growth for _, _, growth, *_ in seen) * 2.0 * np.pi / float(scene.frequency) / span if span else np.nan
    spans = _spans([(side, begin) for side, *_, begin in seen], freed, length * periods)
    return Rests(bool(on or seen), len(seen), "".join(sorted(letters)), float(rate), spans)


def _spans(begins, freed, whole):
    """(side, begin, end) of each rest, of which some may last on into the next time round."""
    ends = sorted([*freed, *(end + whole for end in freed)])
    found = []
    for side, begin in begins:
        end = next((end for end in ends if end > begin), np.inf)
        found.append((float(side), float(begin), float(end)))
    return tuple(found)


class SinceRelease(NamedTuple):
    """The derivative since the mass was last let go from a wall, by rows, over exp(size), and how long ago that was."""

    a: Float[ArrayLike, ""]
    b: Float[ArrayLike, ""]
    c: Float[ArrayLike, ""]
    d: Float[ArrayLike, ""]
    size: Float[ArrayLike, ""]
    age: Float[ArrayLike, ""]


@persistent_jit(compiler_options=OPTIONS)
def _watched(scene, state, since):
    """(`SinceRelease` a period later; of the rests that begin in it: side, 0 none, whether by hops, growth, time
    before, time since the period's start; the times of releases since then, -1 none)."""
    built = frame(scene)
    path, fault = enter(built, state)
    path = path._replace(to_go=jnp.where(fault == Status.OK, built.period, 0.0))
    limit, none = integrate.cap(built, 1).steps, jnp.zeros_like(path.x)

    def turn(carry):
        path, since, count, steps, rows, ended, ends = carry
        step = micro(built, path)
        was, now = abs(path.contact) == Contact.STUCK, abs(step.path.contact) == Contact.STUCK
        since, row = _advanced(built, path, step, since, was, now)
        begins, freed = now & ~was, was & ~now
        late = built.period - step.path.to_go
        place = jnp.where(begins, count, MOST)
        rows = tuple(old.at[place].set(new, mode="drop") for old, new in zip(rows, (*row, late), strict=True))
        ends = ends.at[jnp.where(freed, ended, MOST)].set(late, mode="drop")
        return step.path, since, count + begins, steps + 1.0, rows, ended + freed, ends

    rows = tuple(jnp.zeros(MOST, scene.dtype) for _ in range(5))
    zero = jnp.int32(0)
    start = path, SinceRelease(*(each + none for each in since)), zero, none, rows, zero, rows[0] - 1.0
    _, since, _, _, rows, _, ends = lax.while_loop(lambda carry: (carry[0].to_go > 0) & (carry[3] < limit), turn, start)
    return _scaled(since), rows, ends


def _advanced(frame, path, step, since, was, now):
    """(`SinceRelease` after a step, what a rest that begins there is told by: side, whether by hops, growth, time
    before)."""
    side, span = step.side, step.time
    _, free = flow_of(frame).matrix(frame, path.x, path.v, path.cosine, path.sine, span)
    matrix, age = product(by_rows(free), since[:4]), since.age + span
    row = jnp.zeros_like(age), jnp.zeros_like(age), jnp.zeros_like(age), jnp.zeros_like(age)
    if frame.walls:
        met = jnp.where(side == 0, 1.0, side)
        speed, again = abs(step.strike.speed), bounce(frame, met) + 0.0 * age
        growth, tail = _shift(frame, step, met, speed, again, matrix)
        row = side, (again > 0) + 0.0 * age, growth + since.size, age + tail
        turned, shear = saltation(frame, met, speed, step.path.cosine, step.path.sine)
        after = product((-turned, 0.0 * age, shear, -turned), matrix)
        hit = (side != 0) & ~was & ~now
        matrix = tuple(jnp.where(hit, new, old) for new, old in zip(after, matrix, strict=True))
    freed = was & ~now
    fresh = (1.0, 0.0, 0.0, 1.0, 0.0, 0.0)
    return SinceRelease(
        *(jnp.where(freed, new, old) for new, old in zip(fresh, (*matrix, since.size, age), strict=True))
    ), row


def _shift(frame, step, side, speed, again, matrix):
    """(ln of the press times how much the rest's beginning moves with the state that was let go, the time of the hops).

    The last impact that is seen comes earlier by dx / speed; the hops after it last as long as its speed says.
    """
    cosine, sine = step.path.cosine, step.path.sine
    where, pace, push, change = surface(frame, side, cosine, sine)
    push, change = side * push, side * change
    pull, _ = flow_of(frame).accelerations(frame, where, pace + side * speed, cosine, sine)
    bend = flow_of(frame).accelerations(frame, where, pace, cosine, sine)[0] - side * push  # the wall's own
    hops = 2.0 * again / ((1.0 - again) * push)
    early = -side / speed
    late = 1.0 + hops * side * (pull - bend) - hops * speed * change / push
    along, across = early * late, hops * side
    moved = jnp.hypot(along * matrix[0] + across * matrix[2], along * matrix[1] + across * matrix[3])
    return jnp.log((push + change * hops * speed) * moved), hops * speed


def _scaled(since):
    """The same with its largest entry 1."""
    largest = jnp.max(abs(jnp.stack(since[:4])))
    largest = jnp.where(largest > 0, largest, 1.0)
    return SinceRelease(*(each / largest for each in since[:4]), since.size + jnp.log(largest), since.age)
