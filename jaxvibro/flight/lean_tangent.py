"""Derivatives that lean steps carry along: how x and v move, at the same time, where the numbers move in a direction.

A flight of a given time is linear in x and v. An impact on a wall, x_b and v_b, comes later by

    d = (dx_b - dx) / u,    u = v- - v_b,

and leaves, brought back to the time of the old one (the saltation matrix; paper, (36)),

    dx+ = (1 + R) dx_b - R dx,    dv+ = (1 + R) dv_b - R dv - R' u + d ((1 + R) a_b - R a- - a+),

a-, a+ the accelerations before and after, a_b the wall's. `lean_motion` is differentiated for the rest, by the numbers
that move alone.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Float

from ..compiled.compiler_hints import choose, stage
from . import flow, lean_motion
from .lean_numbers import Numbers
from .wall import Lane, chosen, course, less, picked


class Shift(NamedTuple):
    """How fast the numbers of lanes move in a direction, None for what stands still. numbers: as `lean_numbers.numbers`
    has them, walls as its walls; phase: the drive's, at the start; period: the time to the end."""

    numbers: Numbers
    phase: Float[jax.Array, "..."] | None
    period: Float[jax.Array, "..."] | None


class Tangent(NamedTuple):
    """How fast x and v move, v over the longest step."""

    x: Float[jax.Array, "*lanes"]
    v: Float[jax.Array, "*lanes"]


def shift(numbers, scene, rates, phase):
    """The `Shift` where a scene's numbers move at the rates of a scene, and the phase at a rate; None: not at all."""
    force, frequency, drag = rates.amplitude, rates.frequency, rates.damping
    if force is not None:
        force = force * numbers.stiffness
    if frequency is not None:
        frequency = frequency * numbers.reach
    if drag is not None:
        drag = 2.0 * drag * numbers.reach
    given = zip((-1, 1), (scene.left, scene.right), (rates.left, rates.right), strict=True)
    still = Numbers(*[None] * len(Numbers._fields))
    moving = still._replace(
        force=force,
        frequency=frequency,
        drag=drag,
        flight=_flight(numbers, frequency, drag),
        walls=tuple(_wall(side, wall, rate, rates.restitution) for side, wall, rate in given if wall is not None),
    )
    period = None if frequency is None else -(numbers.period / numbers.frequency) * frequency
    return Shift(moving, phase, period)


def _flight(numbers, frequency, drag):
    """The rates of the flow's coefficients; the free flow's do not know the drive."""
    if frequency is None and drag is None:
        return None
    half = None if drag is None else 0.5 * drag
    values = numbers.frequency, 0.5 * numbers.drag, numbers.stiffness
    moved = flow.shortened(pushed(flow.series, values, (frequency, half, None)))
    return moved if drag is not None else moved._replace(stay=None, move=None)


def _wall(side, wall, rate, restitution):
    own = rate.restitution if wall.restitution is not None else restitution
    moves = {"swing": None, "cosine": None, "sine": None}
    harmonic = 1
    if wall.motion is not None:
        harmonic, turn = wall.motion.harmonic, rate.motion.phase
        moves["swing"] = rate.motion.amplitude
        if turn is not None:
            phase = jnp.asarray(wall.motion.phase)
            moves["cosine"], moves["sine"] = -jnp.sin(phase) * turn, jnp.cos(phase) * turn
    return Lane(rate.position, own, sign=side, harmonic=harmonic, **moves)


def pushed(function, values, rates):
    """The derivative of function(*values) where parts of the values move at these rates; None: not at all."""
    flat, tree = jax.tree.flatten(values)
    moves = []

    def spread(rate, part):
        moves.extend([None] * len(jax.tree.leaves(part)) if rate is None else [rate])

    jax.tree.map(spread, rates, values, is_leaf=lambda rate: rate is None)
    moving = [k for k, rate in enumerate(moves) if rate is not None]

    def of(*moved):
        full = list(flat)
        for k, value in zip(moving, moved, strict=True):
            full[k] = value
        return function(*tree.unflatten(full))

    given = [jnp.broadcast_to(moves[k], jnp.shape(flat[k])) for k in moving]
    return jax.jvp(of, [flat[k] for k in moving], given)[1]


def carried(numbers, shifts, tangents, before, forces, gains, time):
    """The tangents after the flight of a step, whose lanes and forces were these before it."""
    elapsed = stage(_elapsed, numbers, before.left)
    lanes = before.x, before.v, before.cosine, before.sine, forces, gains, time, elapsed
    return tuple(
        stage(_carried, numbers, each, tangent, *lanes) for each, tangent in zip(shifts, tangents, strict=True)
    )


def _elapsed(numbers, left):
    return numbers.period - left


def _angle(shift, elapsed):
    """How fast the drive's angle moves, so long after the start."""
    if shift.numbers.frequency is None:
        return shift.phase
    angle = shift.numbers.frequency * elapsed
    return angle if shift.phase is None else angle + shift.phase


def _drive(cosine, sine, angle):
    """The rates of the drive's cosine and sine where its angle moves."""
    return (None, None) if angle is None else (-sine * angle, cosine * angle)


