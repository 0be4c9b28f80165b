"""A stay within a soft wall beside a force of the user's own made again, for derivatives: as `contact_replay`, by the
steps of `pushed_stay`; and its matrix, for `monodromy`."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Float

from ..compiled.compiler_hints import choose
from ..flight import flow, taylor
from ..flight.flows import flow_of
from ..flight.push_series import Within
from ..flight.pushed_flow import passed
from ..flight.pushed_stay import drawn_in, entering, later, stay
from ..flight.soft_contact import gives, is_inside
from ..flight.taylor import Now
from ..scene.codes import Contact
from . import start_within
from .path_end import leaves


class Entry(NamedTuple):
    """Lanes that are to go through a stay. side: of the wall, 0 of lanes that are in none; start: where in it, benign
    in these; late: 0, with derivatives: how much later than now it begins."""

    side: Float[jax.Array, "*lanes"]
    start: Within
    late: Float[jax.Array, "*lanes"]


def begun(frame, now, given, end, order):
    """(now, the `Entry` of lanes that start within a soft wall); given: the contact."""
    touch, y, v = start_within.within(frame, now, given, order)
    inside, side = is_inside(touch), _side(touch)
    depth, rate = side * y, side * v
    fresh = inside & (lax.stop_gradient(depth) <= 0)
    late = choose(fresh, -depth / choose(fresh, rate, 1.0), 0.0)  # right to first order: so is all that follows
    deep = inside & ~fresh
    faster = late * drawn_in(frame, side, rate, now.cosine, now.sine)
    enters = entering(rate + faster, now.cosine, now.sine, fresh)
    start = Within(
        choose(deep, lax.sqrt(choose(deep, depth, 1.0)), enters.root),
        choose(deep, rate, enters.rate),
        choose(deep, 1.0, enters.scale),
        *(choose(fresh, new, old) for new, old in zip(_turned(frame, now, late), (now.cosine, now.sine), strict=True)),
    )
    return now, Entry(choose(inside, side, 0.0), start, late)


def entered(frame, now, side, late, end, order):
    """(now, the `Entry` of lanes that enter the soft wall on a side a little later); side: 0 of lanes that hit none."""
    inside = gives(frame, side) & (side != 0)
    side = choose(inside, side, 1.0)
    _, pace = taylor.placed(taylor.way(frame, now, side, order), late, order)
    rate = side * (taylor.shifted(flow_of(frame).jet_at(frame, now, order)[1:], late, order) - pace)
    start = entering(rate, *_turned(frame, now, late), inside)
    return now, Entry(choose(inside, side, 0.0), start, choose(inside, late, 0.0))


def gone(frame, now, entry, end, order):
    """Lanes that are to go through a stay brought to where they leave the wall, or to the end."""
    inside, late = entry.side != 0, entry.late
    side, left = choose(inside, entry.side, 1.0), choose(inside, end.time - now.time, 0.0)
    known = passed(*lax.stop_gradient((frame, side, entry.start, left)))
    out = leaves(frame, end, now, entry.side * Contact.WITHIN, left - known.left)
    known = known._replace(leaves=out, left=choose(known.leaves & ~out, 0.0, known.left))
    found = stay(frame, side, entry.start, left, late, order, known)
    time = choose(found.leaves, lax.stop_gradient(found.time), left)
    late = choose(found.leaves, late + (found.time - time), 0.0)
    cosine, sine = _turned(frame, now, time)
    after = Now(now.x, now.v, cosine, sine, now.time + time)
    where, pace = taylor.placed(taylor.way(frame, after, side, order), late, order)
    x, v = where + side * found.depth, pace + side * found.rate
    free = flow_of(frame).back(frame, after, where, v, late, order)
    x, v = (choose(found.leaves, *each) for each in zip(free, (x, v), strict=True))
    return Now(*(choose(inside, new, old) for new, old in zip(after._replace(x=x, v=v), now, strict=True)))


def shifted(frame, now, contact, free, late, order):
    """(x, v) a time later, 0 with derivatives; contact, free: see `no_replay`."""
    inside, side = is_inside(contact), _side(contact)
    where, pace = taylor.placed(taylor.way(frame, now, side, order), 0.0 * late, order)
    depth, rate = choose(inside, side * (now.x - where), 1.0), side * (now.v - pace)
    start = Within(depth, rate, jnp.ones_like(depth), now.cosine, now.sine)
    depth, rate = later(frame, side, start, depth, rate, late, order)
    where, pace = taylor.placed(taylor.way(frame, now, side, order), late, order)
    return tuple(choose(inside, *each) for each in zip((where + side * depth, pace + side * rate), free, strict=True))


def _side(touch):
    return choose(touch < 0, lax.full_like(touch, -1.0), 1.0)


def _turned(frame, now, late):
    return flow.rotated(now.cosine, now.sine, frame.frequency * late)
