"""Steps of the flight under a force of the user's own by Taylor's polynomials, as long as their last terms allow (Jorba
and Zou 2005)."""

import math
from functools import reduce
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Float

from ..compiled.compiler_hints import choose, least, most, stage
from . import event, traced_force
from .drive import rate_of, wave
from .series import Series, evaluated
from .wall import course

FEWEST = event.TERMS + 2  # terms of a step, beyond those of an event
PRESSED = event.TERMS + 4  # the same of the press on a wall
GAINED = 2.0**-20  # of the speed gained in the longest step, see `scale`
STEADY = 1e-3  # of the press, as much may be beyond an event's terms over a step


class Ahead(NamedTuple):
    """The flight ahead: the coefficients of x, from the constant on; how far they are good, in t; a bound on what is
    beyond the terms of an event, in lengths."""

    terms: list[Float[jax.Array, "*lanes"]]
    reach: Float[jax.Array, "*lanes"]
    rest: Float[jax.Array, "*lanes"]


class Press(NamedTuple):
    """The press on a wall, and its derivatives, as many as an event has terms; a bound on what is beyond them over a
    step, and on its slope over as many; the longest step at which that is small."""

    derivatives: list[Float[jax.Array, "*lanes"]]
    rest: Float[jax.Array, "*lanes"]
    reach: Float[jax.Array, "*lanes"]


def order(frame):
    """The last power of a step's polynomial: the cheapest for its tolerance."""
    return max(FEWEST, math.ceil(1.0 - 0.5 * math.log(frame.law.tolerance)))


def coefficients(frame, x, v, cosine, sine, order):
    """The Taylor coefficients of x, from the constant up to an order, where the drive is at this cosine and sine."""
    time = stage(_time, frame.frequency, cosine, sine)
    drive = _driven(frame, cosine, sine, order - 1)
    return traced_force.motion(frame.law, time, x, v, drive, order)


def _driven(frame, cosine, sine, count):
    """The first coefficients of the drive's force."""
    found = traced_force.forced(frame.force, frame.frequency, cosine, sine, count)
    for term in frame.terms:
        own = traced_force.forced(term.force, rate_of(term, frame.frequency), *wave(term, cosine, sine), count)
        found = [a + b for a, b in zip(found, own, strict=True)]
    return found


def _time(frequency, cosine, sine):
    return lax.atan2(sine, cosine) / frequency


def derivatives(frame, x, v, cosine, sine, order):
    """x and its derivatives up to an order."""
    return as_derivatives(coefficients(frame, x, v, cosine, sine, order))


def stiffening(frame, x, v, cosine, sine):
    """How fast the force grows with x."""
    time = Series(None, stage(_time, frame.frequency, cosine, sine))
    found = traced_force.along(frame.law, time, Series(lambda own, k: None, x, 1.0), Series(None, v))[1]
    return jnp.zeros_like(x) if found is None else found + jnp.zeros_like(x)


def as_derivatives(terms):
    """Derivatives from Taylor coefficients."""
    return [term * float(math.factorial(k)) for k, term in enumerate(terms)]


def pressed(frame, wall, cosine, sine):
    """The `Press` on a wall."""
    return stage(_pressed, frame.reach, press_terms(frame, wall, cosine, sine, PRESSED))


def _pressed(longest, terms):
    own, last = [lax.abs(term) for term in terms[: event.TERMS]], terms[event.TERMS :]
    size, reach, rest = reduce(most, own) + float(jnp.finfo(own[0].dtype).tiny), longest + 0.0 * own[0], 0.0
    for k, term in enumerate(last, event.TERMS):
        reach = least(reach, lax.exp(lax.log(STEADY * size / lax.abs(term)) / float(k)))
    for k, term in enumerate(last, event.TERMS):
        rest = rest + (2.0 * k / event.TERMS) * (lax.abs(term) * reach**k)
    return Press(as_derivatives(terms[: event.TERMS]), rest, reach)


