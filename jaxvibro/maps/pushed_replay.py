"""A stay within a soft wall beside a force of the user's own made again, for derivatives: as `contact_replay`, by the
steps of `pushed_stay`; and its matrix, for `monodromy`."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Float

from ..compiled.compiler_hints import choose
from ..flight import flow, taylor
from ..flight.flight_state import accelerations
from ..flight.push_series import Within, chosen_lanes
from ..flight.pushed_flow import passed
from ..flight.pushed_stay import drawn_in, ended, entering, stay
from ..flight.soft_contact import gives, is_inside
from ..flight.taylor import Now
from ..flight.wall import course, less, picked
from ..scene.codes import Contact


class Entry(NamedTuple):
    """Lanes that are to go through a stay. side: of the wall, 0 of lanes that are in none; start: where in it, benign
    in these; late: 0, with derivatives: how much later than now it begins."""

    side: Float[jax.Array, "*lanes"]
    start: Within
    late: Float[jax.Array, "*lanes"]


def begun(frame, now, lanes):
    """The `Entry` of lanes that start within a soft wall; lanes: (contact, y, y')."""
    touch, y, v = lanes
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
    return Entry(choose(inside, side, 0.0), start, late)


def entered(frame, now, side, late, order):
    """The `Entry` of lanes that enter the soft wall on a side a little later than now; side: 0 of lanes that hit
    none."""
    inside = gives(frame, side) & (side != 0)
    side = choose(inside, side, 1.0)
    _, pace = taylor.placed(taylor.way(frame, now, side, order), late, order)
    rate = side * (taylor.shifted(taylor.jet(frame, now, order)[1:], late, order) - pace)
    start = entering(rate, *_turned(frame, now, late), inside)
    return Entry(choose(inside, side, 0.0), start, choose(inside, late, 0.0))


def gone(frame, now, entry, whole, order):
    """Lanes that are to go through a stay brought to where they leave the wall, or to the end."""
    inside, late = entry.side != 0, entry.late
    side, left = choose(inside, entry.side, 1.0), choose(inside, whole - now.time, 0.0)
    found = stay(frame, side, entry.start, left, late, order)
    time = choose(found.leaves, lax.stop_gradient(found.time), left)
    late = choose(found.leaves, late + (found.time - time), 0.0)
    cosine, sine = _turned(frame, now, time)
    end = Now(now.x, now.v, cosine, sine, now.time + time)
    where, pace = taylor.placed(taylor.way(frame, end, side, order), late, order)
    x, v = where + side * found.depth, pace + side * found.rate
    free = taylor.back(frame, end, where, v, late, order)
    x, v = (choose(found.leaves, *each) for each in zip(free, (x, v), strict=True))
    return Now(*(choose(inside, new, old) for new, old in zip(end._replace(x=x, v=v), now, strict=True)))


def shifted(frame, now, touch, late, order):
    """(x, v) a time later, 0 with derivatives, of lanes that are within a soft wall; of no meaning in others."""
    inside, side = is_inside(touch), _side(touch)
    where, pace = taylor.placed(taylor.way(frame, now, side, order), 0.0 * late, order)
    depth = choose(inside, side * (now.x - where), 1.0)
    start = Within(lax.sqrt(depth), side * (now.v - pace), jnp.ones_like(depth), now.cosine, now.sine)
    depth, rate, _ = ended(frame, side, start, -late, inside != inside, order)
    where, pace = taylor.placed(taylor.way(frame, now, side, order), late, order)
    return where + side * depth, pace + side * rate


def _side(touch):
    return choose(touch < 0, lax.full_like(touch, -1.0), 1.0)


def _turned(frame, now, late):
    return flow.rotated(now.cosine, now.sine, frame.frequency * late)


class Through(NamedTuple):
    """What a stay makes of lanes: its time; x, v and the drive's cosine and sine at its end; how x and v there change
    with those at its start, by rows."""

    time: Float[jax.Array, "*lanes"]
    x: Float[jax.Array, "*lanes"]
    v: Float[jax.Array, "*lanes"]
    cosine: Float[jax.Array, "*lanes"]
    sine: Float[jax.Array, "*lanes"]
    matrix: tuple[Float[jax.Array, "*lanes"], ...]


def through(frame, lanes, cosine, sine, left, outside):
    """The `Through` of lanes within a soft wall. lanes: (contact, y, y'), benign where they are in none; left: the time
    that they have; outside: which of those that have just entered come from there.

    A later entry and a faster one change when and how fast the mass leaves; the accelerations on both sides of the
    wall say what that is at a time (the saltation matrix).
    """
    touch, y, v = lanes
    inside, side = is_inside(touch), _side(touch)
    enters = inside & (lax.abs(touch) == Contact.ENTERED)
    left = choose(inside, left, 0.0)
    depth = choose(inside & ~enters, side * y, 1.0)
    rate = choose(inside, side * v, 0.0)
    before = choose(outside, *(each(frame, side, rate, cosine, sine) for each in (_drawn, drawn_in)))
    speed = choose(enters, rate, 1.0)
    start = Within(lax.sqrt(depth), rate, jnp.ones_like(depth), cosine, sine)
    start = chosen_lanes(enters, entering(rate, cosine, sine, enters), start)
    known = passed(frame, side, start, left)

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
    ways = [course(wall, frame.frequency, cosine, sine, 2) for wall in frame.walls]
    where, pace, bend = picked(side, frame.walls, ways)
    v = side * rate if pace is None else pace + side * rate
    pull, _ = accelerations(frame, where + 0.0 * rate, v, cosine, sine)
    return side * less(pull, bend)


def _course(frame, side, cosine, sine):
    where, pace = picked(side, frame.walls, [course(wall, frame.frequency, cosine, sine, 1) for wall in frame.walls])
    return where, jnp.zeros_like(cosine) if pace is None else pace