def _carried(numbers, shift, tangent, x, v, cosine, sine, forces, gains, time, elapsed):
    moving, drive = shift.numbers, _drive(cosine, sine, _angle(shift, elapsed))
    force = None, None
    if moving.force is not None or drive[0] is not None:
        force = pushed(lean_motion.forces, (numbers, cosine, sine), (moving, *drive))
    gain = _gains(moving.flight, time)
    return Tangent(
        *pushed(lean_motion.flown, (numbers, x, v, forces, gains), (moving, tangent.x, tangent.v, force, gain))
    )


def _gains(series, time):
    """The rates of a flight's `flow.Gains`."""
    none = flow.Gains(*[None] * 6)
    if series is None:
        return none
    square = time * time
    lift, lag = flow.lifts(series, time)
    none = none._replace(lift=lift, lag=lag)
    if series.stay is None:
        return none
    return none._replace(stay=flow.horner(series.stay, time) * square, move=flow.horner(series.move, time) * time)


def rebounded(numbers, shifts, tangents, lanes, flown, side, met):
    """The tangents after the event of a step, if it has one.

    flown: x, v, the drive's cosine and sine at the end of the flight, how much later the event is; lanes: x, v, and
    the drive after the event, and the time left; met: the speed at the event.
    """
    elapsed = stage(_elapsed, numbers, lanes.left)
    kick = stage(_kick, numbers, lanes.v, lanes.cosine, lanes.sine, side, met)
    given = flown, side, lanes.cosine, lanes.sine, elapsed, kick
    return tuple(
        stage(_rebounded, numbers, each, tangent, *given) for each, tangent in zip(shifts, tangents, strict=True)
    )


def _kick(numbers, after, cosine, sine, side, met):
    """(u, 1 / u, (1 + R) a_b - R a- - a+) of an impact."""
    ways = [course(wall, numbers.frequency, cosine, sine, 2) for wall in numbers.walls]
    where, speed, bend = picked(side, numbers.walls, ways)
    again = lean_motion.restitution(numbers, side)
    before, behind = (lean_motion.pull(numbers, where, v, (cosine, sine)) for v in (met, after))
    closing, jump = less(met, speed), -again * before - behind
    return closing, 1.0 / closing, jump if bend is None else jump + (1.0 + again) * bend


def _rebounded(numbers, shift, tangent, flown, side, cosine, sine, elapsed, kick):
    moving, (*given, late), (closing, inverse, jump) = shift.numbers, flown, kick
    angle = _angle(shift, elapsed)
    before = angle if moving.frequency is None else angle - moving.frequency * late
    rates = moving, tangent.x, tangent.v, _drive(given[2], given[3], before), None
    x, v = pushed(_reached, (numbers, *given[:2], tuple(given[2:]), late), rates)
    hits, again = side != 0, lean_motion.restitution(numbers, side)
    own = _restitution(numbers, moving, side)
    where, speed = _place(numbers, moving, (cosine, sine), _drive(cosine, sine, angle), side)
    away = less(-x, None if where is None else -where)
    v = -again * v + (away * inverse) * jump
    x = -again * x
    if own is not None:
        v = v - own * closing
    if where is not None:
        x = x + (1.0 + again) * where
    if speed is not None:
        v = v + (1.0 + again) * speed
    return Tangent(choose(hits, x, tangent.x), choose(hits, v, tangent.v))


def _reached(numbers, x, v, drive, late):
    """(x, v) at an event so much later than the end of a step."""
    pulled = lean_motion.pull(numbers, x, v, drive)
    return x + late * (v + 0.5 * late * pulled), lean_motion.met(numbers, x, v, drive, late)


def _restitution(numbers, moving, side):
    """How fast the restitution of the wall on a side moves."""
    return chosen(side, numbers.walls, [wall.restitution for wall in moving.walls])


def _place(numbers, moving, drive, rates, side):
    """How fast the wall on a side and its speed move."""

    def of(wall, rate):
        if wall.swing is None:
            return rate.position, None
        own = rate.position, rate.swing, rate.cosine, rate.sine, moving.frequency, rates[0]
        if all(each is None for each in own):
            return None, None

        def placed(wall, frequency, cosine, sine):
            return course(wall, frequency, cosine, sine, 1)

        return tuple(pushed(placed, (wall, numbers.frequency, *drive), (rate, moving.frequency, *rates)))

    return picked(side, numbers.walls, [of(*pair) for pair in zip(numbers.walls, moving.walls, strict=True)])


def ended(numbers, shifts, tangents, lanes):
    """The tangents at the end of a period that gets longer where the frequency moves."""
    return tuple(_ended(numbers, *pair, lanes) for pair in zip(shifts, tangents, strict=True))


def _ended(numbers, shift, tangent, lanes):
    if shift.period is None:
        return tangent
    pulled = lean_motion.pull(numbers, lanes.x, lanes.v, (lanes.cosine, lanes.sine))
    return Tangent(tangent.x + shift.period * lanes.v, tangent.v + shift.period * pulled)
