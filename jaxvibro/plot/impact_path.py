"""Insert the impacts of a trajectory between its samples, so that lines break there."""

import numpy as np

SIDE_NAMES = {-1: "left", 1: "right"}


def insert_impacts(trajectory, scene):
    """Return (time, x, v, indices) of a Dataset of `simulate`, with three entries per impact: before, nan, after.

    `indices` are those of the entries before the impacts.
    """
    time, x, v = (trajectory[name].values for name in ("time", "x", "v"))
    impact_times, impact_positions = (trajectory[name].values for name in ("impact_time", "position"))
    side, speed = (trajectory[name].values for name in ("side", "speed"))
    wall_velocities, restitutions = _wall_data(scene, side, impact_times, float(trajectory["phase"].values[0]))
    breaks = np.full(impact_times.shape, np.nan)
    velocities_before, velocities_after = wall_velocities + side * speed, wall_velocities - restitutions * side * speed
    # A sample at the time of an impact is the state after it, except for the initial state.
    indices = np.maximum(1, np.searchsorted(time, impact_times, side="left"))
    repeated_indices = np.repeat(indices, 3)

    def insert_entries(samples, *entries):
        return np.insert(samples, repeated_indices, np.stack(entries, -1).ravel())

    before_indices = indices + 3 * np.arange(len(indices))
    return (
        insert_entries(time, impact_times, impact_times, impact_times),
        insert_entries(x, impact_positions, breaks, impact_positions),
        insert_entries(v, velocities_before, breaks, velocities_after),
        before_indices,
    )


def _wall_data(scene, side, time, phase):
    """Return (velocity, restitution) of the walls hit at these times."""
    wall_velocities, restitutions = np.zeros(time.shape), np.zeros(time.shape)
    for sign, name in SIDE_NAMES.items():
        wall, is_on_wall = getattr(scene, name), side == sign
        if wall is None:
            continue
        restitutions[is_on_wall] = float(scene.bounce(name))
        if wall.motion is not None:
            wall_velocities[is_on_wall] = wall_velocity(
                wall, float(scene.frequency), phase + float(scene.frequency) * time[is_on_wall]
            )
    return wall_velocities, restitutions


def wall_position(wall, phase):
    """Return the position of a wall at phases of the drive."""
    displacement = 0.0 if wall.motion is None else _harmonic_term(wall, np.cos, phase)
    return float(wall.position) + displacement + 0.0 * phase


def wall_velocity(wall, frequency, phase):
    """Return the velocity of a moving wall at phases of the drive."""
    return -wall.motion.harmonic * frequency * _harmonic_term(wall, np.sin, phase)


def _harmonic_term(wall, waveform, phase):
    return float(wall.motion.amplitude) * waveform(wall.motion.harmonic * phase + float(wall.motion.phase))
