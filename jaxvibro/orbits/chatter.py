"""The hops by which a mass comes to rest on a wall, and those by which it just does not.

Time tau is counted from the release, the root of the press P where the wall lets a mass go that rests on it: tau < 0
before. A hop leaves the wall at tau with a speed w; its height y >= 0 starts as w s - P s^2 / 2 + ... and ends with
a landing, after which the mass leaves with R times the speed of it. A mass is at rest where infinitely many hops end
before tau = 0. That it does so is as good as sure where the time of all hops is short beside what is left: then it is
2 w / ((1 - R) P) (1 - 2/3 w (P' + gamma P) / (P^2 (1 - R))), by which the series is ended; the next terms are beyond
rounding.

Speeds up to a critical one come to rest. Near the release, where P = -c tau, hops at this speed shrink in proportion:
with q in (1/3, 1) the root of (1 + q)(3 q - 1)^2 = 8 R q the time left by lam = (3 q - 1) / 2 a hop, the speed by
lam^2, w = 3 (1 - q^2) / 8 c tau^2, and what a speed is too much grows by mu = (1 + q)^2 / (2 q^2 (3 q - 1))
(Nordmark and Piiroinen, Phil. Trans. R. Soc. A 367, 2009). So the critical speed is a smooth function of tau and of the
scene, the stable manifold of that shrinking, and is found by halving: which speeds end in rest is decided by hops,
whose heights are counted from the wall and so keep their digits however low they are.
"""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Float

from continuation.arrays import Array

from ..flight import flow
from ..flight.flows import flow_of
from ..flight.soft_contact import bounce
from .meeting_wall import pressed, way

ORDER = 12  # of a hop's polynomial
LONGEST = 0.4  # of `Frame.reach`: a hop that is longer is none of a series'
LATE = 0.3  # of the same: so long before the release speeds are compared with the critical one
ROUNDS = 6  # of Newton's steps from a cubic's root to the landing
SMALL = 1e-4  # of what is left, or of the reach: so short are all further hops where the series is ended
MOST = 100_000  # hops
HALVES = 62  # of the bracket of the critical speed


class Hop(NamedTuple):
    """time: how long it is; landing: the speed at its end, against the wall, inf times where it does not end; press,
    change: of the wall at its start; third: y's third derivative there; terms: of its height."""

    time: Float[Array, ""]
    landing: Float[Array, ""]
    press: Float[Array, ""]
    change: Float[Array, ""]
    third: Float[Array, ""]
    terms: tuple[Float[Array, ""], ...]


class Ending(NamedTuple):
    """rest: how long the mass rests before the release, negative: it does not come to rest; first: how long the first
    hop is, `Frame.reach` where it is longer; height, pace: over the wall and away from it, at times asked for."""

    rest: Float[Array, ""]
    first: Float[Array, ""]
    height: Float[Array, " times"]
    pace: Float[Array, " times"]


def hop(frame, side, phasor, speed):
    """The `Hop` from a wall that a mass leaves with a speed, a number, or without one where it is drawn away; phasor:
    the drive's cosine and sine."""
    where, pace, *more = way(frame, side, *phasor, ORDER)
    path = flow_of(frame).jet(frame, where, pace - side * speed, *phasor, ORDER)
    rates = [side * (wall - mass) for wall, mass in zip(more, path[2:], strict=False)]
    push, change = (side * each for each in pressed(frame, side, phasor))
    terms = (speed, *(rate / math.factorial(k) for k, rate in enumerate(rates, 2)))  # of y / s
    inside = terms[1] * terms[1] - 4.0 * terms[2] * speed
    lifts = (speed == 0) & (push < 0)
    lands = jnp.where(lifts, terms[2] < 0, (inside > 0) & (terms[1] < 0))
    root = jnp.sqrt(jnp.where(lands, inside, 1.0)) - jnp.where(lands, terms[1], -1.0)
    lift = -terms[1] / jnp.where(lifts & lands, terms[2], 1.0)
    time = jnp.where(lands, jnp.where(lifts, lift, 2.0 * speed / root), 0.0)
    for _ in range(ROUNDS):
        height, slope = _horner(terms, time)
        time = time - jnp.where(lands, height / jnp.where(slope == 0, 1.0, slope), 0.0)
    _, slope = _horner(terms, time)
    good = lands & (time >= 0) & (slope <= 0) & (time <= frame.reach)
    landing = jnp.where(good, -time * slope, jnp.inf)  # y' = (y / s) + s (y / s)', and y is 0
    stays = (speed == 0) & ~lifts
    return Hop(jnp.where(stays, 0.0, time), jnp.where(stays, 0.0, landing), push, change, rates[1], terms)


