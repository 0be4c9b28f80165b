"""What moves the mass between walls: a force of the user's own, by Taylor's steps, or by those of a solver where the
force has one. The interface is that of `spring_flow`."""

from dataclasses import replace
from functools import lru_cache, reduce
from importlib import import_module
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax

from ..compiled.compiler_hints import choose, least, most, stage
from ..scene.codes import Contact
from . import event, flow, taylor_steps
from .flight_state import SlowMotion, added, place, turned
from .taylor import shifted
from .taylor_steps import Press, as_derivatives
from .wall import course, course_on, picked

LINEAR = False  # a flight's matrix depends on where it begins
RUSH = 2.0  # times the change of the press where hops begin: faster it may not change while they last
MOST_STEPS = 100_000  # of a flight of any time: more would be a hang


class Lookahead(NamedTuple):
    """What a step knows of the flight ahead: a `taylor_steps.Ahead`; the `Press` on each wall where a lane rests on
    one, else zeros."""

    flight: taylor_steps.Ahead
    presses: list[Press]


def steps_of(frame):
    """What steps the flight: `taylor_steps`, or `solver_steps`, which nothing else loads."""
    return taylor_steps if frame.law.solver is None else import_module(".solver_steps", __package__)


def look(frame, path):
    """(frame, `Lookahead`): the frame with the longest step of each lane."""
    found = steps_of(frame).ahead(frame, path.x, path.v, path.cosine, path.sine)
    reach, presses = found.reach, []
    if frame.walls:
        presses = _presses(frame, path)
        reach = stage(_held_longer, path.contact, reach, [each.reach for each in presses])
    return stage(_as_far, frame, reach), Lookahead(found, presses)


def _as_far(frame, reach):
    return frame._replace(reach=reach, pace=1.0 / reach, weights=event.weights(reach))


def _held_longer(contact, reach, presses):
    """The longest step of each lane: of one that rests that of the press, however fast it would move."""
    return choose(lax.abs(contact) == Contact.STUCK, reduce(least, presses), reach)


def _presses(frame, path):
    return lax.cond(jnp.any(lax.abs(path.contact) == Contact.STUCK), _pressed, _unpressed, frame, path)


def _pressed(frame, path):
    steps = steps_of(frame)
    return [stage(steps.pressed, frame, wall, path.cosine, path.sine) for wall in frame.walls]


def _unpressed(frame, path):
    none = lax.full_like(path.x, 0.0)
    return [Press([none] * event.TERMS, none, none) for _ in frame.walls]


def to_event(frame, path, look, bias):
    """x and its derivatives, as many as an event has terms and one."""
    return stage(as_derivatives, look.flight.terms[: event.TERMS + 1])


def beyond(look):
    """What of a `Lookahead` says how the walls press, and what is beyond the derivatives: arrays."""
    return look.presses, look.flight.rest


def presses(frame, path, beyond):
    """[(the press on a wall, its derivatives; a bound on what is beyond them)] for each wall."""
    return [(each.derivatives, each.rest) for each in beyond[0]]


def remainder(frame, derivatives, beyond, stuck, tail, swing, weights):
    """What is beyond the terms of an event, in lengths, of lanes that are free and that rest."""
    return choose(stuck, tail, beyond[1]) + swing * weights[event.TERMS]


def advance(frame, motion, time, touch, look):
    """The motion a step later."""
    return _moved(frame, motion, time, look.flight.terms)


def moved(frame, motion, time, touch=None):
    """The `SlowMotion` a time later, no longer than a step."""
    return _moved(frame, motion, time)


def _moved(frame, motion, time, terms=None):
    """terms: the coefficients of x, where known."""
    x, _, v = stage(place, frame, motion)
    dx, dv = steps_of(frame).gained(frame, x, v, motion.cosine, motion.sine, time, terms)
    slow = stage(added, motion, dx, dv)
    return SlowMotion(*slow, *stage(turned, frame.frequency, motion.cosine, motion.sine, time))


def accelerations(frame, x, v, cosine, sine, bias=()):
    """The acceleration of a free mass, and its rate of change."""
    return tuple(jet(frame, x, v, cosine, sine, 3)[2:])


def jet(frame, x, v, cosine, sine, order, bias=()):
    """x and its derivatives up to an order."""
    return steps_of(frame).derivatives(frame, x, v, cosine, sine, order)


def jet_at(frame, now, order, bias=()):
    """x and its derivatives, one more than the order, at a `taylor.Now`."""
    return jet(frame, now.x, now.v, now.cosine, now.sine, order + 1)


def back(frame, now, x, v, late, order, bias=()):
    """x and v now of a flight that is at x, v a little later."""
    phasor = flow.rotated(now.cosine, now.sine, frame.frequency * late)
    path = jet(frame, x, v, *phasor, order + 1)
    return shifted(path, -late, order), shifted(path[1:], -late, order)


