"""Straight ways from an orbit's scene to others: how far an orbit can be followed, and what ends it.

The orbit is followed by Newton's method on its impacts in steps along each way. After each it is asked whether its
equations have become singular (fold), whether its period doubles (flip), whether a flight meets a wall (touch) or an
impact has lost its speed (slow); a step that comes to none of its orbits is halved, and where it becomes too short the
orbit has ended in a fold.
"""

from enum import IntEnum
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import ArrayLike, Float

from continuation.arrays import Array
from continuation.implicit import in_turn
from continuation.linear import solve
from continuation.newton import OK, SINGULAR, Solved, newton

from ..compiled.kernels import one_kernel
from ..flight import drive, flow
from ..flight.coefficients import framed
from ..orbits import cyclic_system, flight_clearance, impact_equations
from ..orbits.impact_equations import LONGEST

STEPS = 32.0  # at least, to the end of a way
FINE = 2.0**-10  # of the way: so near is the end known
STRAY = 0.1  # of 1 + the largest unknown: the most that a step changes


class RayEnd(IntEnum):
    """What ends a way: NONE: the orbit was followed all along it."""

    NONE = 0
    FOLD = 1
    FLIP = 2
    TOUCH = 3
    SLOW = 4


class Ray(NamedTuple):
    """share: of the way, the last place where the orbit is known; unknowns: times, then speeds, there; end: a `RayEnd`
    just beyond; row, wall, time: of a touch: the flight after that impact, the wall's place among the walls, the time
    since the section's phase; of an impact without speed its row."""

    share: Float[ArrayLike, "*ways"]
    unknowns: Float[ArrayLike, "*ways unknowns"]
    end: Float[ArrayLike, "*ways"]
    row: Float[ArrayLike, "*ways"]
    wall: Float[ArrayLike, "*ways"]
    time: Float[ArrayLike, "*ways"]


class _Seen(NamedTuple):
    fold: Float[Array, ""]
    flip: Float[Array, ""]
    least: Float[Array, ""]
    end: Float[Array, ""]
    row: Float[Array, ""]
    wall: Float[Array, ""]
    time: Float[Array, ""]


@partial(jax.jit, static_argnums=0)
def rays(tree, cycle, numbers, ways):
    """The `Ray`s from an orbit, a `Cycle` without empty rows, of the scene with these numbers, (numbers,), along ways,
    (ways, numbers): what is added to them at the end. Or each from an orbit of its own: cycle and numbers have the
    ways' axis first."""
    look = in_turn(partial(_ray, tree), one_kernel)
    own = 0 if jnp.ndim(numbers) > 1 else None
    return jax.vmap(look, in_axes=(own, own, 0))(cycle, numbers, ways)


def _ray(tree, cycle, numbers, way):
    """The `Ray`; of an orbit without impacts the unknowns are x and v at the section."""
    hits = bool(len(cycle.sides))
    start = jnp.concatenate([cycle.times, cycle.speeds])
    longest = jnp.where(jnp.arange(len(start)) < len(cycle.sides), LONGEST, jnp.inf)

    def built(share):
        return framed(tree.unflatten(list(numbers + share * way)))

    def solved(frame, unknowns):
        if not hits:
            return _response(frame, cycle)

        def function(unknowns):
            return impact_equations.equations(frame, at_unknowns(cycle, unknowns))

        return newton(function, unknowns, longest * frame.period, most=8, solve=impact_equations.solve)

    def advance(carry):
        share, step, unknowns, rate, seen, _ = carry
        ahead = jnp.minimum(1.0, share + step)
        frame = built(ahead)
        found = solved(frame, unknowns + (ahead - share) * rate)
        change = jnp.max(abs(found.unknowns - unknowns))
        new = see(frame, at_unknowns(cycle, found.unknowns) if hits else cycle, found.unknowns)
        good = (found.status == OK) & (change <= STRAY * (1.0 + jnp.max(abs(unknowns))))
        end = jnp.where(
            new.fold * seen.fold < 0, RayEnd.FOLD, jnp.where(new.flip * seen.flip < 0, RayEnd.FLIP, new.end)
        )
        end = jnp.where(good, end, RayEnd.FOLD)
        on = end == RayEnd.NONE
        bent = (found.unknowns - unknowns) / jnp.where(ahead > share, ahead - share, 1.0)
        step = jnp.where(on, jnp.minimum(1.5 * step, 1.0 / STEPS), 0.5 * step)
        over = (~on & (step < FINE)) | (on & (ahead >= 1.0))
        kept = new._replace(end=seen.end, row=seen.row, wall=seen.wall, time=seen.time)
        last = seen._replace(end=end, row=new.row, wall=new.wall, time=new.time)
        seen = jax.tree.map(lambda a, b: jnp.where(on, a, b), kept, last)
        share, unknowns, rate = (
            jnp.where(on, *each) for each in ((ahead, share), (found.unknowns, unknowns), (bent, rate))
        )
        return share, step, unknowns, rate, seen, over

    zero, see = jnp.zeros((), numbers.dtype), _seen if hits else _free
    start = start if hits else _response(built(zero), cycle).unknowns
    seen = see(built(zero), cycle, start)._replace(end=zero)
    carry = (zero, zero + 1.0 / STEPS, start, 0.0 * start, seen, zero > 0)
    share, _, unknowns, _, seen, _ = lax.while_loop(lambda carry: ~carry[-1], advance, carry)
    end = jnp.where(share >= 1.0, 0.0, seen.end)
    return Ray(share, unknowns, end, seen.row, seen.wall, seen.time)