def _horner(terms, time):
    """A polynomial and its slope."""
    value, slope = terms[-1], jnp.zeros_like(terms[-1])
    for term in terms[-2::-1]:
        value, slope = value * time + term, slope * time + value
    return value, slope


def ending(frame, side, release, tau, speed, since):
    """The `Ending` of hops that begin at tau with a speed, numbers. release: the drive's cosine and sine there; since:
    (times,) since tau, at which the mass is looked for."""
    again = bounce(frame, side) + 0.0 * speed
    none = 0.0 * (tau + speed)

    def going(carry):
        return (carry[-1] == 0) & (carry[3] < MOST)

    def one(carry):
        late, speed, rest, count, first, height, pace, _ = carry
        phasor = flow.rotated(*release, frame.frequency * late)
        found = hop(frame, side, phasor, speed)
        span, sure = _series(frame, again, speed, found)
        held = (found.press > 0) | ((speed == 0) & (late + found.time == late))
        ends = sure & (span <= SMALL * -late) & (late < 0) & held
        lands = (held | (speed == 0)) & jnp.isfinite(found.landing) & (late + found.time < 0)
        begun = since - (late - tau)
        on = (begun >= 0) & (begun < jnp.where(ends, 0.0, found.time)) & (lands | ends)
        y, slope = _horner(found.terms, jnp.where(on, begun, 0.0))
        height, pace = jnp.where(on, begun * y, height), jnp.where(on, y + begun * slope, pace)
        later = late + jnp.where(lands, found.time, 0.0)
        rest = jnp.where(ends, -(late + span), -jnp.maximum(later, 0.0) - found.time - (speed > 0))
        return (
            jnp.where(ends, late, later),
            jnp.where(lands, again * found.landing, speed),
            rest,
            count + 1.0,
            jnp.where(count == 0, jnp.where(ends | jnp.isfinite(found.landing), found.time, frame.reach), first),
            height,
            pace,
            (ends | ~lands).astype(jnp.int32),
        )

    blank = jnp.zeros_like(since) + none
    start = tau + none, speed + none, none, none, none, blank, blank, jnp.int32(0)
    _, _, rest, _, first, height, pace, done = lax.while_loop(going, one, start)
    return Ending(jnp.where(done == 1, rest, -1.0), first, height, pace)


def _series(frame, again, speed, found):
    """(how long all hops last from one on, whether that is right to rounding)."""
    push = jnp.where(found.press > 0, found.press, 1.0)
    drag = 0.5 * (found.third + found.change)  # damping times the press
    part = speed * (found.change + drag) / (push * push * (1.0 - again))
    span = 2.0 * speed / ((1.0 - again) * push)
    return span * (1.0 - 2.0 / 3.0 * part), (abs(part) <= SMALL) & (span <= SMALL * frame.reach)


def late(frame, side, release, tau, speed):
    """(tau, speed) of the first landing, or of the start, from which on the release is near."""
    again = bounce(frame, side)

    def going(carry):
        tau, speed = carry
        return (tau < -LATE * frame.reach) & jnp.isfinite(speed) & (speed > 0)

    def one(carry):
        tau, speed = carry
        found = hop(frame, side, flow.rotated(*release, frame.frequency * tau), speed)
        return tau + found.time, again * found.landing

    none = 0.0 * (tau + speed)
    return lax.while_loop(going, one, (tau + none, speed + none))


def critical(frame, side, release, tau):
    """The speed from which on a mass that leaves a wall at tau < 0 does not come to rest; 0 where tau is not."""
    late = tau * jnp.linspace(0.0, 1.0, 17)
    push = jax.vmap(lambda late: side * pressed(frame, side, flow.rotated(*release, frame.frequency * late))[0])(late)
    none = jnp.zeros(0, tau.dtype)

    def halve(_, carry):
        low, high = carry
        middle = 0.5 * (low + high)
        rests = ending(frame, side, release, tau, middle, none).rest > 0
        return jnp.where(rests, middle, low), jnp.where(rests, high, middle)

    most = jnp.maximum(-2.0 * tau * jnp.max(push), 0.0)
    low, high = lax.fori_loop(0, HALVES, halve, (0.0 * most, most))
    return 0.5 * (low + high)
