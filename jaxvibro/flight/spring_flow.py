"""What moves the mass between walls: spring and damper, exactly. The interface is that of `force_flow`.

frame: as the lanes feel it; within a soft wall x is counted from the wall, and bias is what `soft_contact.biases` says.
"""

from dataclasses import replace

import jax.numpy as jnp
from jax import lax

from ..compiled.compiler_hints import choose, stage
from ..scene.scale import swift
from . import drive, event, flow, soft_contact, wall
from .flight_state import SlowMotion, added
from .taylor import shifted

LINEAR = True  # a flight's matrix is the same wherever it begins


def look(frame, path):
    """(frame, None): the longest step is the frame's."""
    return frame, None


def to_event(frame, path, look, bias):
    """x and its derivatives, as many as an event has terms and one."""
    return jet(frame, path.x, path.v, path.cosine, path.sine, event.TERMS, bias)


def beyond(look):
    """Nothing: the press and what is beyond the derivatives are the frame's."""


def presses(frame, path, beyond):
    """[(the press on a wall, its derivatives; a bound on one more)] for each wall."""
    found = [press(frame, each, path.cosine, path.sine, event.TERMS - 1) for each in frame.walls]
    return list(zip(found, frame.tails, strict=True))


def remainder(frame, derivatives, beyond, stuck, tail, swing, weights):
    """What is beyond the terms of an event, in lengths, of lanes that are free and that rest."""
    sixth, seventh = flow.pulled(frame.root, lax.abs(derivatives[6])), lax.abs(derivatives[7])
    bound = frame.reach * (frame.curb + frame.slope * (sixth + seventh)) + seventh
    return (choose(stuck, tail, bound) + swing) * weights[event.TERMS]


def advance(frame, motion, time, touch, look):
    """The motion a step later."""
    return moved(frame, motion, time, touch)


def moved(frame, motion, time, touch=None):
    """The `SlowMotion` a time later. touch: the lanes' contact, where they may be within a soft wall."""
    if touch is None:
        gains, more = stage(flow.gains, frame.series, frame.frequency, time), None
        if frame.terms:
            lifted = [stage(flow.lifts, term.series, time) for term in frame.terms]
            more = stage(drive.moved, frame.terms, frame.frequency, *motion[4:], gains.move, lifted)
    else:
        gains = stage(soft_contact.gains, frame, touch, time)
        waves = stage(soft_contact.waves, frame, touch, time) if soft_contact.waved(frame) else []
        more = stage(soft_contact.pushed, frame, touch, motion, gains, waves)
    slow = stage(_carry, frame, motion, gains, touch, more)
    return SlowMotion(*slow, *stage(flow.turn, *motion[4:], gains.versed, gains.sined))


def _carry(frame, motion, gains, touch, more):
    """(slow_x, slow_x_low, slow_v, slow_v_low) after a flight; more: what the drive's force is not the cause of."""
    twist = frame.damping * frame.frequency
    along = -2.0 * frame.swift * (motion.cosine + twist * (motion.cosine - motion.sine))
    across = -2.0 * frame.swift * (motion.sine + twist * (motion.sine + motion.cosine))
    if touch is not None:
        inside = soft_contact.is_inside(touch)
        along = choose(inside, frame.force * motion.cosine, along)
        across = choose(inside, frame.force * motion.sine, across)
    stay, move, lift, lag = gains[:4]
    dx = stay * motion.slow_x + (move * motion.slow_v + (along * lift - across * lag))
    forced = along * (move - frame.frequency * lag) - across * (frame.frequency * lift)
    dv = (stay - 2.0 * frame.damping * move) * motion.slow_v + (
        forced - move * flow.pulled(frame.stiffness, motion.slow_x)
    )
    if more is not None:
        dx, dv = dx + more[0], dv + more[1]
    return added(motion, dx, dv)


def accelerations(frame, x, v, cosine, sine, bias=(None, None)):
    """The acceleration of a free mass, and its rate of change; bias: see `flow.extend`."""
    bias = drive.pushed(frame.terms, frame.frequency, cosine, sine, bias)
    force = frame.force * cosine, -(frame.force * sine) * frame.frequency
    return flow.extend(frame.frequency, frame.damping, frame.stiffness, force, bias, (x, v))[1]


def jet(frame, x, v, cosine, sine, order, bias=()):
    """x and its derivatives, two at a time so that each is computed once: at least as many as the order."""
    force, found = (frame.force * cosine, -(frame.force * sine) * frame.frequency), [x, v]
    bias = [*bias, *[None] * order]
    if frame.terms:
        bias = stage(drive.pushed, frame.terms, frame.frequency, cosine, sine, bias[:order])
    while len(found) <= order:
        pair = bias[len(found) - 2 : len(found)]
        force, new = stage(flow.extend, frame.frequency, frame.damping, frame.stiffness, force, pair, found[-2:])
        found += new
    return found


