"""What a mass feels within a soft wall (paper, (39)): another oscillator, in y = x - x_b, how far it is past the wall.

    y'' + 2 gamma2 y' + (1 + k2) y = A cos(theta) - x_b - 2 gamma2 x_b' - x_b''

The right-hand side is what presses a mass that is at rest on the wall. Counted from the wall, y keeps its digits
however stiff the wall is. A lane is within a wall from the step that meets it to the one that brings it back.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Float

from ..compiled.compiler_hints import choose
from ..scene.codes import Contact
from . import drive, flow
from .soft_half_swing import Plunge, plunge
from .wall import chosen, course, less


class SoftFlow(NamedTuple):
    """The oscillator within a wall: stiffness 1 + k2 and its root; damping gamma2; series: of its flow under the drive;
    waves: under the wall's own motion, None where it stands still; plunge: the first step after an entry; reach: the
    longest of the others; curb, slope: as the `coefficients.Frame` has them, for y; terms: as series, of the drive's
    further terms."""

    stiffness: Float[jax.Array, "..."]
    root: Float[jax.Array, "..."]
    damping: Float[jax.Array, "..."]
    series: flow.Series
    waves: flow.Series | None
    plunge: Plunge
    reach: Float[jax.Array, "..."]
    curb: Float[jax.Array, "..."]
    slope: Float[jax.Array, "..."]
    terms: tuple[flow.Series, ...] = ()


class Felt(NamedTuple):
    """What of a `coefficients.Frame` differs between lanes: damping; swift; stiffness, its root; reach, pace; curb,
    slope."""

    damping: Float[jax.Array, "..."]
    swift: Float[jax.Array, "..."]
    stiffness: Float[jax.Array, "..."]
    root: Float[jax.Array, "..."]
    reach: Float[jax.Array, "..."]
    pace: Float[jax.Array, "..."]
    curb: Float[jax.Array, "..."]
    slope: Float[jax.Array, "..."]


def contact(wall, force, frequency, terms=()):
    """The `SoftFlow` of a wall's `Lane`, None for a rigid one; terms: of the drive, beside its first."""
    if wall.stiffness is None:
        return None
    stiffness, damping = 1.0 + wall.stiffness, wall.damping
    root = jnp.sqrt(stiffness)
    rate, waves = flow.rate(frequency, damping, stiffness), None
    forcing = drive.largest(terms, force, frequency, 6)
    if terms:
        rate = jnp.maximum(rate, frequency * float(drive.fastest(terms)))
    if wall.swing is not None:
        own = frequency * float(wall.harmonic)
        rate = jnp.maximum(rate, own)
        waves = flow.series(own, damping, stiffness)
        forcing = forcing + abs(wall.swing) * own**6 * (1.0 + 2.0 * damping * own + own * own)
    reach = flow.STEP / rate
    # energy of y^(6), as for x in `frame`: y^(7)^2 + (1 + k2) y^(6)^2
    slope = jnp.sqrt(stiffness + 4.0 * damping * damping)
    series = flow.series(frequency, damping, stiffness)
    more = tuple(flow.series(drive.rate_of(term, frequency), damping, stiffness) for term in terms)
    first = plunge(wall, force, frequency, series, waves, stiffness, list(zip(terms, more, strict=True)))
    return SoftFlow(stiffness, root, damping, series, waves, first, reach, forcing * (1.0 + slope * reach), slope, more)


def is_inside(contact):
    """The lanes that are within a soft wall."""
    size = lax.abs(contact)
    return (size == Contact.WITHIN) | (size == Contact.ENTERED)


def gives(frame, side):
    """Whether the wall on a side is a soft one; side: -1, +1, 0 for none."""
    found = side != side
    for wall, soft in zip(frame.walls, frame.contacts, strict=True):
        if soft is not None:
            found |= side == float(wall.sign)
    return found


def bounce(frame, side):
    """The restitution of the wall on a side; -1 of a soft one, at which the velocity stays as it is."""
    walls = [
        lax.full_like(wall.position, -1.0) if wall.restitution is None else wall.restitution for wall in frame.walls
    ]
    return chosen(side, frame.walls, walls)


def felt(frame, contact):
    """The `Felt` of each lane: within a wall no part of the motion is swift."""
    soft = [each for each in frame.contacts if each is not None]
    inside = is_inside(contact)

    def number(name, free):
        return choose(inside, _own(contact, [getattr(each, name) for each in soft]), free)

    reach = number("reach", frame.reach)
    return Felt(
        damping=number("damping", frame.damping),
        swift=choose(inside, 0.0, frame.swift),
        stiffness=number("stiffness", 1.0),
        root=number("root", 1.0),
        reach=reach,
        pace=1.0 / reach,
        curb=number("curb", frame.curb),
        slope=number("slope", frame.slope),
    )


def feeling(frame, contact):
    """The `coefficients.Frame` as each lane feels it."""
    return frame._replace(**felt(frame, contact)._asdict())


