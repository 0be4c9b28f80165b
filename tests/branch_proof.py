"""Random scenes and their branches, for the scripts that still draw them here. Remove it with the last of them."""

import jaxvibro as jv
from tests.truths import plain

__all__ = ["branches", "plain", "scene_of"]
NAMES = ("amplitude", "frequency", "damping", "restitution", "right.position", "right.motion.amplitude")


def scene_of(rng):
    """A random scene: two walls or one, R per wall, perhaps a moving right wall."""
    gamma, omega, amplitude = rng.uniform((0.02, 0.5, 0.3), (0.3, 3.2, 6.0))
    if rng.random() < 0.15:
        gamma = rng.uniform(0.3, 1.4)
    left, right = -rng.uniform(0.3, 1.5), rng.uniform(-0.1, 1.5)
    own = None if rng.random() < 0.5 else rng.uniform(0.3, 0.95)
    kind = rng.integers(4)
    motion = jv.Motion(rng.uniform(0.05, 0.25), rng.uniform(0, 6.28)) if kind == 2 else None
    walls = (None if kind == 3 else jv.Wall(left, own), jv.Wall(right, motion=motion))
    if kind == 0:
        walls = (jv.Wall(-1.0), jv.Wall(1.0))
    return jv.make_scene(amplitude, omega, gamma, rng.uniform(0.5, 0.9), walls)


def branches(rng, count, **settings):
    """(branch, orbit) of so many random scenes that settle on an orbit that can be followed."""
    found = 0
    while found < count:
        scene = scene_of(rng)
        name = NAMES[rng.choice(len(NAMES), p=(0.5, 0.15, 0.1, 0.1, 0.1, 0.05))]
        if name not in scene.names:
            name = "amplitude"
        start = jv.State(float(scene.right.position) - 0.1, 0.0)
        try:
            orbit = jv.find_orbit(scene, start)
            if orbit.periods > 4 or orbit.impacts.count > 8:
                continue
            value = float(scene.parameter(name))
            low, high = (0.0, 1.0) if "rest" in name else (0.5 * value - 0.2, 1.8 * value + 0.3)
            branch = jv.follow(orbit, name, (low, high), **settings)
        except (jv.OrbitError, jv.ArgumentError) as error:
            print("  skipped:", str(error)[:100])
            continue
        found += 1
        yield branch, orbit
