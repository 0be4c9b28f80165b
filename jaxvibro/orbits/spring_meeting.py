"""A stay within a soft wall of a spring and a damper, as the equations of the impacts ask for it (`saltation`).

The interface is that of `pushed_meeting`.
"""

from functools import reduce

import jax.numpy as jnp

from ..compiled.compiler_hints import choose
from ..flight import flow, soft_contact
from ..maps.contact_duration import carried, share
from ..scene.codes import Contact
from .meeting_wall import way
from .stay import guess, leave


def left(frame, sides, gives, speed, met, passed=None):
    """((the `saltation.Meeting`'s state, phasor, by_time, by_speed, opening, stay), its free) where a wall gives."""
    side = choose(gives, sides, 0.0)
    given = met.cosine, met.sine, speed
    out = leave(frame, side, *given, guess(frame, side, *given, passed))
    where, pace, _ = way(frame, sides, out.cosine, out.sine)
    here, (p00, p01, p11) = soft_contact.feeling(frame, side * Contact.ENTERED), out.free
    # at the end the damping jumps back, and with it the acceleration
    jump = 2.0 * (frame.damping - here.damping) * (pace + out.v)
    first = p00 * met.closing + p01 * out.pull, p11 * out.pull - here.stiffness * p01 * met.closing
    told = (
        (where, pace + out.v),
        (out.cosine, out.sine),
        (-first[0], jump * out.later - first[1]),
        (sides * p01, sides * (p11 + jump * out.faster)),
        out.v,
        out.time,
    )
    return told, out.free


def matrix(frame, sides, met, before, after):
    """(rows, determinant) of what stays do to (x, v); before, after: the accelerations of the free mass."""
    touch, stay = choose(met.gives, sides * float(Contact.WITHIN), 0.0), jnp.maximum(met.stay, 0.0)
    _, pace, _ = way(frame, sides, *met.phasor)
    return carried(frame, touch, stay, met.free, share(met.pace, met.closing), share(pace, met.opening))


def inside(frame, met, sides, k, since, state):
    """(x, v) a time after the meetings in rows k: within the wall during the stay, else the state given."""
    touch = choose(met.gives, sides * float(Contact.WITHIN), 0.0)[k]
    here = soft_contact.feeling(frame, touch)
    within = (touch != 0) & (since < met.stay[k])
    span = choose(within, since, 0.0)
    cosine, sine = met.cosine[k], met.sine[k]
    y, v = soft_contact.flown(
        here, touch, soft_contact.response(here, touch, span), (0.0 * span, met.closing[k]), cosine, sine
    )
    where, pace, _ = way(frame, sides[k], *flow.rotated(cosine, sine, frame.frequency * span))
    return choose(within, where + y, state[0]), choose(within, pace + v, state[1])


def rate(frame, met, sides):
    """How fast the mass swings within soft walls at most, a scalar."""
    return reduce(jnp.maximum, [flow.STEP / soft.reach for soft in frame.contacts if soft is not None])


def reach(frame, met, sides):
    """How far stays can be followed in one piece, a scalar."""
    return jnp.min(soft_contact.felt(frame, sides * float(Contact.WITHIN)).reach)