def press_terms(frame, wall, cosine, sine, order):
    """The Taylor coefficients of the press on a wall, see `press`, up to an order."""
    way = course(wall, frame.frequency, cosine, sine, order + 2)
    zero = jnp.zeros_like(cosine)
    where = [zero if each is None else each * (1.0 / math.factorial(k)) + zero for k, each in enumerate(way)]
    x = Series(lambda own, k: where[k], where[0])
    v = Series(lambda own, k: (k + 1.0) * where[k + 1], where[1])
    time = Series(lambda own, k: None, stage(_time, frame.frequency, cosine, sine), 1.0)
    push = traced_force.along(frame.law, time, x, v)
    drive = _driven(frame, cosine, sine, max(order + 1, 2))
    found = []
    for k in range(order + 1):
        own = drive[k] - (k + 2.0) * (k + 1.0) * where[k + 2]
        found.append(own if push[k] is None else own + push[k])
    return found


def ahead(frame, x, v, cosine, sine):
    """The `Ahead` of lanes."""
    count = order(frame)
    terms = coefficients(frame, x, v, cosine, sine, count)
    size = scale(frame, x, v, 2.0 * terms[2])
    reach = stage(_reach, terms[-2], terms[-1], frame.reach + 0.0 * x, size, order=count, tolerance=frame.law.tolerance)
    return Ahead(terms, reach, stage(_rest, terms, reach, size, tolerance=frame.law.tolerance))


def scale(frame, x, v, pull):
    """The length that a step's error is relative to; pull: the acceleration.

    A mass at rest at 0, with no length in its scene, is measured by a small part of the speed that it gains in the
    longest step.
    """
    return most(most(lax.abs(x), lax.abs(v)), most(frame.size, GAINED * frame.reach * lax.abs(pull)))


def local_size(v, pull, reach):
    """How far a motion goes in a step, to its order. A mass that comes to an equilibrium on a wall is soon nearer to it
    than the tolerance of the scene's size; its steps would become ever shorter if its own size did not count then."""
    return reach * most(lax.abs(v), reach * lax.abs(pull))


def _reach(before, last, longest, size, order, tolerance):
    """A step at which the error of x, estimated by the last terms, and that of v over so many steps are tolerated."""
    for k, term in ((order - 1, before), (order, last)):
        share = tolerance * size / lax.abs(term)
        of_x, of_v = lax.log(share) / float(k), lax.log(share / k) / (k - 1.0)
        longest = least(longest, lax.exp(least(of_x, of_v)))
    return longest


def remainder(own, error, size, tolerance):
    """Bound the error of a step's polynomial.

    The bound is twice the tolerance times the scene's size. A motion smaller than this, `own` (see `local_size`), is
    bounded by the larger of its estimated error and the tolerance times the motion.
    """
    return 2.0 * choose(own < tolerance * size, most(tolerance * own, error), tolerance * size)


def _rest(terms, reach, size, tolerance):
    """A bound on the terms beyond an event's over a step, and on their slope over as many; what is left out as well."""
    own, last = local_size(terms[1], 2.0 * terms[2], reach), len(terms) - 1
    error = most(lax.abs(terms[-2]) * reach ** (last - 1), lax.abs(terms[-1]) * reach**last)
    total, power = remainder(own, error, size, tolerance), reach**event.TERMS
    for k in range(event.TERMS, len(terms)):
        total = total + (k / event.TERMS) * (lax.abs(terms[k]) * power)
        power = power * reach
    return total


def spaced(frame, reach):
    """How far the polynomials of steps so long are right to 1e-4 of their size: no farther than they are taken."""
    return reach


def gained(frame, x, v, cosine, sine, time, terms=None):
    """(what x gains, what v gains) after a time no longer than a step; terms: the coefficients of x, where known."""
    if terms is None:
        terms = coefficients(frame, x, v, cosine, sine, order(frame))
    return stage(_summed, terms, time)


def _summed(terms, time):
    x = evaluated(terms[1:], time) * time
    return x, evaluated([k * term for k, term in enumerate(terms)][2:], time) * time
