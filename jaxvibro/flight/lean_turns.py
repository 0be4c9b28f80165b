"""How close lean steps come to a wall without touching it: the clearance at the turning points of x - x_b.

The steps are those that a lane flies anyway, so that no bit of its state changes. Whether the speed of x - x_b passes
zero in one is told from that speed and its first two derivatives at both ends: the quintic that has them is written in
Bernstein's form, and how far the speed may be off it is known. Where the coefficients change sign once at most, so does
the speed; a lane where they do more often is in doubt, and given up. A step with a turning point is noted, and measured
when its lane passes the next.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Float

from ..compiled.compiler_hints import choose, least, mask, merge, most, positive, stage
from . import event, flow, lean_event, lean_motion
from .event import TERMS
from .lean_numbers import GIVEN_UP
from .wall import course, less, picked

DOUBT = 2.0  # of a mark, which else is no longer than a step
NEAR = 2.0**-7  # of the longest step: how good the time must be that is worked out from the start of a step
TINY = 2.0**-40  # of a lane's largest length: far over the rounding of a speed over the longest step
OFF = 7.0 / 20.0  # of a remainder: by what the speed may move the quintic's middle coefficient


class Turn(NamedTuple):
    """A step with a turning point: x, v and the drive at its start; span: its length times the wall's sign, 0: none."""

    x: Float[jax.Array, "*lanes"]
    v: Float[jax.Array, "*lanes"]
    cosine: Float[jax.Array, "*lanes"]
    sine: Float[jax.Array, "*lanes"]
    span: Float[jax.Array, "*lanes"]


class Calls(NamedTuple):
    """The least clearance so far, the turning point not yet measured, and that of the last step where there is one."""

    least: Float[jax.Array, "*lanes"]
    noted: Turn
    fresh: Turn


def nothing(lanes):
    """No turning point, for lanes like these."""
    none = jnp.zeros_like(lanes)
    turn = Turn(*[none] * 5)
    return Calls(jnp.full_like(lanes, jnp.inf), turn, turn)


def starts(numbers, lanes):
    """The lanes; given up where a speed against a wall that moves is too near zero to have a sign."""
    return lanes if numbers.still else lanes._replace(left=stage(_started, numbers, lanes))


def _started(numbers, lanes):
    sure = lax.full_like(lanes.x, True, dtype=bool)
    for speed, _, _ in _closings(numbers, lanes.x, lanes.v, lanes.cosine, lanes.sine):
        sure &= lax.abs(speed) > lean_event.MARGIN * lanes.largest
    return choose(sure | (lanes.left <= 0), lanes.left, GIVEN_UP)


def note(numbers, before, after, met, time, late, hit, remainder, calls):
    """(calls, the time left) after a step, in doubt GIVEN_UP. before, after: its `Lanes`; met: v before an impact."""
    new = stage(_mark, numbers, before, after, met, time, late, hit, remainder)
    take, second = stage(_shared, calls.noted.span, new)
    here = before.x, before.v, before.cosine, before.sine
    first = Turn(*(merge(take, new, old) for new, old in zip((*here, new), calls.noted, strict=True)))
    return Calls(calls.least, first, Turn(*here, second)), stage(_doubted, new, after.left)


def _shared(noted, new):
    """The lanes that have no other noted, and the spans of those that have."""
    counts = lax.abs(new) < DOUBT
    return mask((noted == 0) & (new != 0) & counts, new), choose((noted != 0) & counts, new, 0.0)


def _doubted(new, left):
    return choose(new == DOUBT, GIVEN_UP, left)


def is_crowded(calls):
    """The lanes that have passed a turning point while another is noted: then `measure` is due."""
    return calls.fresh.span != 0


def is_due(calls):
    """The lanes that have a turning point to be measured."""
    return calls.noted.span != 0


def _closings(numbers, x, v, cosine, sine):
    """The speeds that are watched, with two derivatives: those against the walls that move, or x', which still walls
    share."""
    pulled = lean_motion.pull(numbers, x, v, (cosine, sine))
    jerk = lean_motion.jerk(numbers, v, pulled, sine)
    if numbers.still:
        return [(v, pulled, jerk)]
    ways = [course(wall, numbers.frequency, cosine, sine, 3)[1:] for wall in numbers.walls]
    return [
        tuple(wall.sign * less(own, other) for own, other in zip((v, pulled, jerk), way, strict=True))
        for wall, way in zip(numbers.walls, ways, strict=True)
    ]


def _mark(numbers, before, after, met, time, late, hit, remainder):
    """The span of a step's turning point, 0 where there is none, DOUBT where that is not certain.

    A step that meets a still wall has none: it is certain that x - x_b rises throughout.
    """
    starts = _closings(numbers, before.x, before.v, before.cosine, before.sine)
    ends = _closings(numbers, after.x, met, after.cosine, after.sine)
    time = time + late
    total, sure = lax.full_like(time, 0.0), lax.full_like(time, True, dtype=bool)
    over = after.left == 0
    for k, (start, end) in enumerate(zip(starts, ends, strict=True)):
        bound = remainder if numbers.still else remainder + numbers.sway[k]
        way, single = _single(start, end, time, OFF * bound, TINY * before.largest)
        turns = way * end[0] <= 0
        sure &= single & ~(over & (lax.abs(end[0]) <= lean_event.MARGIN * before.largest))
        if numbers.still and len(numbers.walls) == 2:
            side = way
        else:
            sign = float(numbers.walls[k].sign)
            side, turns = sign, turns & ((way == sign) if numbers.still else (way > 0))
        sure &= ~turns | (total == 0)
        total = choose(turns, side * time, total)
    flies = before.left > 0
    if numbers.still:
        flies &= hit == 0
    return choose(flies, choose(sure, total, DOUBT), 0.0)