def _own(contact, values):
    """The value of the soft wall that a lane is within: values of those that there are, left first."""
    return values[0] if len(values) == 1 else choose(contact < 0, *values)


def moves(frame):
    """Whether a soft wall moves."""
    return any(each is not None and each.waves is not None for each in frame.contacts)


def gains(frame, contact, time):
    """The `flow.Gains` of each lane."""
    return flow.gains(_series(frame, contact), frame.frequency, time)


def waved(frame):
    """Whether there are `forces`."""
    return bool(frame.terms) or moves(frame)


def waves(frame, contact, time):
    """[(lift, lag)] of each lane for each of its `forces`."""
    found = [flow.lifts(series, time) for series in _terms(frame, contact)]
    if moves(frame):
        found.append(flow.lifts(_waves(frame, contact), choose(_is_moved(frame, contact), time, 0.0)))
    return found


def forces(frame, contact, cosine, sine):
    """[(along, across, rate)]: what drives lanes beside A cos(theta) and where the wall is, each a force along cos -
    across sin of its own angle since now: the drive's further terms, and, where a soft wall moves, the motion of the
    wall that a lane is within."""
    found = drive.waves(frame.terms, frame.frequency, cosine, sine)
    return [*found, wave(frame, contact, cosine, sine)] if moves(frame) else found


def _is_moved(frame, contact):
    """The lanes that are within a wall that moves."""
    found = contact != contact
    for wall, soft in zip(frame.walls, frame.contacts, strict=True):
        if soft is not None and soft.waves is not None:
            found |= is_inside(contact) & (contact * wall.sign > 0)
    return found


def _series(frame, contact):
    """The flow's `Series` of each lane, rows in place of arrays."""
    return _felt_series(contact, frame.series, [each.series for each in frame.contacts if each is not None])


def _terms(frame, contact):
    """As `_series`, under each further term of the drive."""
    within = zip(*(each.terms for each in frame.contacts if each is not None), strict=True)
    return [_felt_series(contact, term.series, own) for term, own in zip(frame.terms, within, strict=True)]


def _felt_series(contact, outside, soft):
    """The `Series` of each lane of that outside and those within the soft walls."""
    inside = is_inside(contact)

    def lanes(free, *within):
        rows = range(free.shape[0])
        return [choose(inside, _own(contact, [each[k] for each in within]), free[k]) for k in rows]

    return flow.Series(*map(lanes, outside, *soft))


def _waves(frame, contact):
    """As `_series`, under the motion of the wall that a lane is within."""

    def lanes(*within):
        return [_own(contact, [each[k] for each in within]) for k in range(within[0].shape[0])]

    moving = [each.waves for each in frame.contacts if each is not None and each.waves is not None]
    return flow.Series(*map(lanes, *moving))


def biases(frame, contact, cosine, sine, order):
    """The force on y that is not the drive's, - x_b - 2 gamma2 x_b' - x_b'', and its derivatives, None where zero.

    Zero in lanes that are outside.
    """
    inside = is_inside(contact)
    soft = [wall for wall, each in zip(frame.walls, frame.contacts, strict=True) if each is not None]
    found = []
    for own in zip(*(_bias(wall, frame.frequency, cosine, sine, order) for wall in soft), strict=True):
        none = all(each is None for each in own)
        own = [0.0 * cosine if each is None else each + 0.0 * cosine for each in own]
        found.append(None if none else choose(inside, _own(contact, own), 0.0))
    return found


def _bias(wall, frequency, cosine, sine, order):
    way = course(wall, frequency, cosine, sine, order + 2)
    found = []
    for k in range(order + 1):
        drag = None if way[k + 1] is None else 2.0 * wall.damping * way[k + 1]
        found.append(None if way[k] is None else less(less(-way[k], drag), way[k + 2]))
    return found


def pushed(frame, contact, motion, gains, waves):
    """What the `biases`, and the drive's further terms, add to y and y' over a flight: (dx, dv); waves: see there."""
    dx, dv = rested(frame, contact, motion.cosine, gains.stay, gains.move)
    if waves:
        given = forces(frame, contact, motion.cosine, motion.sine)
        for (along, across, pace), (lift, lag) in zip(given, waves, strict=True):
            dx = dx + (along * lift - across * lag)
            dv = dv + (along * (gains.move - pace * lag) - across * (pace * lift))
    return dx, dv


def rested(frame, contact, like, stay, move):
    """What the wall's mean position adds to y and y'."""
    soft = [each for each in zip(frame.walls, frame.contacts, strict=True) if each[1] is not None]
    place = choose(is_inside(contact), _own(contact, [wall.position + 0.0 * like for wall, _ in soft]), 0.0)
    return place * stay / _own(contact, [each.stiffness for _, each in soft]), -place * move


