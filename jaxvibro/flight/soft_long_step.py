"""Long steps within a soft wall: over most of a contact (`soft_half_swing`), or many of the wall's own swings.

Within a wall y = slow + fast: the forced motion and, where the wall is overdamped, what creeps back; and the rest w,
whose energy falls, so that it never exceeds B = sqrt(w^2 + w'^2 / (1 + k2)). While slow stays above B there is no way
out: that is the certified step of `event`, in the slow part's own time. The flow over it is the exact one.
"""

from typing import NamedTuple

import jax
from jax import lax
from jaxtyping import Float

from ..compiled.compiler_hints import choose, least, mask, merge, positive, stage
from ..scene.codes import Contact
from . import drive, event, flow, soft_contact
from .flight_state import SlowMotion, remaining
from .soft_half_swing import is_sure

PATIENCE = 8.0  # short steps before a long one is tried
WORTH = 4.0  # short steps that a long one must be
STIFF = 4.0  # times the square of the drive's rate: below that stiffness all motion is slow
OVERDAMPED = 2.0  # times the stiffness: damping^2 from which two rates are told apart


class Wave(NamedTuple):
    """A part of a slow motion: the real part of (real + i imaginary) exp(i rate t)."""

    real: Float[jax.Array, "..."]
    imaginary: Float[jax.Array, "..."]
    rate: Float[jax.Array, "..."]

    @property
    def size(self) -> Float[jax.Array, "..."]:
        return lax.abs(self.real) + lax.abs(self.imaginary)

    def values(self, count: int) -> list[Float[jax.Array, "..."]]:
        """So many derivatives at t = 0, from the value on."""
        found, (real, imaginary) = [], (self.real, self.imaginary)
        for _ in range(count):
            found.append(real)
            real, imaginary = -self.rate * imaginary, self.rate * real
        return found


class Creep(NamedTuple):
    """A part of a slow motion: real exp(-rate t)."""

    real: Float[jax.Array, "..."]
    rate: Float[jax.Array, "..."]

    @property
    def size(self) -> Float[jax.Array, "..."]:
        return lax.abs(self.real)

    def values(self, count: int) -> list[Float[jax.Array, "..."]]:
        """So many derivatives at t = 0, from the value on."""
        found = [self.real]
        while len(found) < count:
            found.append(-self.rate * found[-1])
        return found


def plunged(frame, path):
    """The path with the lanes that have just entered a stiff wall, fast enough, carried most of the way back.

    frame: as the lanes feel it (`soft_contact.felt`).
    """
    going = stage(_plunges, frame, path)
    angle = stage(_turned, frame, path)
    x, v = stage(_plunged, frame, path)
    left = stage(_left, frame, path)
    new = x, v, x, v, *angle, *left, lax.sign(path.contact) * Contact.WITHIN
    old = path.x, path.v, path.motion.slow_x, path.motion.slow_v, path.cosine, path.sine
    old = *old, path.to_go, path.to_go_low, path.contact
    x, v, slow_x, slow_v, cosine, sine, to_go, low, touch = (merge(going, *each) for each in zip(new, old, strict=True))
    motion = path.motion._replace(slow_x=slow_x, slow_v=slow_v, cosine=cosine, sine=sine)
    return path._replace(x=x, v=v, motion=motion, to_go=to_go, to_go_low=low, contact=touch)


def _plunges(frame, path):
    first, side = soft_contact.plunges(frame, path.contact), lax.sign(path.contact)
    push = frame.force * path.cosine
    bias = soft_contact.biases(frame, path.contact, path.cosine, path.sine, 0)
    (bias,) = drive.pushed(frame.terms, frame.frequency, path.cosine, path.sine, bias)
    sure = is_sure(first, side * path.v, side * (push if bias is None else push + bias))
    return mask((lax.abs(path.contact) == Contact.ENTERED) & sure & (path.to_go > first.time), path.x)


def _turned(frame, path):
    return flow.turn(path.cosine, path.sine, *soft_contact.plunges(frame, path.contact).angle)


def _plunged(frame, path):
    first = soft_contact.plunges(frame, path.contact)
    waves = first.terms if first.waves is None else (*first.terms, first.waves)
    response = soft_contact.StayResponse(first.free, first.forced, waves)
    return soft_contact.flown(frame, path.contact, response, (path.x, path.v), path.cosine, path.sine)


def _left(frame, path):
    return remaining(path, soft_contact.plunges(frame, path.contact).time)


