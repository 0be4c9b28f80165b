"""A stay within a soft wall beside a force of the user's own, as the equations of the impacts ask for it (`saltation`).

When and how fast the mass leaves is a smooth function of when and how fast it comes, also where that speed is zero; its
derivatives are by jvp along the steps of `pushed_stay`.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Float

from continuation.arrays import Array

from ..compiled.compiler_hints import choose
from ..flight import flow
from ..flight.flows import flow_of
from ..flight.pushed_flow import passed
from ..flight.pushed_stay import entering, stay
from .meeting_wall import way

LONGEST = 8.0  # drive periods that a stay is searched for
BEGUN = 1e-20  # drive periods, by which a time since an entry is longer: there the root of the depth has no slope
ORDER = 3  # to which derivatives of its end are right


class Leaving(NamedTuple):
    """time of the stay, nan where it does not end in `LONGEST`; speed: the rate of the depth at its end; the drive's
    cosine and sine there; and how time and speed change with the time of the entry and with its speed, by rows."""

    time: Float[Array, "*lanes"]
    speed: Float[Array, "*lanes"]
    cosine: Float[Array, "*lanes"]
    sine: Float[Array, "*lanes"]
    slopes: tuple[Float[Array, "*lanes"], ...]


def leave(frame, gives, side, cosine, sine, speed):
    """The `Leaving` of lanes that meet the soft wall on a side, which gives; benign in others."""
    side, speed = jnp.where(gives, side, 1.0), jnp.where(gives, speed, 1.0)
    left = jnp.where(gives, LONGEST * frame.period, 0.0)
    known = passed(*lax.stop_gradient((frame, side, entering(speed, cosine, sine), left)))
    none = jnp.zeros_like(speed)

    def ends(late, speed):
        start = entering(speed, *flow.rotated(cosine, sine, frame.frequency * late))
        found = stay(frame, side, start, left, late, ORDER, known)
        return late + found.time, found.rate

    def along(late, fast):
        return jax.jvp(ends, (none, speed), (late + none, fast + none))

    unit = jnp.eye(2, dtype=speed.dtype)  # both ways in one loop, which is compiled once
    (time, after), ((later, by_speed), (quicker, faster)) = jax.vmap(along, out_axes=(None, 0))(unit[0], unit[1])
    time = jnp.where(gives & ~known.leaves, jnp.nan, time)
    return Leaving(time, after, *flow.rotated(cosine, sine, frame.frequency * time), (later, by_speed, quicker, faster))


def left(frame, sides, gives, speed, met, passed=None):
    """((the `saltation.Meeting`'s state, phasor, by_time, by_speed, opening, stay), its free) where a wall gives."""
    out = leave(frame, gives, sides, met.cosine, met.sine, speed)
    where, pace, bend = way(frame, sides, out.cosine, out.sine)
    opening = sides * out.speed
    after, _ = flow_of(frame).accelerations(frame, where, pace + opening, out.cosine, out.sine)
    told = (where, pace + opening), (out.cosine, out.sine), *_at_a_time(out, bend, after, sides), opening, out.time
    return told, out.slopes


def _at_a_time(out, bend, after, side):
    """(how (x, v) change with the time of the entry, with its speed) where the flight after a stay begins, at a fixed
    time; bend, after: the accelerations of the wall and of the free mass there."""
    later, by_speed, quicker, faster = out.slopes
    by_time = -side * out.speed * later, (bend - after) * later + side * quicker
    return by_time, (-side * out.speed * by_speed, (bend - after) * by_speed + side * faster)


def matrix(frame, sides, met, before, after):
    """(rows, determinant) of what stays do to (x, v) at a fixed time; before, after: the accelerations of the free
    mass."""
    _, _, bend = way(frame, sides, *met.phasor)
    later, by_speed, quicker, faster = met.free
    before, after = sides * (before - met.bend), sides * (after - bend)
    first, last = sides * met.closing, sides * met.opening
    ratio = jnp.where(first == 0, -1.0, last / jnp.where(first == 0, 1.0, first))
    when, fast = later + before * by_speed, quicker + before * faster
    shear = jnp.where(first == 0, 0.0, (after * when - fast) / jnp.where(first == 0, 1.0, first))
    rows = ratio * when, -last * by_speed, shear, faster - after * by_speed
    return rows, ratio * (later * faster - by_speed * quicker)


def inside(frame, met, sides, k, since, state):
    """(x, v) a time after the meetings in rows k: within the wall during the stay, else the state given."""
    within = met.gives[k] & (since < met.stay[k])
    side, span = sides[k], jnp.where(within, since, 0.0)
    given = side, met.cosine[k], met.sine[k], side * met.closing[k]
    depth, rate = depth_after(frame, within, *given, span)
    where, pace, _ = way(frame, side, *flow.rotated(*given[1:3], frame.frequency * span))
    return choose(within, where + side * depth, state[0]), choose(within, pace + side * rate, state[1])


def depth_after(frame, gives, side, cosine, sine, speed, since):
    """(depth, its rate) so long after the entry of lanes that are still within the wall then; benign in others."""
    side, speed = jnp.where(gives, side, 1.0), jnp.where(gives, speed, 1.0)
    span = jnp.where(gives, since + BEGUN * frame.period, 0.0)
    found = stay(frame, side, entering(speed, cosine, sine), span, 0.0 * span, 1)
    return found.depth, found.rate


def rate(frame, met, sides):
    """How fast the mass swings within soft walls at most, a scalar: by how long it stays."""
    held = met.gives & (sides != 0) & (met.stay > 0)
    return jnp.max(jnp.where(held, jnp.pi / jnp.where(held, met.stay, 1.0), 0.0))


def reach(frame, met, sides):
    """How far stays can be followed in one piece, a scalar."""
    stay = jnp.where(met.gives, jnp.maximum(met.stay, 0.0), 0.0)
    return jnp.maximum(jnp.max(stay), jnp.finfo(stay.dtype).tiny)
