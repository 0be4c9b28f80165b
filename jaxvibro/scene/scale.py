"""How large the motion of a scene is, before any of it is known."""


def swift(frequency, damping, force):
    """The amplitude of the swift part."""
    return -force / (1.0 + frequency * frequency + 2.0 * damping * frequency)


def scene_length(scene):
    """A length to measure speeds and lengths by: the farther wall's distance; where that is small beside the motion, or
    there is none, the size of the swift part of the response to the drive (`swift`), 1 at rest."""
    found = max((abs(float(wall.position)) for wall in scene.walls.values()), default=0.0)
    size = abs(swift(*map(float, (scene.frequency, scene.damping, scene.amplitude))))
    return found if found > 0.3 * size else (size or 1.0)
