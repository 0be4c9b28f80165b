"""The numbers of a scene and a start as a vector, for derivatives by differences."""

from itertools import islice

from .scene import Scene


def names(scene):
    """The names of the numbers, in the order of every vector here.

    x, v, phase (the drive's at the start), gamma, omega, amplitude; then for the left wall and the right one, where
    there is one, position, restitution and, where it moves, motion.amplitude, motion.phase: "left.motion.phase".
    """
    found = ["x", "v", "phase", "gamma", "omega", "amplitude"]
    for side, wall in scene.walls():
        own = ["position", "restitution", *(["motion.amplitude", "motion.phase"] if wall.motion else [])]
        found += [f"{'left' if side < 0 else 'right'}.{name}" for name in own]
    return found


def numbers(draw):
    """The values of a draw (scene, x, v, phase), in the order of `names`."""
    scene, *state = draw
    return [
        *state,
        *scene[:3],
        *(value for _, wall in scene.walls() for value in (*wall[:2], *(wall.motion or ())[:2])),
    ]


def with_numbers(draw, values):
    """(scene, x, v, phase) of the draw's structure with other values, in the order of `names`."""
    scene, left = draw[0], iter(values)
    x, v, phase, *plain = islice(left, 6)
    walls = []
    for wall in (scene.left, scene.right):
        if wall is not None:
            wall = wall._replace(position=next(left), restitution=next(left))
            if wall.motion is not None:
                wall = wall._replace(motion=wall.motion._replace(amplitude=next(left), phase=next(left)))
        walls.append(wall)
    return Scene(*plain, *walls), x, v, phase