def at_unknowns(cycle, unknowns):
    """The `Cycle` with these times and speeds."""
    return cycle._replace(times=unknowns[: len(cycle.sides)], speeds=unknowns[len(cycle.sides) :])


def tests_of(frame, cycle, unknowns):
    """The determinants that vanish at a fold and at a period doubling, the least clearance, the least speed, in a row:
    of an orbit without impacts 1, 1, the clearance and infinity."""
    if len(cycle.sides):
        seen, slow = _seen(frame, cycle, unknowns), jnp.min(cycle.speeds)
    else:
        seen, slow = _free(frame, cycle, unknowns), jnp.inf
    return jnp.stack([seen.fold, seen.flip, seen.least, slow + 0.0 * seen.fold])


def free_response(frame, cycle):
    """x and v at the section of the motion that meets no wall."""
    return _response(frame, cycle).unknowns


def _seen(frame, cycle, _):
    found = impact_equations.flights(frame, cycle)
    fold, flip = cyclic_system.determinants(cyclic_system.of(impact_equations.equations(frame, cycle, found)[1]))
    begin = cycle.times if found.met.stay is None else cycle.times + found.met.stay
    least, row, wall, time = _least(frame, found, begin)
    slow = jnp.any(cycle.speeds <= 0)
    end = jnp.where(slow, RayEnd.SLOW, jnp.where(least < 0, RayEnd.TOUCH, RayEnd.NONE))
    return _Seen(
        fold, flip, least, end + 0.0 * fold, jnp.where(slow, jnp.argmin(cycle.speeds), row) + 0.0 * fold, wall, time
    )


def _least(frame, found, begin):
    """(the least distance at a turning point, inf: none; the flight's row, the wall's place, the time)."""
    clear, late = flight_clearance.clearances(frame, found, flight_clearance.samples(frame, found))
    place = jnp.argmin(clear.reshape(-1)).astype(int)
    row, wall = place // clear.shape[1], place % clear.shape[1]
    least, late = (lax.dynamic_index_in_dim(each.reshape(-1), place, keepdims=False) for each in (clear, late))
    zero = 0.0 * late
    return least, row + zero, wall + zero, late + lax.dynamic_index_in_dim(begin, row, keepdims=False)


def _response(frame, cycle):
    """`newton.Solved` of the motion that meets no wall."""
    span = cycle.periods * frame.period
    (p00, p01, p11), forced = flow.responses(frame.frequency, frame.damping, span)
    phasor = jnp.cos(cycle.phase), jnp.sin(cycle.phase)
    pushed = frame.force * (phasor[0] * jnp.stack(forced[0]) - phasor[1] * jnp.stack(forced[1]))
    if frame.terms:
        more = drive.responses(frame.terms, frame.frequency, frame.damping, span)
        pushed = pushed + jnp.stack(drive.forced(frame.terms, more, frame.frequency, *phasor))
    matrix = jnp.stack([jnp.stack([1.0 - p00, -p01]), jnp.stack([p01, 1.0 - p11])])
    found = solve(matrix, pushed)
    return Solved(found.x, 0.0 * span, 0.0 * span, found.worst, jnp.where(found.worst > 0, OK, SINGULAR))


def _free(frame, cycle, unknowns):
    found = flight_clearance.without_impacts(frame, cycle.phase, cycle.periods, *unknowns)
    least, row, wall, time = _least(frame, found, jnp.zeros(1, unknowns.dtype))
    one = jnp.ones_like(least)
    return _Seen(one, one, least, jnp.where(least < 0, RayEnd.TOUCH, RayEnd.NONE) + 0.0 * one, row, wall, time)