def wave(frame, contact, cosine, sine):
    """(along, across, rate): of the wall's motion the force is along cos - across sin of its own angle since now."""
    walls = zip(frame.walls, frame.contacts, strict=True)
    moving = [wall for wall, soft in walls if soft is not None and soft.waves is not None]
    along, across, rate = (
        _own(contact, list(each))
        for each in zip(*(_swing(wall, frame.frequency, cosine, sine) for wall in moving), strict=True)
    )
    here = _is_moved(frame, contact)
    return choose(here, along, 0.0), choose(here, across, 0.0), rate


def _swing(wall, frequency, cosine, sine):
    """`_wave` of one wall: its force is - x_b - 2 gamma2 x_b' - x_b''."""
    rate = frequency * float(wall.harmonic)
    place, pace = course(wall, frequency, cosine, sine, 1)
    place, quarter = place - wall.position, -pace / rate  # swing times cosine and sine of the wall's angle
    bend, drag = rate * rate - 1.0, 2.0 * wall.damping * rate
    return bend * place + drag * quarter, bend * quarter - drag * place, rate + 0.0 * cosine


class StayResponse(NamedTuple):
    """What a stay of a given time does: `flow.doubled`'s matrix; motions forced by the drive, and by each of the
    `forces`."""

    free: flow.FreeFlow
    forced: flow.ForcedFlow
    waves: tuple[flow.ForcedFlow, ...]


def response(frame, contact, time):
    """The `StayResponse` of each lane over any time; frame: as the lanes feel it (`felt`)."""
    given = frame.damping, time, frame.stiffness
    free, forced, _ = flow.doubled(_series(frame, contact), frame.frequency, *given)
    found = []
    for term, series in zip(frame.terms, _terms(frame, contact), strict=True):
        found.append(flow.doubled(series, drive.rate_of(term, frame.frequency), *given)[1])
    if moves(frame):
        *_, rate = wave(frame, contact, 0.0 * time, 0.0 * time)
        span = choose(_is_moved(frame, contact), time, 0.0)
        found.append(flow.doubled(_waves(frame, contact), rate, frame.damping, span, frame.stiffness)[1])
    return StayResponse(free, forced, tuple(found))


def flown(frame, contact, response, start, cosine, sine):
    """(y, y') after a stay of this `StayResponse` from (y, y')."""
    free, forced, waves = response
    force = frame.force * cosine, frame.force * sine
    y, v = flow.flown((free, forced), *force, *start, frame.stiffness)
    dy, dv = rested(frame, contact, cosine, free[0] - 1.0, free[1])
    y, v = y + dy, v + dv
    if waves:
        for (along, across, _), forced in zip(forces(frame, contact, cosine, sine), waves, strict=True):
            dy, dv = flow.flown((free, forced), along, across, 0.0 * y, 0.0 * v, frame.stiffness)
            y, v = y + dy, v + dv
    return y, v


def plunges(frame, contact):
    """The `Plunge` of each lane."""
    soft = [each.plunge for each in frame.contacts if each is not None]
    moved = [each.waves for each in soft if each.waves is not None]
    soft = [each._replace(waves=each.waves or moved[0]) if moved else each for each in soft]
    return jax.tree.map(lambda *each: _own(contact, list(each)), *soft)


def risen(frame, contact, v, cosine, sine, time):
    """y / time of a mass that enters a wall with the velocity v, to a time no longer than a step."""
    series = _series(frame, contact)
    stay, move, lift, lag = (flow.horner(rows, time) for rows in series)
    force = frame.force * cosine, frame.force * sine
    dy, _ = rested(frame, contact, cosine, stay * time, 0.0 * time)
    found = v * move + time * (force[0] * lift - force[1] * (time * lag)) + dy
    terms = drive.waves(frame.terms, frame.frequency, cosine, sine)
    for (along, across, _), rows in zip(terms, _terms(frame, contact), strict=True):
        lift, lag = (flow.horner(each, time) for each in rows[2:])
        found = found + time * (along * lift - across * (time * lag))
    if moves(frame):
        along, across, _ = wave(frame, contact, cosine, sine)
        span = choose(_is_moved(frame, contact), time, 0.0)
        _, _, lift, lag = (flow.horner(rows, span) for rows in _waves(frame, contact))
        found = found + time * (along * lift - across * (time * lag))
    return found


def gone(frame, contact, v, cosine, sine, time):
    """y' of a mass that enters a wall with the velocity v, after a time no longer than a step."""
    stay, move, lift, lag, _, _ = flow.gains(_series(frame, contact), frame.frequency, time)
    forced = frame.force * cosine * (move - frame.frequency * lag) - frame.force * sine * (frame.frequency * lift)
    _, dv = rested(frame, contact, cosine, stay, move)
    found = (1.0 + stay - 2.0 * frame.damping * move) * v + forced + dv
    if waved(frame):
        given = forces(frame, contact, cosine, sine)
        for (along, across, rate), (lift, lag) in zip(given, waves(frame, contact, time), strict=True):
            found = found + along * (move - rate * lag) - across * (rate * lift)
    return found