def jet_at(frame, now, order, bias=()):
    """x and its derivatives, one more than the order, at a `taylor.Now`."""
    return _free(frame, now.x, now.v, _pulls(frame, now, order, bias))


def _pulls(frame, now, order, bias=()):
    """The force and its derivatives, one less than the order."""
    found = [frame.force * now.cosine, -(frame.force * now.sine) * frame.frequency]
    while len(found) < order:
        found.append(-(frame.frequency * frame.frequency) * found[-2])
    more = drive.pushed(frame.terms, frame.frequency, now.cosine, now.sine, [*bias, *[None] * order][:order])
    return [own if each is None else own + each for own, each in zip(found[:order], more, strict=False)]


def _free(frame, x, v, pulls):
    """x and its derivatives under these forces."""
    found = [x, v]
    for pull in pulls:
        found.append(pull - flow.pulled(frame.stiffness, found[-2]) - 2.0 * frame.damping * found[-1])
    return found


def back(frame, now, x, v, late, order, bias=()):
    """x and v now of a flight that is at x, v a little later."""
    force = _pulls(frame, now, order, bias)
    path = _free(frame, x, v, [shifted(force[k:], late, order - 1 - k) for k in range(order)])
    return shifted(path, -late, order), shifted(path[1:], -late, order)


def press(frame, each, cosine, sine, order):
    """How hard a mass that rests on a wall is driven along x relative to it, and its derivatives."""
    found = wall.press(each, frame.force, frame.frequency, frame.damping, cosine, sine, order)
    return drive.pushed(frame.terms, frame.frequency, cosine, sine, found)


def hops(frame, side, pull, closing, cosine, sine):
    """What says whether hops on a wall end: (how fast the press on it changes at most; the damping; None, as the spring
    draws the mass back)."""
    return wall.chosen(side, frame.walls, frame.rushes), frame.damping, None


def shortest(frame, found):
    """The longest step, however the mass flies."""
    return frame.reach


def fly(frame, x, v, cosine, sine, time):
    """(x, v, cosine, sine) after any time >= 0."""
    x, v, angle, _ = _flown(frame, x, v, cosine, sine, time)
    return x, v, *flow.turn(cosine, sine, *angle)


def matrix(frame, x, v, cosine, sine, time):
    """((x, v) a time after; how they change with x, v at the start, a matrix as `response.through` takes it)."""
    x, v, _, free = _flown(frame, x, v, cosine, sine, time)
    return (x, v), free


def passed(frame, place, cosine, sine, time):
    """(place, cosine, sine, the flow's matrix by rows) a time after; place: (), as it has no part in the matrix."""
    (p00, p01, p11), _, angle = flow.doubled(frame.series, frame.frequency, frame.damping, time)
    return (), *flow.turn(cosine, sine, *angle), (p00, p01, -p01, p11)


def _flown(frame, x, v, cosine, sine, time):
    """(x, v, the drive's turn, the free flow's matrix) a time after."""
    free, forced, angle = flow.doubled(frame.series, frame.frequency, frame.damping, time)
    x, v = flow.flown((free, forced), frame.force * cosine, frame.force * sine, x, v)
    if frame.terms:
        more = drive.responses(frame.terms, frame.frequency, frame.damping, time)
        x, v = _driven(frame, more, cosine, sine, x, v)
    return x, v, angle, free


def _driven(frame, responses, cosine, sine, x, v):
    """x and v with what the drive's further terms add to them."""
    dx, dv = drive.forced(frame.terms, responses, frame.frequency, cosine, sine)
    return x + dx, v + dv


def repeated(frame, span):
    """(x, v, cosine, sine) -> the same a time after, for the same time again and again."""
    free, forced, (versed, sined) = flow.doubled(frame.series, frame.frequency, frame.damping, span)
    more = drive.responses(frame.terms, frame.frequency, frame.damping, span)

    def onwards(x, v, cosine, sine):
        x, v = flow.flown((free, forced), frame.force * cosine, frame.force * sine, x, v)
        if frame.terms:
            x, v = _driven(frame, more, cosine, sine, x, v)
        return x, v, *flow.turn(cosine, sine, versed, sined)

    return onwards


def reversed_in_time(frame):
    """The frame of the flow with time reversed.

    The energy of x^(6) is at most exp(2 gamma t) times that without damping, for which `coefficients.frame` has its
    bounds.
    """
    growth = jnp.exp(2.0 * frame.damping * frame.reach)
    slope, forcing = frame.slope * growth, drive.largest(frame.terms, frame.force, frame.frequency, 6)
    return frame._replace(
        damping=-frame.damping,
        swift=swift(frame.frequency, -frame.damping, frame.force),
        series=flow.series(frame.frequency, -frame.damping),
        curb=forcing * (1.0 + slope * frame.reach),
        slope=slope,
        terms=tuple(_reversed(frame, term) for term in frame.terms),
    )


def _reversed(frame, term):
    series = flow.series(drive.rate_of(term, frame.frequency), -frame.damping)
    return replace(term, sine=-term.sine, series=series)
