"""The matrix of a stay within a soft wall beside a force of the user's own, for `monodromy`."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Float

from ..compiled.compiler_hints import choose
from ..flight import flow
from ..flight.flows import flow_of
from ..flight.push_series import Within, chosen_lanes
from ..flight.pushed_flow import passed
from ..flight.pushed_stay import drawn_in, entering, stay
from ..flight.soft_contact import is_inside
from ..flight.wall import course_on, less
from ..scene.codes import Contact
from .contact_duration import product
from .onward import Onward, spent
from .path_end import leaves


class Through(NamedTuple):
    """What a stay makes of lanes: its time; x, v and the drive's cosine and sine at its end; how x and v there change
    with those at its start, by rows."""

    time: Float[jax.Array, "*lanes"]
    x: Float[jax.Array, "*lanes"]
    v: Float[jax.Array, "*lanes"]
    cosine: Float[jax.Array, "*lanes"]
    sine: Float[jax.Array, "*lanes"]
    matrix: tuple[Float[jax.Array, "*lanes"], ...]


def through(frame, lanes, outside, end, now):
    """The `Onward` after the stay of lanes that are within a wall, or at the `PathEnd`.

    lanes: (contact, y, y'); outside: whether they have come from there just now.
    """
    inside = is_inside(lanes[0])
    found = _through(frame, lanes, outside, end, now)
    within = spent(frame, lanes[0], choose(inside, found.time, 0.0), now.within)
    new = now.time + found.time, (found.x, found.v), found.cosine, found.sine, product(found.matrix, now.matrix), within
    return jax.tree.map(lambda new, old: choose(inside, new, old), Onward(*new), now)


def _through(frame, lanes, outside, end, now):
    """The `Through` of lanes within a soft wall. lanes: (contact, y, y'), benign where they are in none; outside: which
    of those that have just entered come from there.

    A later entry and a faster one change when and how fast the mass leaves; the accelerations on both sides of the
    wall say what that is at a time (the saltation matrix).
    """
    (touch, y, v), cosine, sine = lanes, now.cosine, now.sine
    inside, side = is_inside(touch), choose(touch < 0, lax.full_like(touch, -1.0), 1.0)
    enters = inside & (lax.abs(touch) == Contact.ENTERED)
    left = choose(inside, end.time - now.time, 0.0)
    depth = choose(inside & ~enters, side * y, 1.0)
    rate = choose(inside, side * v, 0.0)
    before = choose(outside, *(each(frame, side, rate, cosine, sine) for each in (_drawn, drawn_in)))
    speed = choose(enters, rate, 1.0)
    start = Within(lax.sqrt(depth), rate, jnp.ones_like(depth), cosine, sine)
    start = chosen_lanes(enters, entering(rate, cosine, sine, enters), start)
    known = passed(frame, side, start, left)
    out = leaves(frame, end, now, touch, left - known.left)
    known = known._replace(leaves=out, left=choose(known.leaves & ~out, 0.0, known.left))

    def ends(by_depth, by_rate):
        """(when, depth, rate) at the end of a stay, of changes of its start at a time."""
        late = choose(enters, -by_depth / speed, 0.0)
        fast = rate + by_rate
        turned = flow.rotated(cosine, sine, frame.frequency * late)
        fresh = entering(fast + before * late, *turned, enters)
        deep = Within(lax.sqrt(depth + by_depth), fast, jnp.ones_like(depth), cosine, sine)
        found = stay(frame, side, chosen_lanes(enters, fresh, deep), left, late, 1, known)
        return late + found.time, found.depth, found.rate

    def along(by_depth, by_rate):
        none = jnp.zeros_like(rate)
        return jax.jvp(ends, (none, none), (by_depth + none, by_rate + none))

    unit = jnp.eye(2, dtype=jnp.result_type(rate))
    (time, deep, fast), moved = jax.vmap(along, out_axes=(None, 0))(unit[0], unit[1])
    turned = flow.rotated(cosine, sine, frame.frequency * time)
    after = _drawn(frame, side, fast, *turned)
    when, by_depth, by_rate = moved
    first = choose(known.leaves, -fast * when, by_depth)
    second = choose(known.leaves, by_rate - after * when, by_rate)
    where, pace = _course(frame, side, *turned)
    matrix = first[0], first[1], second[0], second[1]
    return Through(time, where + side * deep, pace + side * fast, *turned, matrix)


def _drawn(frame, side, rate, cosine, sine):
    """The acceleration into the wall of a mass at the wall, which does not push it yet, or no longer."""
    where, pace, bend = course_on(frame, side, cosine, sine, 2)
    v = side * rate if pace is None else pace + side * rate
    pull, _ = flow_of(frame).accelerations(frame, where + 0.0 * rate, v, cosine, sine)
    return side * less(pull, bend)


def _course(frame, side, cosine, sine):
    where, pace = course_on(frame, side, cosine, sine, 1)
    return where, jnp.zeros_like(cosine) if pace is None else pace
