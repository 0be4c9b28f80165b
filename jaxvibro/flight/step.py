"""One step of a path: it flies to the next event or as far as is certain, lands, rebounds, rests or is released.

Each step is a handful of stages on lanes; a stage's results are stored, see `compiler_hints.stage`.
"""

from functools import reduce
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Float

from ..compiled.compiler_hints import choose, least, most, positive, stage
from ..scene.codes import Contact
from . import event, flow, force_flow, impact, soft_long_step
from .flight_state import Path, gone, jet, moved, place, remaining
from .press import press
from .soft_contact import biases, felt, is_inside
from .wall import chosen, course, less, picked

SLOW = 0.25  # of the speed that the acceleration makes over the longest step


class Step(NamedTuple):
    """What a step did: its time, the path before any impact and after, the side of the impact (0: none), the strike."""

    time: Float[jax.Array, "*lanes"]
    flown: Path
    path: Path
    side: Float[jax.Array, "*lanes"]
    strike: impact.Strike


def micro(frame, path):
    """One certified step of every lane that has time to go; a lane that has none stays as it is."""
    bias, whole, touch, ahead, pushes = (), frame, None, None, None
    if frame.law is not None:
        ahead = force_flow.ahead(frame, path.x, path.v, path.cosine, path.sine)
        reach = ahead.reach
        if frame.walls:
            pushes = _pushes(frame, path)
            reach = stage(_held_longer, path.contact, reach, [each.reach for each in pushes])
        frame = stage(_as_far, frame, reach)
    if not frame.walls:
        time = positive(least(frame.reach, path.to_go))
        flown = _advance(frame, path, time, ahead)
        none = lax.full_like(path.x, 0.0)
        return Step(time, flown, flown, none, impact.Strike(none, none, none))
    if frame.pushes:  # what is within a wall waits there
        waiting = path.to_go
        path = path._replace(to_go=choose(is_inside(path.contact), 0.0, waiting))
    elif frame.soft:
        frame = frame._replace(**stage(felt, frame, path.contact)._asdict())
        path = soft_long_step.plunged(frame, path)
        touch = path.contact
        bias = stage(biases, frame, touch, path.cosine, path.sine, order=event.TERMS - 2)
    if ahead is None:
        derivatives = jet(frame, path.x, path.v, path.cosine, path.sine, event.TERMS, bias)
    else:
        derivatives = stage(force_flow.as_derivatives, ahead.terms[: event.TERMS + 1])
    side = stage(_side, frame, path, *derivatives[2:4])
    rest = None if ahead is None else ahead.rest
    nearing = stage(_progress, frame, path, derivatives, side, pushes, rest)
    bound = event.bound(nearing, stage(event.cubic, nearing))
    near = stage(event.free_step, bound)
    other = lax.full_like(near, 1.0)
    if len(frame.walls) == 2:
        behind = stage(_behind, frame, path, derivatives, side, pushes, rest)
        other = stage(_other, path, behind, soft=frame.soft)
    guess = stage(event.quadratic, *bound[:3])
    step = stage(event.sure_step, bound, stage(event.horizon, bound, guess), near)
    root = stage(event.newton, nearing, stage(event.halley, nearing, guess))
    slack = stage(event.slack, nearing, guess, root)
    hit = stage(_lands, frame, path, nearing, root, slack, other, side)
    time = stage(_time, frame, path, hit, root, slack, step, other)
    if frame.pushes:
        path = path._replace(to_go=waiting)
    flown = _advance(frame, path, time, ahead, touch)
    late = stage(impact.late, frame, flown, hit)
    strike = stage(impact.strike, frame, flown, hit, late)
    after = stage(impact.part, whole, flown, hit, late, strike, time)
    return Step(time, flown, after, hit, strike)


def _as_far(frame, reach):
    """The frame with this longest step of each lane."""
    return frame._replace(reach=reach, pace=1.0 / reach, weights=event.weights(reach))


def _held_longer(contact, reach, presses):
    """The longest step of each lane: of one that rests that of the press, however fast it would move."""
    return choose(lax.abs(contact) == Contact.STUCK, reduce(least, presses), reach)


def _pushes(frame, path):
    """The `force_flow.Press` on each wall where a lane rests; else zeros."""
    return lax.cond(jnp.any(lax.abs(path.contact) == Contact.STUCK), _pressed, _unpressed, frame, path)


def _pressed(frame, path):
    return [stage(force_flow.pressed, frame, wall, path.cosine, path.sine) for wall in frame.walls]


def _unpressed(frame, path):
    none = lax.full_like(path.x, 0.0)
    return [force_flow.Press([none] * event.TERMS, none, none) for _ in frame.walls]


