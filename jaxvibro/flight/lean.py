"""The lean tier: certified steps between rigid walls, for lanes whose events are far from doubt.

A step here is one of `step.micro` with less to decide. Each test keeps a margin that is far wider than any rounding of
a flight: a lane that comes nearer to a doubt than that, as by a near grazing, a slow impact, a contact at a period's
end or a start on a wall, is given up, never decided. The full tier then does its period again (docs/numbers.md).

Time is counted in the longest step, so that the numbers of the oscillator are small and of no unit: a speed is the
length that it covers in one such step.
"""

import jax.numpy as jnp
from jax import lax

from ..compiled.compiler_hints import choose, least, most, positive, stage
from ..scene.codes import Contact
from . import flow, impact_log, lean_event
from .lean_event import MARGIN
from .lean_numbers import GIVEN_UP, Lanes
from .wall import chosen, course, less, picked

SLOW = 2.0**-9  # of a lane's largest length a longest step: an impact that leaves more slowly is in doubt


def begin(numbers, path, goes):
    """The `Lanes` that a `Path` begins a period with, those that go: given up where they are in doubt at once."""
    return stage(_begun, numbers, path.x, path.v, path.cosine, path.sine, path.contact, goes)


def _begun(numbers, x, v, cosine, sine, contact, goes):
    none = lax.full_like(x, 0.0)
    v = v * numbers.reach
    lanes = Lanes(x, v, cosine + none, sine + none, none, numbers.size + lax.abs(x) + lax.abs(v))
    clear = lax.full_like(x, jnp.inf)
    leaves = lax.full_like(x, False, dtype=bool)
    for wall in numbers.walls:
        where, speed = course(wall, numbers.frequency, cosine, sine, 1)
        away = -wall.sign * less(v, speed)
        leaves |= (contact == wall.sign * Contact.LANDED) & (away > SLOW * lanes.largest)
        own = choose(contact == wall.sign * Contact.LANDED, jnp.inf, wall.sign * (where - x))
        clear = least(clear, own)
    sure = (clear > MARGIN * lanes.largest) & ((contact == 0) | leaves)
    return lanes._replace(left=choose(goes, choose(sure, numbers.period, GIVEN_UP), 0.0))


def run(numbers, lanes, log, slots):
    """(lanes, log, slots) when no lane has time left; one that needs too many steps is given up."""

    def step(carry):
        lanes, log, turns = carry
        lanes, side, speed = turn(numbers, lanes, turns)
        return lanes, impact_log.write(log, side, speed, speed, stage(_rest, numbers, lanes.left)), turns + 1.0

    def going(carry):
        return jnp.any(carry[0].left > 0)

    start = lanes, log, jnp.zeros((), lanes.x.dtype)
    if len(slots.times) <= impact_log.RECENT:
        lanes, log, _ = lax.while_loop(going, step, start)
        return lanes, *impact_log.pour(log, slots)

    def leg(carry):
        lanes, log, turns = lax.while_loop(
            lambda now: going(now) & ~jnp.any(impact_log.is_full(now[1])), step, carry[:3]
        )
        log, slots = impact_log.pour(log, carry[3])
        return lanes, log, turns, slots

    lanes, log, _, slots = lax.while_loop(going, leg, (*start, slots))
    return lanes, log, slots


def turn(numbers, lanes, turns):
    """(the lanes a step later, the side of the impact at its end, 0: none, the speed against its wall, over t).

    turns: the period's steps before this one. A lane that has no time left, or was given up, stays as it is.
    """
    lanes = lanes._replace(largest=stage(_largest, numbers, lanes))
    drive = stage(_drive, numbers, lanes)
    hit, root, short = lean_event.ahead(numbers, lanes, drive)
    time = stage(_time, lanes, hit, root, short)
    gains = stage(flow.gains, numbers.series, numbers.frequency, time)
    x, v = stage(_flown, numbers, lanes, drive, gains)
    drive = stage(flow.turn, lanes.cosine, lanes.sine, gains.versed, gains.sined)
    late = stage(_late, numbers, x, v, drive, hit)
    speed = stage(_met, numbers, x, v, drive, late)
    cosine, sine = stage(_turned, numbers, drive, late)
    closing = stage(_closing, numbers, cosine, sine, hit, speed)
    left = stage(_left, numbers, lanes, turns, short, time, hit, closing, late)
    x, v = stage(_after, numbers, x, v, cosine, sine, hit, speed)
    return Lanes(x, v, cosine, sine, left, lanes.largest), hit, closing