def is_due(path, wait):
    """The lanes that have waited long enough for a long step to be tried."""
    return (wait >= PATIENCE) & (path.to_go > 0)


def by_series(frame, path, time):
    """(y, y') a time later, from the flow's `Series` of each lane."""
    return stage(_flown, frame, path, time)


def leap(frame, path, wait, flown=by_series):
    """(path, wait): lanes that wait for a long step have taken it where there is one, and begin to wait anew.

    flown: (frame as the lanes feel it, path, time) -> (y, y') a time later.
    """
    here = soft_contact.feeling(frame, path.contact)
    due = is_due(path, wait)
    time = choose(due, least(stage(_safe, here, path), path.to_go), 0.0)
    taken = time > WORTH * here.reach
    time = choose(taken, time, 0.0)
    angle = frame.frequency * time
    turned = stage(flow.turn, path.cosine, path.sine, flow.versine(angle), flow.sinus(angle))
    x, v = flown(here, path, time)
    none = lax.full_like(x, 0.0)
    moved = SlowMotion(x, none, v, none, *turned)
    moved = SlowMotion(*(choose(taken, new, old) for new, old in zip(moved, path.motion, strict=True)))
    to_go, low = remaining(path, time)
    sign = lax.sign(path.contact)
    after = path._replace(
        x=choose(taken, x, path.x),
        x_low=choose(taken, 0.0, path.x_low),
        v=choose(taken, v, path.v),
        motion=moved,
        to_go=choose(taken, positive(to_go), path.to_go),
        to_go_low=choose(taken, low, path.to_go_low),
        contact=choose(taken, sign * Contact.WITHIN, path.contact),
    )
    return after, choose(due, 0.0, wait)


def _safe(frame, path):
    """A time for which the mass certainly stays within its wall; 0 where that cannot be said, as where swings grow
    (with time reversed)."""
    parts = _forced(frame, path.contact, path.cosine, path.sine)
    stiffness, damping, side = frame.stiffness, frame.damping, lax.sign(path.contact)
    place, pace = (sum(each) for each in zip(*(part.values(2) for part in parts), strict=True))
    w, u = path.x - place, path.v - pace
    inner = damping * damping - stiffness
    creeps = damping * damping > OVERDAMPED * stiffness
    swift = damping + lax.sqrt(choose(creeps, inner, 0.0))
    creep = choose(creeps, stiffness / swift, 0.0)
    gone = (u + creep * w) / choose(creeps, creep - swift, -1.0)
    kept = choose(creeps, w - gone, 0.0)
    bound = choose(creeps, lax.abs(gone), lax.sqrt(w * w + u * u / stiffness))
    parts = [*parts, Creep(kept, creep)]
    pace = creep
    for part in parts[:-1]:
        pace = choose(part.rate > pace, part.rate, pace)
    reach = flow.STEP / pace
    weights = event.weights(reach)
    slow = [sum(each) for each in zip(*(part.values(event.TERMS) for part in parts), strict=True)]
    terms = [-(side * each) * weight for each, weight in zip(slow, weights, strict=False)]
    terms[0] = terms[0] + bound
    remainder = sum(part.size * part.rate**event.TERMS for part in parts) * weights[event.TERMS]
    ahead = event.Progress(tuple(terms), remainder)
    limit = event.bound(ahead, event.cubic(ahead))
    near = event.free_step(limit)
    step = event.sure_step(limit, event.horizon(limit, event.quadratic(*limit[:3])), near)
    stiff = stiffness > STIFF * pace * pace
    return choose((terms[0] < 0) & stiff & (damping >= 0), step * reach, 0.0)


def _flown(frame, path, time):
    """(y, y') a time later, the flow's short step doubled."""
    response = soft_contact.response(frame, path.contact, time)
    return soft_contact.flown(frame, path.contact, response, (path.x, path.v), path.cosine, path.sine)


def _forced(frame, touch, cosine, sine):
    """The `Wave`s that drive and wall force on y; frame: as the lanes feel it. Of no use where they resonate."""
    none = 0.0 * cosine
    waves = [(frame.force * cosine, frame.force * sine, frame.frequency + none)]
    waves += soft_contact.forces(frame, touch, cosine, sine)
    found = []
    for along, across, rate in waves:
        lag, away = 2.0 * frame.damping * rate, frame.stiffness - rate * rate
        size = away * away + lag * lag
        found.append(Wave((along * away + across * lag) / size, (across * away - along * lag) / size, rate))
    place, _ = soft_contact.rested(frame, touch, cosine, -1.0, none)
    return [Wave(place, none, none), *found]
