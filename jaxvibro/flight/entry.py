"""How a given state begins its path: the rules for a start on a wall, and the starts that are refused."""

from dataclasses import replace

import jax.numpy as jnp
from jax import lax

from ..compiled.compiler_hints import choose, positive
from ..scene.codes import Contact, Status
from . import event, impact
from .coefficients import is_valid
from .flight_state import Path, SlowMotion, motion
from .soft_contact import is_inside
from .wall import course, extent, less
from .within_wall import within

WIDE = 0.4  # exponent: squares and products of two lengths below largest**WIDE stay finite


def enter(frame, state, rules=is_valid):
    """(path, fault): a path with no time to go yet, and OK, INVALID or NONFINITE; rules: what the scene must keep.

    A start on a wall that moves into it stays free, so that its first event is that impact. One that moves away has
    landed; one without speed is decided by the press, then by its change (`impact.settle`). A position or a speed whose
    square would be lost is none.
    """
    cosine, sine = jnp.cos(state.phase), jnp.sin(state.phase)
    valid, finite = rules(frame)
    for number in (state.x, state.v, cosine, state.contact):
        finite &= jnp.isfinite(number)
    kind = jnp.finfo(jnp.result_type(state.x))
    small = event.smallest(kind.dtype)
    x, v = (choose(abs(each) > small, each, 0.0) for each in (state.x, state.v))
    largest = jnp.maximum(frame.size, jnp.maximum(abs(x), abs(v)))
    finite &= (largest >= small) & (largest < float(kind.max) ** WIDE)
    state, none = replace(state, x=x, v=v), jnp.zeros_like(state.x)
    cosine, sine = cosine + none, sine + none
    start = SlowMotion(none, none, none, none, cosine, sine)
    path = Path(state.x + none, none, state.v + none, start, none, none, none)
    kind = abs(state.contact) + none
    valid &= (kind == 0) | (kind == Contact.LANDED) | (kind == Contact.STUCK) | (kind == Contact.WITHIN)
    known = kind == 0
    for wall, soft in zip(frame.walls, frame.contacts, strict=True):
        place = course(wall, frame.frequency, cosine, sine, 1)
        given = state.contact * wall.sign
        inside = is_inside(path.contact)  # of the wall before, from which the lane is counted
        here = path._replace(x=choose(inside, state.x + none, path.x), v=choose(inside, state.v + none, path.v))
        here, fits = (_at_wall if soft is None else _at_soft_wall)(frame, wall, place, here, given)
        kept = zip((path.x, path.v, path.contact), (here.x, here.v, here.contact), strict=True)
        path = path._replace(**dict(zip(("x", "v", "contact"), (choose(inside, *each) for each in kept), strict=True)))
        valid &= fits & (given != (Contact.WITHIN if soft is None else Contact.STUCK))
        known |= given > 0
    inside = within(frame, path.contact)
    if inside is not None:
        frame = frame._replace(swift=choose(inside, 0.0, frame.swift + none))
    path = path._replace(motion=motion(frame, path.x, path.v, cosine, sine))
    fault = choose(finite, choose(valid & known, lax.full_like(none, Status.OK), Status.INVALID), Status.NONFINITE)
    return path, fault


def _at_soft_wall(frame, wall, place, path, given):
    """As `_at_wall`: beyond this wall a start is within it, and is counted from it."""
    where, speed = place
    pace = jnp.zeros_like(where) if speed is None else speed
    depth, closing = wall.sign * (path.x - where), wall.sign * (path.v - pace)
    eps = 2.0 * event.rounding(depth.dtype)
    near = _near(wall, depth)
    within, landed = given == Contact.WITHIN, given == Contact.LANDED
    met = landed | (abs(depth) <= near) | (within & (depth <= 0))
    push, change = impact.surface(frame, path.x * 0.0 + wall.sign, path.cosine, path.sine)[2:]
    push, change = wall.sign * push, wall.sign * change
    pressed = (push > 0) | ((push == 0) & (change > 0))
    inside = choose(met, within & (closing > 0) | (closing == 0) & pressed, depth > 0)
    leaves = met & ~inside & (landed | (closing <= 0))
    loose = eps**0.5 * frame.size
    fits = ~(within | landed) | (choose(landed, abs(depth), -depth) <= loose)
    fits &= ~landed | (closing <= eps**0.5 * (abs(path.v) + frame.size * (1.0 + frame.frequency)))
    kind = choose(
        inside,
        choose(met, Contact.ENTERED, lax.full_like(depth, Contact.WITHIN)),
        choose(leaves, Contact.LANDED, lax.full_like(depth, 0.0)),
    )
    x = choose(inside, choose(met, 0.0, wall.sign * depth), choose(met, where, path.x))
    v = choose(inside, path.v - pace, path.v)
    here = inside | leaves
    return path._replace(x=x, v=v, contact=choose(here, wall.sign * kind, path.contact)), fits


def _at_wall(frame, wall, place, path, given):
    """The path as this wall finds it, and whether the start is allowed; given: the contact times the wall's sign."""
    where, speed = place
    gap = wall.sign * ((where - path.x) + path.x_low)
    closing = wall.sign * less(path.v, speed)
    eps = 2.0 * event.rounding(gap.dtype)
    near = _near(wall, gap)
    loose = eps**0.5
    touching = given > 0
    met = ~touching & (abs(gap) <= near)
    fits = choose(touching, abs(gap) <= loose * frame.size, gap >= -near)
    pace = abs(path.v) + frame.size * (1.0 + frame.frequency)
    off = choose(given == Contact.STUCK, abs(closing), closing)
    fits &= ~touching | (off <= loose * pace)
    push = [wall.sign * each for each in impact.surface(frame, path.x * 0.0 + wall.sign, path.cosine, path.sine)[2:]]
    leaving = choose(given == Contact.STUCK, 0.0, positive(-closing))
    kind = wall.sign * impact.settle(frame, leaving, *push)
    on = touching | (met & (closing <= 0))
    rests = on & ((abs(kind) == Contact.STUCK) | (leaving == 0))
    still = jnp.zeros_like(gap) if speed is None else speed
    return path._replace(
        x=choose(on | met, where, path.x),
        v=choose(rests, still, path.v),
        contact=choose(on, kind, path.contact),
    ), fits


def _near(wall, like):
    """How far from a wall that moves a start is on it: where such a wall is comes rounded to whoever works it out."""
    return jnp.zeros_like(like) if wall.swing is None else 8.0 * event.rounding(like.dtype) * extent(wall)
