"""Free flight under a force of the user's own: Taylor steps, as long as their last terms allow (Jorba and Zou 2005); or
those of a solver, where the force has one, see `solver_steps`."""

import math
from functools import reduce
from importlib import import_module
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Float

from ..compiled.compiler_hints import choose, least, most, stage
from . import event, flow, traced_force
from .drive import rate_of, wave
from .series import Series, evaluated
from .wall import course

FEWEST = event.TERMS + 2  # terms of a step, beyond those of an event
PRESSED = event.TERMS + 4  # the same of the press on a wall
STEADY = 1e-3  # of the press, as much may be beyond an event's terms over a step
RUSH = 2.0  # times the change of the press where hops begin: faster it may not change while they last
MOST_STEPS = 100_000  # of a flight of any time: more would be a hang


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


def _solver_steps():
    """The steps of diffrax's solvers, which nothing else loads."""
    return import_module(".solver_steps", __package__)


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
    if frame.law.solver is not None:
        return _solver_steps().derivatives(frame, x, v, cosine, sine, order)
    return as_derivatives(coefficients(frame, x, v, cosine, sine, order))


def as_derivatives(terms):
    """Derivatives from Taylor coefficients."""
    return [term * float(math.factorial(k)) for k, term in enumerate(terms)]


def pressed(frame, wall, cosine, sine):
    """The `Press` on a wall."""
    if frame.law.solver is not None:
        return _solver_steps().pressed(frame, wall, cosine, sine)
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
    if frame.law.solver is not None:
        return _solver_steps().press_terms(frame, wall, cosine, sine, order)
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
    if frame.law.solver is not None:
        return _solver_steps().ahead(frame, x, v, cosine, sine)
    count = order(frame)
    terms = coefficients(frame, x, v, cosine, sine, count)
    size = scale(frame, x, v)
    reach = stage(_reach, terms[-2], terms[-1], frame.reach + 0.0 * x, size, order=count, tolerance=frame.law.tolerance)
    return Ahead(terms, reach, stage(_rest, terms, reach, size, tolerance=frame.law.tolerance))


def scale(frame, x, v):
    """What a step's error is measured by."""
    return most(most(lax.abs(x), lax.abs(v)), frame.size + float(jnp.finfo(x.dtype).tiny))  # a mass at rest has none


def _reach(before, last, longest, size, order, tolerance):
    """A step at which the error of x, estimated by the last terms, and that of v over so many steps are tolerated."""
    for k, term in ((order - 1, before), (order, last)):
        share = tolerance * size / lax.abs(term)
        of_x, of_v = lax.log(share) / float(k), lax.log(share / k) / (k - 1.0)
        longest = least(longest, lax.exp(least(of_x, of_v)))
    return longest


def _rest(terms, reach, size, tolerance):
    """A bound on the terms beyond an event's over a step, and on their slope over as many; what is left out as well."""
    total, power = 2.0 * tolerance * size, reach**event.TERMS
    for k in range(event.TERMS, len(terms)):
        total = total + (k / event.TERMS) * (lax.abs(terms[k]) * power)
        power = power * reach
    return total


def shortest(frame, found):
    """Half of the shortest of the first steps of some `flight_clearance.Flight`s, a scalar."""
    reach = ahead(frame, found.x, found.v, found.cosine, found.sine).reach
    if frame.law.solver is not None:
        reach = reach * _solver_steps().spacing(frame.law.tolerance)
    return jnp.minimum(frame.reach, 0.5 * jnp.min(reach))


def hops(frame, wall, pull, closing, cosine, sine):
    """What says whether hops on a wall end: (how fast the press on it changes at most; the damping that the force has,
    from the acceleration before an impact at so much speed), as estimated where they begin."""
    push, change, bend = as_derivatives(press_terms(frame, wall, cosine, sine, 2))
    rush = RUSH * (lax.abs(change) + frame.reach * lax.abs(bend))
    still = course(wall, frame.frequency, cosine, sine, 2)[2]
    drag = lax.abs(pull - push if still is None else pull - push - still)
    return rush, 0.5 * drag / most(lax.abs(closing), jnp.full_like(closing, jnp.finfo(closing.dtype).tiny))


def gained(frame, x, v, cosine, sine, time, terms=None):
    """(what x gains, what v gains) after a time no longer than a step; terms: the coefficients of x, where known."""
    if frame.law.solver is not None:
        return _solver_steps().gained(frame, x, v, cosine, sine, time)
    if terms is None:
        terms = coefficients(frame, x, v, cosine, sine, order(frame))
    return stage(_summed, terms, time)


def _summed(terms, time):
    x = evaluated(terms[1:], time) * time
    return x, evaluated([k * term for k, term in enumerate(terms)][2:], time) * time


def fly(frame, x, v, cosine, sine, time):
    """(x, v, cosine, sine) after any time >= 0, with derivatives, forward; nan where that takes too many steps."""
    zero = jnp.zeros(jnp.broadcast_shapes(*map(jnp.shape, (x, v, cosine, sine, time))), jnp.result_type(x))

    def going(carry):
        return jnp.any(carry[4] > 0) & (carry[5] < MOST_STEPS)

    def step(carry):
        *place, left, count = carry
        found = ahead(frame, *place)
        reach = lax.stop_gradient(found.reach)
        last = left <= reach
        length = choose(last, left, reach)
        x, v = gained(frame, *place, length, found.terms)
        angle = frame.frequency * length
        turned = flow.turn(*place[2:], flow.versine(angle), flow.sinus(angle))
        new = (place[0] + x, place[1] + v, *turned, choose(last, 0.0, left - length))
        new = jax.tree.map(lambda new, old: choose(left > 0, new, old), new, (*place, left))
        return *new, count + 1

    start = (x + zero, v + zero, cosine + zero, sine + zero, time + zero, jnp.int32(0))
    x, v, cosine, sine, left, _ = lax.while_loop(going, step, start)
    lost = left > 0
    return (*(choose(lost, jnp.nan, each) for each in (x, v)), cosine, sine)