def _largest(numbers, lanes):
    return most(lanes.largest, numbers.size + lax.abs(lanes.x) + lax.abs(lanes.v))


def _rest(numbers, left):
    return left * numbers.reach


def _drive(numbers, lanes):
    """The drive's force, and its part in quadrature."""
    return numbers.force * lanes.cosine, numbers.force * lanes.sine


def _time(lanes, hit, root, short):
    return choose(lanes.left > 0, choose(hit != 0, root, positive(short)), 0.0)


def _flown(numbers, lanes, drive, gains):
    """(x, v) after a flight, as `flight_state.moved` with no swift part."""
    along, across = drive
    stay, move, lift, lag = gains[:4]
    dx = stay * lanes.x + (move * lanes.v + (along * lift - across * lag))
    forced = along * (move - numbers.frequency * lag) - across * (numbers.frequency * lift)
    dv = (stay - numbers.drag * move) * lanes.v + (forced - move * (numbers.stiffness * lanes.x))
    return lanes.x + dx, lanes.v + dv


def _late(numbers, x, v, drive, side):
    """How much later than the end of a step its event is: one step of Halley's (`impact.late`)."""
    ways = [course(wall, numbers.frequency, *drive, 2) for wall in numbers.walls]
    where, speed, bend = picked(side, numbers.walls, ways)
    inverse = 1.0 / less(v, speed)
    time = (where - x) * inverse
    time = time * (1.0 - 0.5 * less(_pull(numbers, x, v, drive), bend) * time * inverse)
    return choose(side != 0, time, 0.0)


def _pull(numbers, x, v, drive):
    return numbers.force * drive[0] - numbers.stiffness * x - numbers.drag * v


def _met(numbers, x, v, drive, late):
    """The speed at an event so much later than the end of a step."""
    pull = _pull(numbers, x, v, drive)
    jerk = -(numbers.frequency * numbers.force) * drive[1] - numbers.stiffness * v - numbers.drag * pull
    return v + late * (pull + 0.5 * late * jerk)


def _turned(numbers, drive, late):
    angle = numbers.frequency * late
    return flow.turn(*drive, -0.5 * angle * angle, angle)


def _closing(numbers, cosine, sine, side, speed):
    """The speed against the wall that is met, over t."""
    return side * (less(speed, _place(numbers, cosine, sine, side)[1]) * numbers.pace)


def _place(numbers, cosine, sine, side):
    """Where the wall on a side is, and its speed."""
    return picked(side, numbers.walls, [course(wall, numbers.frequency, cosine, sine, 1) for wall in numbers.walls])


def _restitution(numbers, side):
    return chosen(side, numbers.walls, [wall.restitution for wall in numbers.walls])


def _left(numbers, lanes, turns, short, time, side, closing, late):
    """The time left after a step: of a lane in doubt GIVEN_UP."""
    hits, left = side != 0, (lanes.left - time) - late
    sure = choose(hits, _restitution(numbers, side) * closing - SLOW * numbers.pace * lanes.largest, short)
    left = choose((left >= 0) & (sure > 0) & (turns < numbers.turns), left, GIVEN_UP)
    return choose(lanes.left > 0, left, lanes.left)


def _after(numbers, x, v, cosine, sine, side, met):
    """(x, v) after the event of a step, if it has one, at the speed that was met."""
    where, speed = _place(numbers, cosine, sine, side)
    hits, again = side != 0, _restitution(numbers, side)
    after = -again * met if speed is None else speed - again * (met - speed)
    return choose(hits, where, x), choose(hits, after, v)