def _side(frame, path, pull, jerk):
    """The wall to aim at: the nearer if it holds the mass (`_holds`), else that reached first at the present speed;
    without one the nearer, and of two as near that to which the mass is pulled: a mirror image aims at the other."""
    found = []
    for wall in frame.walls:
        where, speed, bend, change = course(wall, frame.frequency, path.cosine, path.sine, 3)
        clear, closing = wall.sign * ((where - path.x) + path.x_low), wall.sign * less(path.v, speed)
        bend, change = wall.sign * less(pull, bend), less(jerk, change)
        held = _holds(frame, path.contact * wall.sign, clear, closing, bend, change)
        found.append((clear, closing, bend, held))
    if len(found) == 1:
        return lax.full_like(path.x, float(frame.walls[0].sign))
    (clear, closing, bend, held), (other_clear, other_closing, other_bend, other_held) = found
    quick, other_quick = closing * other_clear, other_closing * clear
    drawn = (other_quick > quick) | ((other_quick == quick) & (other_bend > bend))
    nearer = (other_clear < clear) | ((other_clear == clear) & drawn)
    sooner = (other_quick > quick) | ((other_quick == quick) & nearer)
    right = choose(nearer, other_held | sooner, sooner & ~held)
    if frame.soft:
        inside = is_inside(path.contact)
        right = (inside & (path.contact > 0)) | (~inside & right)
    return choose(right, lax.full_like(path.x, 1.0), -1.0)


def _holds(frame, contact, clear, closing, bend, change):
    """Whether the mass rests on a wall, hops back to it, or is so near and slow that only a short horizon helps."""
    quick = SLOW * frame.reach * (lax.abs(bend) + frame.reach * lax.abs(change))
    slow = (lax.abs(closing) < quick) & (clear < frame.reach * quick)
    hops = (contact == Contact.LANDED) & (2.0 * lax.abs(closing) < frame.reach * bend)
    return slow | hops | (contact == Contact.STUCK)


def _progress(frame, path, derivatives, side, pushes, rest=None):
    """The `event.Progress` towards the wall on a side. Under a force of the user's own pushes: what `_pushes` says;
    rest: a bound, in lengths, on what is beyond the derivatives."""
    walls, contact = frame.walls, path.contact * side
    if pushes is None:
        presses = [press(frame, wall, path.cosine, path.sine, event.TERMS - 1) for wall in walls]
    else:
        presses = [each.derivatives for each in pushes]
    push = picked(side, walls, presses)
    way = picked(side, walls, [course(wall, frame.frequency, path.cosine, path.sine, event.TERMS) for wall in walls])
    stuck, released = contact == Contact.STUCK, contact == Contact.RELEASED
    tails = frame.tails if pushes is None else [each.rest for each in pushes]
    tail, swing = chosen(side, walls, tails), chosen(side, walls, frame.swings)
    on, weights = (contact == Contact.LANDED) | released, frame.weights
    if frame.soft and not frame.pushes:  # from within, y falls to 0
        inside = (contact == Contact.WITHIN) | (contact == Contact.ENTERED)
        way = [None if where is None else choose(inside, 0.0, where + 0.0 * side) for where in way]
        on |= contact == Contact.ENTERED
        swing, side = choose(inside, 0.0, swing + 0.0 * side), choose(inside, -side, side)
        weights = event.weights(frame.reach)
    clear = [less(place, where) for place, where in zip(derivatives, way, strict=True)]
    clear[0] = clear[0] + path.x_low
    terms = [
        choose(stuck, -pushed, free) * (side * weight)
        for pushed, free, weight in zip(push, clear, weights, strict=False)
    ]
    terms[1:3] = (choose(released, 0.0, term) for term in terms[1:3])
    if rest is None:
        sixth, seventh = flow.pulled(frame.root, lax.abs(derivatives[6])), lax.abs(derivatives[7])
        bound = frame.reach * (frame.curb + frame.slope * (sixth + seventh)) + seventh
        remainder = (choose(stuck, tail, bound) + swing) * weights[event.TERMS]
    else:
        remainder = choose(stuck, tail, rest) + swing * weights[event.TERMS]
    return event.progress(terms, remainder, on)


def _behind(frame, path, derivatives, side, pushes, rest):
    """The `event.Bound` towards the wall that is not aimed at."""
    progress = _progress(frame, path, derivatives, -side, pushes, rest)
    return event.bound(progress, event.cubic(progress))


def _other(path, bound, soft):
    """A step that is certain not to meet the wall that is not aimed at."""
    held = lax.abs(path.contact) == Contact.STUCK
    if soft:
        held |= is_inside(path.contact)
    return choose(held, 1.0, event.free_step(bound))


def _lands(frame, path, progress, root, slack, other, side):
    """The side of the wall that is met at the root, 0 where the root is not near enough or not the next event."""
    g = progress.terms
    to_go = path.to_go * frame.pace
    tiny = 4.0 * event.rounding(to_go.dtype) * frame.period * frame.pace
    close = slack * (lax.abs(g[2]) + g[1]) < event.landing(to_go.dtype) * g[1]
    inside = (root + slack <= to_go) | ((slack <= tiny) & (root <= to_go + tiny))
    hits = (slack >= 0) & close & inside & (root <= other) & (to_go > 0)
    return choose(hits, side, 0.0)


def _time(frame, path, hit, root, slack, step, other):
    """How long the step is."""
    short = least(most(step, choose(slack >= 0, root - slack, 0.0)), other)
    return positive(least(choose(hit != 0, root, short) * frame.reach, path.to_go))


def _advance(frame, path, time, ahead=None, touch=None):
    """The path a free flight later."""
    motion = moved(frame, path.motion, time, touch) if ahead is None else gone(frame, path.motion, time, ahead.terms)
    return Path(*stage(place, frame, motion), motion, *stage(remaining, path, time), path.contact)
