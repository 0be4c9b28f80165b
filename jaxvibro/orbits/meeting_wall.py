"""The walls where the mass meets them, for the equations of the impacts."""

from ..flight.wall import course_on


def way(frame, sides, cosine, sine, order=2):
    """Position, velocity and further derivatives of the walls on these sides, arrays of their shape."""
    found = course_on(frame, sides, cosine, sine, order)
    return [0.0 * sides if each is None else each + 0.0 * sides for each in found]
