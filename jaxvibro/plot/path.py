"""A trajectory with its impacts in their places, so that a line through it breaks there."""

import numpy as np

SIGNS = {-1: "left", 1: "right"}


def with_impacts(trajectory, scene):
    """(time, x, v, places) of a Dataset of `simulate`, an impact being three entries: before, nan, after.

    places: the indices of the entries before an impact.
    """
    time, x, v = (trajectory[name].values for name in ("time", "x", "v"))
    at, hit = (trajectory[name].values for name in ("impact_time", "position"))
    side, speed = (trajectory[name].values for name in ("side", "speed"))
    pace, rebound = _walls(scene, side, at, float(trajectory["phase"].values[0]))
    gap = np.full(at.shape, np.nan)
    before, after = pace + side * speed, pace - rebound * side * speed
    # A sample at an impact's time is the state after it, but for the given one at the start.
    places = np.maximum(1, np.searchsorted(time, at, side="left"))
    where = np.repeat(places, 3)

    def put(samples, *three):
        return np.insert(samples, where, np.stack(three, -1).ravel())

    found = places + 3 * np.arange(len(places))
    return put(time, at, at, at), put(x, hit, gap, hit), put(v, before, gap, after), found


def _walls(scene, side, time, phase):
    """(velocity, restitution) of the walls hit at these times."""
    pace, rebound = np.zeros(time.shape), np.zeros(time.shape)
    for sign, name in SIGNS.items():
        wall, here = getattr(scene, name), side == sign
        if wall is None:
            continue
        rebound[here] = float(scene.bounce(name))
        if wall.motion is not None:
            pace[here] = velocity(wall, float(scene.frequency), phase + float(scene.frequency) * time[here])
    return pace, rebound


def position(wall, phase):
    """Where a wall is at phases of the drive."""
    swing = 0.0 if wall.motion is None else _swing(wall, np.cos, phase)
    return float(wall.position) + swing + 0.0 * phase


def velocity(wall, frequency, phase):
    """How fast a moving wall is at phases of the drive."""
    return -wall.motion.harmonic * frequency * _swing(wall, np.sin, phase)


def _swing(wall, wave, phase):
    return float(wall.motion.amplitude) * wave(wall.motion.harmonic * phase + float(wall.motion.phase))
