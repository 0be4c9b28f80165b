"""How long a mass stays within a soft wall, and how it leaves: found by the certified flight, then made smooth.

The time of a stay is found without derivatives, then corrected by Newton's steps that are differentiated.
"""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Float

from ..compiled.compiler_hints import choose, stage
from ..flight import flow, pushed_stay, soft_contact, soft_long_step, taylor
from ..flight.coefficients import Stays
from ..flight.flight_state import CAPPED, Path, SlowMotion
from ..flight.flows import flow_of
from ..flight.soft_contact import is_inside
from ..flight.step import micro
from ..flight.taylor import Now
from ..scene.codes import Contact

ROUNDS = 6  # of Newton's steps to a short stay from a parabola's guess
QUICK = 8.0  # longest steps: of a stay whose start its end has not forgotten


class StayEnd(NamedTuple):
    """The end of a stay: its time; the velocity against the wall there; the drive's cosine and sine."""

    time: Float[jax.Array, "*lanes"]
    v: Float[jax.Array, "*lanes"]
    cosine: Float[jax.Array, "*lanes"]
    sine: Float[jax.Array, "*lanes"]


def duration(frame, touch, y, v, cosine, sine, longest):
    """The time until lanes within a wall leave it, at most the longest; touch: their contact. No derivatives.

    It has its own digits, however short it is beside the longest: a stiff wall forgets a start in a thousandth of it.
    """
    none = lax.full_like(y, 0.0)
    motion = SlowMotion(y, none, v, none, cosine, sine)
    to_go = choose(is_inside(touch), longest, 0.0)
    path = Path(y, none, v, motion, to_go, none, touch)
    if frame.stays is Stays.PUSHED:
        after = pushed_stay.stayed(frame, path)
        left = choose(after.to_go == CAPPED, jnp.nan, after.to_go)
        return choose(is_inside(touch), (longest - left) - after.to_go_low, 0.0 * longest)

    def turn(carry):
        path, wait, left, left_low = carry
        wait = wait + 1.0
        due = jnp.any(soft_long_step.is_due(path, wait))
        path, wait = lax.cond(
            due, lambda path, wait: soft_long_step.leap(frame, path, wait), lambda *same: same, path, wait
        )
        after = micro(frame, path).path
        out = (path.to_go > 0) & ~is_inside(after.contact)
        left, left_low = choose(out, after.to_go, left), choose(out, after.to_go_low, left_low)
        to_go, low = (choose(out, 0.0, each) for each in (after.to_go, after.to_go_low))
        return after._replace(to_go=to_go, to_go_low=low), wait, left, left_low

    *_, left, low = lax.while_loop(lambda carry: jnp.any(carry[0].to_go > 0), turn, (path, none, none, none))
    return (longest - left) - low


def carried(frame, touch, time, free, enters, leaves):
    """(matrix by rows, its determinant) of a stay over which the flow is free's, p00, p01, p11: how its end changes
    with its start.

    Where the damping jumps from gamma to gamma2 and back, S = ((1, 0), (+-2 (gamma - gamma2) v / u, 1)), v the
    velocity, u that against the wall; enters, leaves: v / u there, 0 where there is no jump.
    """
    here = soft_contact.feeling(frame, touch)
    p00, p01, p11 = free
    less = 2.0 * (frame.damping - here.damping)
    first, last = less * enters, less * leaves
    shear = (first - last) * p00 - p01 * (2.0 * here.damping * first + here.stiffness + first * last)
    matrix = p00 + p01 * first, p01, shear, p11 - p01 * last
    return matrix, jnp.exp(-2.0 * here.damping * time)


def from_wall_to_wall(here, touch, time, response, whole):
    """The free flow of a `soft_contact.StayResponse`. whole: (lanes whose stay begins and ends at the wall, y', cosine,
    sine at its start): there p01 follows from y = 0 at the end, with all its digits where it is small, and the stiff
    wall multiplies it."""
    p00, p01, p11 = response.free
    lanes, v, cosine, sine = whole
    zero = lax.full_like(time, 0.0)
    lanes &= (time > here.reach) & (time < QUICK * here.reach)
    forced, _ = soft_contact.flown(here, touch, response, (zero, zero), cosine, sine)
    return p00, choose(lanes, -forced / choose(lanes, v, 1.0), p01), p11


def share(pace, relative):
    """The mass's own velocity over that against the wall: 1 where the wall stands still, whatever the speed."""
    return 1.0 + choose(pace == 0, 0.0, pace / relative)


def product(left, right):
    """The product of two matrices, each by rows."""
    (a, b, c, d), (e, f, g, h) = left, right
    return a * e + b * g, a * f + b * h, c * e + d * g, c * f + d * h


def leave(frame, side, cosine, sine, speed, found, order):
    """The `StayEnd` of lanes that meet a soft wall on a side with a speed; side 0: of none, any numbers.

    Smooth in all numbers, also where the speed goes through zero: the stay goes through zero with it, and from there on
    is a negative time. found: its time; order: of the derivatives that are right.
    """
    rounds = math.ceil(math.log2(order + 1))
    touch = side * Contact.ENTERED
    here = soft_contact.feeling(frame, touch)
    v, reach = side * speed, lax.stop_gradient(here.reach)
    short = abs(found) <= reach
    near = stage(_short, here, touch, v, cosine, sine, choose(short, found, 0.0), rounds=rounds)
    v = choose(short, side + 0.0 * v, v)
    far = stage(_long, here, touch, v, cosine, sine, choose(short, 0.1 * reach, found), order=order)
    time, after = (choose(short, *each) for each in zip(near, far, strict=True))
    return StayEnd(time, after, *flow.rotated(cosine, sine, frame.frequency * time))


def _short(here, touch, v, cosine, sine, time, rounds):
    """(time, velocity) at the end of a stay no longer than a step; time: near it. The root at 0 is divided out."""

    plain = lax.stop_gradient((here, touch, v, cosine, sine))
    time = lax.fori_loop(0, ROUNDS, lambda _, time: _newton(*plain, time), time)
    for _ in range(rounds):
        time = stage(_newton, here, touch, v, cosine, sine, time)
    return time, stage(soft_contact.gone, here, touch, v, cosine, sine, time)


def _newton(here, touch, v, cosine, sine, time):
    def height(time):
        return soft_contact.risen(here, touch, v, cosine, sine, time)

    value, slope = jax.jvp(height, (time,), (lax.full_like(time, 1.0),))
    return time - value / slope


def _long(here, touch, v, cosine, sine, time, order):
    """As `_short`, of a longer stay, by Taylor polynomials at a time that is right but for rounding."""
    y, v = soft_contact.flown(
        here, touch, soft_contact.response(here, touch, time), (lax.full_like(v, 0.0), v), cosine, sine
    )
    now = Now(y, v, *flow.rotated(cosine, sine, here.frequency * time), time)
    path = flow_of(here).jet_at(here, now, order, soft_contact.biases(here, touch, *now[2:4], order))
    late = taylor.root(path[: order + 1], order)
    return time + late, taylor.shifted(path[1:], late, order)