def press(frame, wall, cosine, sine, order):
    """How hard a mass that rests on the wall is driven along x relative to it, and its derivatives."""
    return as_derivatives(steps_of(frame).press_terms(frame, wall, cosine, sine, order))


def hops(frame, side, pull, closing, cosine, sine):
    """What says whether hops on a wall end: (how fast the press on it changes at most; the damping that the force has,
    from the acceleration before an impact at so much speed; how fast the force away from the wall grows with the
    distance, at least 1), as estimated where they begin."""
    found = picked(side, frame.walls, [_hops(frame, wall, pull, closing, cosine, sine) for wall in frame.walls])
    where, pace = course_on(frame, side, cosine, sine, 1)
    none = jnp.zeros_like(cosine)
    rise = steps_of(frame).stiffening(frame, where + none, none if pace is None else pace + none, cosine, sine)
    return *found, choose(rise > 1.0, rise, 1.0)


def _hops(frame, wall, pull, closing, cosine, sine):
    push, change, bend = as_derivatives(steps_of(frame).press_terms(frame, wall, cosine, sine, 2))
    rush = RUSH * (lax.abs(change) + frame.reach * lax.abs(bend))
    still = course(wall, frame.frequency, cosine, sine, 2)[2]
    drag = lax.abs(pull - push if still is None else pull - push - still)
    return rush, 0.5 * drag / most(lax.abs(closing), jnp.full_like(closing, jnp.finfo(closing.dtype).tiny))


def shortest(frame, found):
    """Half of the shortest of the first steps of some `flight_clearance.Flight`s, a scalar."""
    steps = steps_of(frame)
    reach = steps.spaced(frame, steps.ahead(frame, found.x, found.v, found.cosine, found.sine).reach)
    return jnp.minimum(frame.reach, 0.5 * jnp.min(reach))


def fly(frame, x, v, cosine, sine, time):
    """(x, v, cosine, sine) after any time >= 0, with derivatives, forward; nan where that takes too many steps."""
    zero = jnp.zeros(jnp.broadcast_shapes(*map(jnp.shape, (x, v, cosine, sine, time))), jnp.result_type(x))
    steps = steps_of(frame)

    def going(carry):
        return jnp.any(carry[4] > 0) & (carry[5] < MOST_STEPS)

    def step(carry):
        *place, left, count = carry
        found = steps.ahead(frame, *place)
        reach = lax.stop_gradient(found.reach)
        last = left <= reach
        length = choose(last, left, reach)
        x, v = steps.gained(frame, *place, length, found.terms)
        angle = frame.frequency * length
        turned = flow.turn(*place[2:], flow.versine(angle), flow.sinus(angle))
        new = (place[0] + x, place[1] + v, *turned, choose(last, 0.0, left - length))
        new = jax.tree.map(lambda new, old: choose(left > 0, new, old), new, (*place, left))
        return *new, count + 1

    start = (x + zero, v + zero, cosine + zero, sine + zero, time + zero, jnp.int32(0))
    x, v, cosine, sine, left, _ = lax.while_loop(going, step, start)
    lost = left > 0
    return (*(choose(lost, jnp.nan, each) for each in (x, v)), cosine, sine)


def matrix(frame, x, v, cosine, sine, time):
    """((x, v) a time after; how they change with x, v at the start, a matrix as `response.through` takes it)."""

    def function(x, v):
        return fly(frame, x, v, cosine, sine, time)[:2]

    def along(by_x, by_v):
        return jax.jvp(function, (x, v), (by_x + 0.0 * x, by_v + 0.0 * v))

    unit = jnp.eye(2, dtype=jnp.result_type(x))
    state, (by_x, by_v) = jax.vmap(along, out_axes=(None, 0))(unit[0], unit[1])
    return state, (by_x[0], by_x[1], by_v[1], by_v[0])


def passed(frame, place, cosine, sine, time):
    """(place, cosine, sine, the flow's matrix by rows) a time after; place: (x, v)."""
    place, (p00, p01, p11, p10) = matrix(frame, *place, cosine, sine, time)
    return place, *flow.rotated(cosine, sine, frame.frequency * time), (p00, p01, p10, p11)


def repeated(frame, span):
    """(x, v, cosine, sine) -> the same a time after, for the same time again and again."""
    return lambda *place: fly(frame, *place, span)


def reversed_in_time(frame):
    """The frame of the flow with time reversed."""
    law = replace(frame.law, function=_backwards(frame.law.function))
    return frame._replace(law=law, terms=tuple(replace(term, sine=-term.sine, series=None) for term in frame.terms))


@lru_cache(256)
def _backwards(function):
    """A force as it is seen with time reversed."""

    def force(t, x, v, numbers):
        return function(-t, x, -v, numbers)

    return force
