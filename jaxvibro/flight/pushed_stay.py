"""Stays within a soft wall beside a force of the user's own: of lanes on their path, and as smooth functions."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Bool, Float

from ..compiled.compiler_hints import choose, least, stage
from ..scene.codes import Contact
from . import push_series, pushed_flow, taylor
from .flight_state import CAPPED, motion
from .no_stay import begin as begin  # a free flight's, as are these
from .no_stay import bias as bias
from .no_stay import facing as facing
from .no_stay import reach as reach
from .push_series import Within
from .soft_contact import is_inside
from .taylor_steps import as_derivatives
from .wall import course_on

SOON = 1e-9  # drive periods, after which a mass that is pressed into a wall from rest is on its way


def going(path):
    """The path of the lanes that a step is for: what is within a wall waits there."""
    return path._replace(to_go=choose(is_inside(path.contact), 0.0, path.to_go))


def unbegun(none):
    """As `spring_stay.unbegun`."""
    return none


def paused(frame, path, wait, due, idle):
    """As `no_stay.paused`: through the whole stay, once all that can wait does, or one has waited long enough."""
    path = lax.cond(due | idle, partial(stayed, frame), lambda same: same, path)
    return path, jnp.zeros_like(wait)


def stayed(frame, path):
    """The path with the lanes that are within a soft wall carried to where they leave it, or to their end."""
    inside = is_inside(path.contact) & (path.to_go > 0)
    side = stage(_side, path.contact)
    start, soon, gone = stage(_start, frame, path, inside, side)
    left = choose(inside & ~gone, path.to_go - soon, 0.0)
    found = pushed_flow.passed(frame, side, start, left, path.to_go_low)
    return stage(_after, frame, path, found, inside, gone, side)


def _side(contact):
    return choose(contact < 0, lax.full_like(contact, -1.0), 1.0)


def _start(frame, path, inside, side):
    """(`Within`, a time that is gone by then, whether the lane leaves at once); benign in lanes that are outside."""
    depth, rate = side * path.x, side * path.v
    fresh = (lax.abs(path.contact) == Contact.ENTERED) | (depth <= 0)
    pull = drawn_in(frame, side, jnp.zeros_like(rate), path.cosine, path.sine)
    still = fresh & (rate == 0)
    pressed = still & (pull > 0)
    soon = least(SOON * frame.period + 0.0 * pull, 0.5 * path.to_go)
    soon = choose(pressed & inside, soon, 0.0)
    scale = choose(fresh & ~pressed, rate, 1.0)
    root = choose(pressed, lax.sqrt(choose(pressed, 0.5 * pull, 0.0)) * soon, lax.sqrt(choose(fresh, 0.0, depth)))
    speed = choose(pressed, pull * soon, choose(fresh, 1.0, rate))
    gone = inside & fresh & ~pressed & (rate <= 0)
    some = inside & ~gone
    start = Within(*(choose(some, *each) for each in ((root, 1.0), (speed, 0.0), (scale, 1.0))), path.cosine, path.sine)
    return start, soon, gone


def drawn_in(frame, side, rate, cosine, sine):
    """The acceleration into the wall of a mass that it pushes, at the depth 0 and with this rate of it."""
    none, one = jnp.zeros_like(cosine), jnp.ones_like(cosine)
    return push_series.coefficients(frame, side, Within(none, one, rate, cosine, sine), 2).rate[2]


def _after(frame, path, found, inside, gone, side):
    """The path with the lanes that were inside where they are now."""
    now = found.now
    leaves = found.leaves | gone
    where, pace = _course(frame, side, now.cosine, now.sine)
    root = now.scale * now.root
    y, w = side * (root * root), side * choose(gone, side * path.v, now.scale * now.rate)
    x, v = choose(leaves, where, y), choose(leaves, pace + w, w)
    moved = motion(frame, x, v, now.cosine, now.sine)
    finished = (found.left == 0) | leaves
    left = choose(gone, path.to_go, choose(finished, found.left, CAPPED))
    low = choose(gone, path.to_go_low, choose(finished & (found.left > 0), found.left_low, 0.0))
    contact = side * choose(leaves, lax.full_like(side, float(Contact.LANDED)), float(Contact.WITHIN))
    none = lax.full_like(x, 0.0)
    after = path._replace(x=x, x_low=none, v=v, motion=moved, to_go=left, to_go_low=low, contact=contact)
    return push_series.chosen_lanes(inside, after, path)


def _course(frame, side, cosine, sine):
    """(position, velocity) of the wall on a side."""
    where, pace = course_on(frame, side, cosine, sine, 1)
    return where, jnp.zeros_like(cosine) if pace is None else pace


class Stay(NamedTuple):
    """What a stay does. leaves: whether the wall is left in time; time: how long it takes, or how long it was given;
    depth and its rate at the end."""

    leaves: Bool[jax.Array, "*lanes"]
    time: Float[jax.Array, "*lanes"]
    depth: Float[jax.Array, "*lanes"]
    rate: Float[jax.Array, "*lanes"]


def entering(rate, cosine, sine, there=None):
    """The `Within` of lanes that enter a wall with a speed; benign in those that do not."""
    none = jnp.zeros_like(rate)
    if there is None:
        return Within(none, none + 1.0, rate, cosine, sine)
    return Within(*(choose(there, *each) for each in ((none, 1.0), (none + 1.0, 0.0), (rate, 1.0))), cosine, sine)


def stay(frame, side, start, left, late, order, found=None):
    """The `Stay` from a `Within` on, for at most so much time, with derivatives right to an order.

    It takes so much of s as it takes, a constant; its end is moved by Taylor polynomials. left: a constant; late: 0,
    with derivatives: how much later the stay begins. found: its `pushed_flow.Passage`, where that is known.
    """
    found = found or pushed_flow.passed(*lax.stop_gradient((frame, side, start, left)))
    now, gone = pushed_flow.fly(frame, side, start, lax.stop_gradient(found.span))
    fast, time = _out(frame, side, now, order)
    deep = now.scale * now.root
    depth, rate = later(frame, side, now, deep * deep, now.scale * now.rate, left - gone - late, order)
    lost = ~(found.leaves | (found.left == 0))
    rate = choose(lost, jnp.nan, choose(found.leaves, fast, rate))
    time = choose(lost, jnp.nan, choose(found.leaves, gone + time, left - late))
    return Stay(found.leaves, time, choose(found.leaves, 0.0, depth), rate)


def _out(frame, side, now, order):
    """(the depth's rate, how much later) where the mass leaves, 0 later but for derivatives and rounding."""
    terms = push_series.coefficients(frame, side, now, order + 1)
    root, rate, time = (as_derivatives(each) for each in terms)
    span = taylor.root(root[: order + 1], order)
    rate, time = (taylor.shifted(each, span, order) for each in (rate, time))
    return now.scale * rate, time


def later(frame, side, now, depth, rate, late, order):
    """(depth, its rate) within the wall a time later, 0 but for derivatives and rounding; of a `Within` the drive's
    cosine and sine."""
    jets = push_series.motion_in_time(frame, side, now, depth, rate, order)
    return tuple(taylor.shifted(each, late, order) for each in jets)
