"""How lanes move in a lean step: the flight, the little that is left to an event, and the wall that is met there.

Times are in longest steps; a drive is its cosine and its sine.
"""

from ..compiled.compiler_hints import choose
from . import flow
from .wall import chosen, course, less, picked


def forces(numbers, cosine, sine):
    """The drive's force, and its part in quadrature."""
    return numbers.force * cosine, numbers.force * sine


def flown(numbers, x, v, forces, gains):
    """(x, v) after a flight, as `flight_state.moved` with no swift part."""
    along, across = forces
    stay, move, lift, lag = gains[:4]
    dx = stay * x + (move * v + (along * lift - across * lag))
    forced = along * (move - numbers.frequency * lag) - across * (numbers.frequency * lift)
    dv = (stay - numbers.drag * move) * v + (forced - move * (numbers.stiffness * x))
    return x + dx, v + dv


def late(numbers, x, v, drive, side):
    """How much later than the end of a step its event is: one step of Halley's (`impact.late`)."""
    ways = [course(wall, numbers.frequency, *drive, 2) for wall in numbers.walls]
    where, speed, bend = picked(side, numbers.walls, ways)
    inverse = 1.0 / less(v, speed)
    time = (where - x) * inverse
    time = time * (1.0 - 0.5 * less(pull(numbers, x, v, drive), bend) * time * inverse)
    return choose(side != 0, time, 0.0)


def pull(numbers, x, v, drive):
    """The acceleration."""
    return numbers.force * drive[0] - numbers.stiffness * x - numbers.drag * v


def jerk(numbers, v, pulled, sine):
    """The change of the acceleration."""
    return -(numbers.frequency * numbers.force) * sine - numbers.stiffness * v - numbers.drag * pulled


def met(numbers, x, v, drive, late):
    """The speed at an event so much later than the end of a step."""
    pulled = pull(numbers, x, v, drive)
    return v + late * (pulled + 0.5 * late * jerk(numbers, v, pulled, drive[1]))


def turned(numbers, drive, late):
    """The drive's cosine and sine so much later."""
    angle = numbers.frequency * late
    return flow.turn(*drive, -0.5 * angle * angle, angle)


def place(numbers, cosine, sine, side):
    """Where the wall on a side is, and its speed."""
    return picked(side, numbers.walls, [course(wall, numbers.frequency, cosine, sine, 1) for wall in numbers.walls])


def restitution(numbers, side):
    """Of the wall on a side."""
    return chosen(side, numbers.walls, [wall.restitution for wall in numbers.walls])


def rebounded(numbers, x, v, drive, side, met):
    """(x, v) after the event of a step, if it has one, at the speed that was met."""
    where, speed = place(numbers, *drive, side)
    hits, again = side != 0, restitution(numbers, side)
    after = -again * met if speed is None else speed - again * (met - speed)
    return choose(hits, where, x), choose(hits, after, v)
