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
from . import flow, impact_log, lean_event, lean_motion, lean_tangent, lean_turns
from .lean_event import MARGIN
from .lean_numbers import GIVEN_UP, Lanes
from .wall import course, less

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


def run(numbers, lanes, log, slots, shifts=(), tangents=(), clearance=False):
    """(lanes, log, slots, tangents, the least clearance, None where it was not asked for) when no lane has time left;
    one that needs too many steps is given up.

    shifts, tangents: the directions in which `lean_tangent` carries derivatives along, and how those begin.
    """
    few = len(slots.times) <= impact_log.RECENT
    calls = lean_turns.nothing(lanes.x) if clearance else None
    if clearance:
        lanes = lean_turns.starts(numbers, lanes)

    def step(carry):
        lanes, log, turns, tangents, calls = carry
        lanes, tangents, calls, side, speed = turn(numbers, lanes, turns, shifts, tangents, calls)
        log = impact_log.write(log, side, speed, speed, stage(_rest, numbers, lanes.left))
        return lanes, log, turns + 1.0, tangents, calls

    def going(carry):
        return jnp.any(carry[0].left > 0)

    def runs(carry):
        stops = lax.full_like(carry[0].left, False, dtype=bool) if few else impact_log.is_full(carry[1])
        if clearance:
            stops |= lean_turns.is_crowded(carry[4])
        return going(carry) & ~jnp.any(stops)

    def leg(carry):
        (lanes, log, turns, tangents, calls), slots = lax.while_loop(runs, step, carry[0]), carry[1]
        if not few:
            log, slots = impact_log.pour(log, slots)
        if clearance:
            calls, left = lean_turns.measure(numbers, lanes.left, calls)
            lanes = lanes._replace(left=left)
        return (lanes, log, turns, tangents, calls), slots

    def pending(carry):
        due = carry[0][0].left > 0
        return jnp.any(due | lean_turns.is_due(carry[0][4])) if clearance else jnp.any(due)

    start = lanes, log, jnp.zeros((), lanes.x.dtype), tangents, calls
    if few and not clearance:
        now = lax.while_loop(going, step, start)
    else:
        now, slots = lax.while_loop(pending, leg, (start, slots))
    lanes, log, _, tangents, calls = now
    if few:
        log, slots = impact_log.pour(log, slots)
    return lanes, log, slots, lean_tangent.ended(numbers, shifts, tangents, lanes), calls.least if clearance else None


def turn(numbers, lanes, turns, shifts=(), tangents=(), calls=None):
    """(lanes, tangents, calls) a step later, the side of the impact at its end, 0: none, the speed against its wall,
    over t.

    turns: the period's steps before this one; calls: the closest calls, None where they are not asked for. A lane that
    has no time left, or was given up, stays as it is.
    """
    before = lanes = lanes._replace(largest=stage(_largest, numbers, lanes))
    forces = stage(lean_motion.forces, numbers, lanes.cosine, lanes.sine)
    hit, root, short, remainder = lean_event.ahead(numbers, lanes, forces)
    time = stage(_time, lanes, hit, root, short)
    gains = stage(flow.gains, numbers.flight, numbers.frequency, time)
    x, v = stage(lean_motion.flown, numbers, lanes.x, lanes.v, forces, gains)
    tangents = lean_tangent.carried(numbers, shifts, tangents, lanes, forces, gains, time)
    drive = stage(flow.turn, lanes.cosine, lanes.sine, gains.versed, gains.sined)
    late = stage(lean_motion.late, numbers, x, v, drive, hit)
    speed = stage(lean_motion.met, numbers, x, v, drive, late)
    cosine, sine = stage(lean_motion.turned, numbers, drive, late)
    closing = stage(_closing, numbers, cosine, sine, hit, speed)
    left = stage(_left, numbers, lanes, turns, short, time, hit, closing, late)
    flown = x, v, *drive, late
    x, v = stage(lean_motion.rebounded, numbers, x, v, (cosine, sine), hit, speed)
    lanes = Lanes(x, v, cosine, sine, left, lanes.largest)
    if calls is not None:
        calls, left = lean_turns.note(numbers, before, lanes, speed, time, late, hit, remainder, calls)
        lanes = lanes._replace(left=left)
    return lanes, lean_tangent.rebounded(numbers, shifts, tangents, lanes, flown, hit, speed), calls, hit, closing


def _largest(numbers, lanes):
    return most(lanes.largest, numbers.size + lax.abs(lanes.x) + lax.abs(lanes.v))


def _rest(numbers, left):
    return left * numbers.reach


def _time(lanes, hit, root, short):
    return choose(lanes.left > 0, choose(hit != 0, root, positive(short)), 0.0)


def _closing(numbers, cosine, sine, side, speed):
    """The speed against the wall that is met, over t."""
    return side * (less(speed, lean_motion.place(numbers, cosine, sine, side)[1]) * numbers.pace)


def _left(numbers, lanes, turns, short, time, side, closing, late):
    """The time left after a step: of a lane in doubt GIVEN_UP."""
    hits, left = side != 0, (lanes.left - time) - late
    sure = choose(hits, lean_motion.restitution(numbers, side) * closing - SLOW * numbers.pace * lanes.largest, short)
    left = choose((left >= 0) & (sure > 0) & (turns < numbers.turns), left, GIVEN_UP)
    return choose(lanes.left > 0, left, lanes.left)
