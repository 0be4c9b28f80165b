"""The walls where the mass meets them, for the equations of the impacts."""

from ..flight.wall import course, picked


def way(frame, sides, cosine, sine):
    """Position, velocity and acceleration of the walls on these sides."""
    ways = [course(wall, frame.frequency, cosine, sine, 2) for wall in frame.walls]
    return [0.0 * sides if each is None else each + 0.0 * sides for each in picked(sides, frame.walls, ways)]