def _single(start, end, time, off, tiny):
    """(the sign that a speed begins with, whether it certainly changes sign once at most) over a step.

    Of the quintic with its values and two derivatives at both ends, in Bernstein's form of degree 6: the speed differs
    from it by at most 20 off t^3 (1 - t)^3, `off` in the middle coefficient. The first is not negative.
    """
    square = time * time
    off = off * (square * square * square)
    way = lax.sign(choose(start[0] == 0, start[1], start[0]))
    (u, a, j), (w, b, i) = (
        (way * speed, (way * time) * pull, (way * square) * jerk) for speed, pull, jerk in (start, end)
    )
    middle = 0.5 * (u + w) + 0.2 * (a - b) + (1 / 40) * (j + i)
    early, late = u + (1 / 3) * a + (1 / 30) * j, w - (1 / 3) * b + (1 / 30) * i
    first, last = u + (1 / 6) * a, w - (1 / 6) * b
    falls = least(most(first, -early), most(early, -(middle + off)))
    falls = least(falls, least(most(middle - off, -late), most(late, -last)))
    return way, least(falls, most(last, -w)) > tiny


def measure(numbers, left, calls):
    """(calls, the time left, in doubt GIVEN_UP) with what is noted measured; noted is then what is fresh.

    The time is found on the polynomial of the step's start, to less than NEAR; from the motion there by a step of
    Halley's and one of Newton's.
    """
    turn = calls.noted
    side, forces = stage(_side, turn.span), stage(lean_motion.forces, numbers, turn.cosine, turn.sine)
    waves = lean_event.waves(numbers, turn)
    speeds = [stage(_speed, numbers, turn, forces, waves, side, k=k) for k in range(1, TERMS)]
    time = stage(_crossed, speeds, turn.span)
    for _ in range(2):
        time = stage(_halley_on, speeds, time, turn.span)
    gains = stage(flow.gains, numbers.flight, numbers.frequency, time)
    x, v = stage(lean_motion.flown, numbers, turn.x, turn.v, forces, gains)
    drive = stage(flow.turn, turn.cosine, turn.sine, gains.versed, gains.sined)
    near = [stage(_derivative, numbers, x, v, drive, side, k=k) for k in range(6)]
    first = stage(_halley, *near[1:4])
    found = stage(_found, near, first, time, turn.span)
    closest, left = stage(_closest, calls.least, turn.span, found), stage(_kept, left, turn.span, found)
    fresh = calls.fresh
    return Calls(closest, fresh, fresh._replace(span=jnp.zeros_like(fresh.span))), left


def _side(span):
    return choose(span < 0, lax.full_like(span, -1.0), 1.0)


def _speed(numbers, turn, forces, waves, side, k):
    """The Taylor coefficients of the speed against the wall, from the first term of the progress on."""
    return float(k) * lean_event.term(numbers, turn, forces, waves, side, k)


def _crossed(speeds, span):
    """Where the quadratic with the speeds at both ends and the first slope passes zero: within the step, once."""
    time = lax.abs(span)
    end, start, slope = event.horner(speeds, time)[0], speeds[0], speeds[1] * time
    inside = slope * slope + 4.0 * start * ((slope + start) - end)
    return 2.0 * time * (start / (lax.sqrt(positive(inside)) - slope))


def _halley_on(speeds, time, span):
    value, slope = event.horner(speeds, time)
    bend = event.horner([float(k) * term for k, term in enumerate(speeds)][1:], time)[1]
    return lax.clamp(lax.full_like(span, 0.0), time + _halley(value, slope, bend), lax.abs(span))


def _halley(value, slope, bend):
    return -2.0 * value * slope / (2.0 * slope * slope - value * bend)


def _derivative(numbers, x, v, drive, side, k):
    """The k-th derivative of the progress towards the wall on a side."""
    forces = [numbers.force * drive[0], -(numbers.frequency * numbers.force) * drive[1]]
    found = [x, v]
    for j in range(k - 1):
        if j > 1:
            forces.append(-(numbers.frequency * numbers.frequency) * forces[j - 2])
        found.append(forces[j] - numbers.stiffness * found[j] - numbers.drag * found[j + 1])
    ways = [course(wall, numbers.frequency, *drive, max(k, 1)) for wall in numbers.walls]
    return side * less(found[k], picked(side, numbers.walls, ways)[k])


def _found(near, first, time, span):
    """The clearance at the turning point, -1 where that is not certain."""
    place, speed, pull, jerk, snap, next_ = near
    slope = pull + first * (jerk + first * (0.5 * snap + first * (next_ / 6.0)))
    value = speed + first * (pull + first * (0.5 * jerk + first * (snap / 6.0 + first * (next_ / 24.0))))
    second = -value / slope
    step = first + second
    rise = pull / 2.0 + step * (jerk / 6.0 + step * (snap / 24.0 + step * (next_ / 120.0)))
    size, edge = lax.abs(first), NEAR * NEAR * NEAR
    sure = (size <= NEAR) & (lax.abs(second) <= NEAR * (size + edge)) & (8.0 * size * lax.abs(jerk) <= -pull)
    sure &= (time + step >= -edge) & (time + step <= lax.abs(span) + edge)
    return choose(sure, -(place + step * (speed + step * rise)), -1.0)


def _closest(closest, span, found):
    return choose((span != 0) & (found >= 0), least(found, closest), closest)


def _kept(left, span, found):
    return choose((span == 0) | (found >= 0), left, GIVEN_UP)
