"""The walls where the mass meets them, for the equations of the impacts."""

from ..flight.flows import flow_of
from ..flight.wall import course_on, picked


def way(frame, sides, cosine, sine, order=2):
    """Position, velocity and further derivatives of the walls on these sides, arrays of their shape."""
    found = course_on(frame, sides, cosine, sine, order)
    return [0.0 * sides if each is None else each + 0.0 * sides for each in found]


def pressed(frame, sides, phasor, order=1):
    """How hard a mass that rests on the walls on these sides is driven along x relative to them, and its derivatives
    up to an order."""
    found = [flow_of(frame).press(frame, wall, *phasor, order)[: order + 1] for wall in frame.walls]
    return picked(sides, frame.walls, found)
