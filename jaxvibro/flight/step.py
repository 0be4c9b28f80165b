"""One step of a path: it flies to the next event or as far as is certain, lands, rebounds, rests or is released.

Each step is a handful of stages on lanes; a stage's results are stored, see `compiler_hints.stage`.
"""

from typing import NamedTuple

import jax
from jax import lax
from jaxtyping import Float

from ..compiled.compiler_hints import choose, least, most, positive, stage
from ..scene.codes import Contact
from . import event, impact
from .flight_state import Path, place, remaining
from .flows import flow_of
from .stays import stays_of
from .wall import chosen, course, course_on, less, picked
from .within_wall import within

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
    flow, stays, whole = flow_of(frame), stays_of(frame), frame
    frame, look = flow.look(frame, path)
    if not frame.walls:
        time = positive(least(frame.reach, path.to_go))
        flown = _advance(frame, path, time, None, look)
        none = lax.full_like(path.x, 0.0)
        return Step(time, flown, flown, none, impact.Strike(none, none, none))
    frame, path, touch, bias = stays.begin(frame, path)
    waiting, path = path, stays.going(path)
    derivatives = flow.to_event(frame, path, look, bias)
    side = stage(_side, frame, path, *derivatives[2:4])
    beyond = flow.beyond(look)
    nearing = stage(_progress, frame, path, derivatives, side, beyond)
    bound = event.bound(nearing, stage(event.cubic, nearing))
    near = stage(event.free_step, bound)
    other = lax.full_like(near, 1.0)
    if len(frame.walls) == 2:
        behind = stage(_behind, frame, path, derivatives, side, beyond)
        other = stage(_other, path, within(frame, path.contact), behind)
    guess = stage(event.quadratic, *bound[:3])
    step = stage(event.sure_step, bound, stage(event.horizon, bound, guess), near)
    root = stage(event.newton, nearing, stage(event.halley, nearing, guess))
    slack = stage(event.slack, nearing, guess, root)
    hit = stage(_lands, frame, path, nearing, root, slack, other, side)
    time = stage(_time, frame, path, hit, root, slack, step, other)
    flown = _advance(frame, waiting, time, touch, look)
    late = stage(impact.late, frame, flown, hit)
    strike = stage(impact.strike, frame, flown, hit, late)
    after = stage(impact.part, whole, flown, hit, late, strike, time)
    return Step(time, flown, after, hit, strike)


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
    inside = within(frame, path.contact)
    if inside is not None:
        right = (inside & (path.contact > 0)) | (~inside & right)
    return choose(right, lax.full_like(path.x, 1.0), -1.0)


def _holds(frame, contact, clear, closing, bend, change):
    """Whether the mass rests on a wall, hops back to it, or is so near and slow that only a short horizon helps."""
    quick = SLOW * frame.reach * (lax.abs(bend) + frame.reach * lax.abs(change))
    slow = (lax.abs(closing) < quick) & (clear < frame.reach * quick)
    hops = (contact == Contact.LANDED) & (2.0 * lax.abs(closing) < frame.reach * bend)
    return slow | hops | (contact == Contact.STUCK)


def _progress(frame, path, derivatives, side, beyond):
    """The `event.Progress` towards the wall on a side; beyond: what the flow says is beyond the derivatives."""
    flow, walls, contact = flow_of(frame), frame.walls, path.contact * side
    presses, tails = zip(*flow.presses(frame, path, beyond), strict=True)
    push = picked(side, walls, presses)
    way = course_on(frame, side, path.cosine, path.sine, event.TERMS)
    stuck, released = contact == Contact.STUCK, contact == Contact.RELEASED
    tail, swing = chosen(side, walls, tails), chosen(side, walls, frame.swings)
    on = (contact == Contact.LANDED) | released
    way, on, swing, side, weights = stays_of(frame).facing(frame, contact, side, way, on, swing)
    clear = [less(place, where) for place, where in zip(derivatives, way, strict=True)]
    clear[0] = clear[0] + path.x_low
    terms = [
        choose(stuck, -pushed, free) * (side * weight)
        for pushed, free, weight in zip(push, clear, weights, strict=False)
    ]
    terms[1:3] = (choose(released, 0.0, term) for term in terms[1:3])
    return event.progress(terms, flow.remainder(frame, derivatives, beyond, stuck, tail, swing, weights), on)


def _behind(frame, path, derivatives, side, beyond):
    """The `event.Bound` towards the wall that is not aimed at."""
    progress = _progress(frame, path, derivatives, -side, beyond)
    return event.bound(progress, event.cubic(progress))


def _other(path, inside, bound):
    """A step that is certain not to meet the wall that is not aimed at."""
    held = lax.abs(path.contact) == Contact.STUCK
    if inside is not None:
        held |= inside
    return choose(held, 1.0, event.long_step(bound))


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


def _advance(frame, path, time, touch, look):
    """The path a free flight later."""
    motion = flow_of(frame).advance(frame, path.motion, time, touch, look)
    return Path(*stage(place, frame, motion), motion, *stage(remaining, path, time), path.contact)
