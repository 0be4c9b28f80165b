"""A stay within a soft wall, as the equations of the impacts ask for it: time and again for few lanes.

Its end is the same as `contact_duration` says, by `soft_polynomial`: arrays that the kernels of a replay, whose results
are stages on many lanes, do not take, and which make fewer operations. How it changes with its start is known from the
free flow's matrix alone: the velocity of a motion moves as the motion does, but under the force's rate of change, so
that what a later entry does is the velocity at the end less the free flow of velocity and acceleration at the start.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Float

from continuation.arrays import Array

from ..compiled.compiler_hints import choose
from ..flight import flow, soft_contact, soft_polynomial
from ..flight.flows import flow_of
from ..flight.soft_return import first_return
from ..maps.contact_duration import QUICK, ROUNDS
from ..scene.codes import Contact

LONGEST = 8.0  # drive periods that a stay is searched for
NEAR = 2.0**-30  # of itself: the step of Newton's method from which the next leaves rounding alone


class Stay(NamedTuple):
    """time; v: the velocity against the wall at its end; cosine, sine: the drive's there. pull: the acceleration from
    the wall at its start; free: the free flow's matrix ((p00, p01), (-stiffness p01, p11)) over it; later, faster: how
    the time of its end changes with that of its start, with the velocity there."""

    time: Float[Array, "*lanes"]
    v: Float[Array, "*lanes"]
    cosine: Float[Array, "*lanes"]
    sine: Float[Array, "*lanes"]
    pull: Float[Array, "*lanes"]
    free: tuple[Float[Array, "*lanes"], Float[Array, "*lanes"], Float[Array, "*lanes"]]
    later: Float[Array, "*lanes"]
    faster: Float[Array, "*lanes"]


def leave(frame, side, cosine, sine, speed, found):
    """The `Stay` of lanes that meet a soft wall on a side with a speed; side 0: of none, any numbers.

    Smooth in all numbers, also where the speed goes through zero: the stay goes through zero with it, and from there on
    is a negative time. First and second derivatives are right. found: its time by `guess`.
    """
    touch = side * Contact.ENTERED
    here = soft_contact.feeling(frame, touch)
    rows, v, reach = soft_polynomial.table(here, touch), side * speed, lax.stop_gradient(here.reach)
    path = soft_polynomial.coefficients(here, touch, rows, lax.full_like(v, 0.0), v, cosine, sine)
    pull = 2.0 * path[2] / (reach * reach)
    short = abs(found) <= reach
    near = _short(here, rows, path, v, pull, choose(short, found, 0.0))
    v = choose(short, side + 0.0 * v, v)
    far = _long(here, touch, rows, v, pull, cosine, sine, choose(short, 0.1 * reach, found))
    time, after, p00, p01, p11, later, faster = (choose(short, *each) for each in zip(near, far, strict=True))
    turned = flow.rotated(cosine, sine, frame.frequency * time)
    return Stay(time, after, *turned, pull, (p00, p01, p11), later, faster)


def guess(frame, side, cosine, sine, speed, passed=None):
    """The time of a stay: the first return, or, with no speed into the wall, what a parabola says. No derivatives.

    nan where the mass does not leave for `LONGEST`. passed: a time at which it is within the wall, whatever it did
    before; None: 0.
    """
    frame, side, cosine, sine, speed = lax.stop_gradient((frame, side, cosine, sine, speed))
    touch, v = side * Contact.ENTERED, side * speed
    here = soft_contact.feeling(frame, touch)
    bias = soft_contact.biases(frame, touch, cosine, sine, 1)
    pull, _ = flow_of(here).accelerations(here, 0.0 * v, v, cosine, sine, bias)
    enters = touch * v > 0
    longest = LONGEST * frame.period + 0.0 * v
    touching = choose(enters, touch, 0.0)
    if passed is None:
        first = first_return(frame, touching, v, cosine, sine, longest)
    else:
        span = choose(enters, passed, 0.0)
        response = soft_contact.response(here, touch, span)
        y, pace = soft_contact.flown(here, touch, response, (0.0 * v, v), cosine, sine)
        turned = flow.rotated(cosine, sine, frame.frequency * span)
        first = span + first_return(frame, touching, pace, *turned, longest, y)
    guess = -2.0 * v / choose(pull == 0, 1.0, pull)
    guess = lax.clamp(-here.reach, guess, here.reach)
    return choose(enters, choose(first < longest, first, jnp.nan), guess)


def _short(here, rows, path, v, pull, time):
    """(time, velocity, p00, p01, p11, later, faster) of a stay no longer than a step; time: near its end.

    The root at 0 is divided out, also of what is divided by the velocity at the end: y = v p01 + rest is zero there, so
    that v is no other than -rest / p01.
    """
    reach, plain = lax.stop_gradient((here.reach, path[1:]))

    def going(carry):
        share, step, count = carry
        return (count < ROUNDS) & jnp.any(abs(step) > NEAR * abs(share))

    def nearer(carry):
        share, _, count = carry
        new = _newton(plain, share)
        return new, new - share, count + 1

    share, *_ = lax.while_loop(going, nearer, (time / reach, lax.full_like(time, jnp.inf), 0))
    share = _newton(path[1:], _newton(path[1:], share))  # two steps from the root: right to the third derivative
    places = soft_polynomial.powers(share)
    _, stay, move, *_ = rows
    p00, rise = 1.0 + soft_polynomial.value(stay, places), soft_polynomial.value(move[1:], places)
    rest = soft_polynomial.value((path - v * move)[2:], places)
    climb = soft_polynomial.value(soft_polynomial.slope(path[1:]), places) / reach
    later, faster = (rise * pull - p00 * rest / rise) / climb, -rise / climb
    p01 = share * rise
    return share * reach, share * climb, p00, p01, p00 - 2.0 * here.damping * p01, later, faster


def _newton(path, share):
    """Nearer to a root of the polynomial with these coefficients."""
    powers = soft_polynomial.powers(share)
    value, slope = (soft_polynomial.value(each, powers) for each in (path, soft_polynomial.slope(path)))
    return share - value / slope


def _long(here, touch, rows, v, pull, cosine, sine, time):
    """As `_short`, of a longer stay, at a time that is right but for rounding: what is left changes all by the first
    terms of its series, two, so that second derivatives are right.

    Where p01 is small it follows from y = 0 at the end, as in `contact_duration.from_wall_to_wall`.
    """
    response = soft_polynomial.response(here, touch, rows, time)
    (p00, p01, p11), none = response.free, lax.full_like(v, 0.0)
    forced, pace = soft_contact.flown(here, touch, response, (none, none), cosine, sine)
    y, speed = forced + p01 * v, pace + p11 * v
    turned = flow.rotated(cosine, sine, here.frequency * time)
    bend, jerk = flow_of(here).accelerations(here, y, speed, *turned, soft_contact.biases(here, touch, *turned, 1))
    late = -(y / speed) * (1.0 + 0.5 * bend * y / (speed * speed))
    drag, half = 2.0 * here.damping, 0.5 * late * late
    fall = -here.stiffness * p01 - drag * p11  # p11', which is p01''
    after = speed + bend * late + jerk * half
    forced = forced + pace * late + (bend - v * fall) * half
    back = p01 + p11 * late + fall * half
    p00 = p00 - here.stiffness * (p01 * late + p11 * half)
    p11 = p11 + fall * late - (here.stiffness * p11 + drag * fall) * half
    p01 = choose(time < QUICK * here.reach, -forced / v, back)
    return time + late, after, p00, p01, p11, (p00 * v + p01 * pull) / after, -p01 / after
