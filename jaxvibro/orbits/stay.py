"""A stay within a soft wall, as the equations of the impacts ask for it: time and again for few lanes.

The same as `contact_duration` says, by `soft_polynomial`: arrays that the kernels of a replay, whose results are stages
on many lanes, do not take, and which make fewer operations.
"""

import math

import jax.numpy as jnp
from jax import lax

from ..compiled.compiler_hints import choose
from ..flight import flow, soft_contact, soft_polynomial, taylor
from ..flight.flight_state import accelerations
from ..flight.soft_return import first_return
from ..flight.taylor import Now
from ..maps.contact_duration import ROUNDS, StayEnd
from ..scene.codes import Contact

LONGEST = 8.0  # drive periods that a stay is searched for
ORDER = 3  # of the derivatives that are right: what the equations of the impacts need


def leave(frame, side, cosine, sine, speed, found):
    """The `StayEnd` of lanes that meet a soft wall on a side with a speed; side 0: of none, any numbers.

    Smooth in all numbers, also where the speed goes through zero: the stay goes through zero with it, and from there on
    is a negative time. found: its time by `guess`.
    """
    touch = side * Contact.ENTERED
    here = soft_contact.feeling(frame, touch)
    rows, v, reach = soft_polynomial.table(here, touch), side * speed, lax.stop_gradient(here.reach)
    short = abs(found) <= reach
    near = _short(here, touch, rows, v, cosine, sine, choose(short, found, 0.0))
    v = choose(short, side + 0.0 * v, v)
    far = _long(here, touch, rows, v, cosine, sine, choose(short, 0.1 * reach, found))
    time, after = (choose(short, *each) for each in zip(near, far, strict=True))
    return StayEnd(time, after, *flow.rotated(cosine, sine, frame.frequency * time))


def guess(frame, side, cosine, sine, speed):
    """The time of a stay: the first return, or, with no speed into the wall, what a parabola says. No derivatives.

    nan where the mass does not leave for `LONGEST`.
    """
    frame, side, cosine, sine, speed = lax.stop_gradient((frame, side, cosine, sine, speed))
    touch, v = side * Contact.ENTERED, side * speed
    here = soft_contact.feeling(frame, touch)
    bias = soft_contact.biases(frame, touch, cosine, sine, 1)
    pull, _ = accelerations(here, 0.0 * v, v, cosine, sine, bias)
    enters = touch * v > 0
    longest = LONGEST * frame.period + 0.0 * v
    first = first_return(frame, choose(enters, touch, 0.0), v, cosine, sine, longest)
    guess = -2.0 * v / choose(pull == 0, 1.0, pull)
    guess = lax.clamp(-here.reach, guess, here.reach)
    return choose(enters, choose(first < longest, first, jnp.nan), guess)


def _short(here, touch, rows, v, cosine, sine, time):
    """(time, velocity) at the end of a stay no longer than a step; time: near it. The root at 0 is divided out."""
    path = soft_polynomial.coefficients(here, touch, rows, lax.full_like(v, 0.0), v, cosine, sine)
    reach, plain = lax.stop_gradient((here.reach, path[1:]))
    share = lax.fori_loop(0, ROUNDS, lambda _, share: _newton(plain, share), time / reach)
    for _ in range(math.ceil(math.log2(ORDER + 1))):
        share = _newton(path[1:], share)
    speed = soft_polynomial.value(soft_polynomial.slope(path), soft_polynomial.powers(share))
    return share * reach, speed / reach


def _newton(path, share):
    """Nearer to a root of the polynomial with these coefficients."""
    powers = soft_polynomial.powers(share)
    value, slope = (soft_polynomial.value(each, powers) for each in (path, soft_polynomial.slope(path)))
    return share - value / slope


def _long(here, touch, rows, v, cosine, sine, time):
    """As `_short`, of a longer stay, by Taylor polynomials at a time that is right but for rounding."""
    response = soft_polynomial.response(here, touch, rows, time)
    y, v = soft_contact.flown(here, touch, response, (lax.full_like(v, 0.0), v), cosine, sine)
    now = Now(y, v, *flow.rotated(cosine, sine, here.frequency * time), time)
    path = taylor.jet(here, now, ORDER, soft_contact.biases(here, touch, *now[2:4], ORDER))
    late = taylor.root(path[: ORDER + 1], ORDER)
    return time + late, taylor.shifted(path[1:], late, ORDER)
