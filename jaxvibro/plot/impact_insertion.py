"""Insert the impacts of a trajectory between its samples, so that a line breaks at each impact."""

import numpy as np

SIDE_NAMES = {-1: "left", 1: "right"}


def insert_impacts(trajectory, scene):
    """Return (time, x, v, indices) of a Dataset of `simulate`, with three entries per impact: before, nan, after.

    `indices` are the indices of the entries before the impacts.
    """
    time, x, v = (trajectory[name].values for name in ("time", "x", "v"))
    impact_times, impact_positions = (trajectory[name].values for name in ("impact_time", "position"))
    impact_sides, impact_speeds = (trajectory[name].values for name in ("side", "speed"))
    wall_velocities, restitutions = _walls_at_impacts(
        scene, impact_sides, impact_times, float(trajectory["phase"].values[0])
    )
    nan_breaks = np.full(impact_times.shape, np.nan)
    velocities_before, velocities_after = (
        wall_velocities + impact_sides * impact_speeds,
        wall_velocities - restitutions * impact_sides * impact_speeds,
    )
    # A sample at the time of an impact is the state after it, except for the initial state.
    insertion_indices = np.maximum(1, np.searchsorted(time, impact_times, side="left"))
    repeated_indices = np.repeat(insertion_indices, 3)

    def insert_entries(samples, *impact_entries):
        return np.insert(samples, repeated_indices, np.stack(impact_entries, -1).ravel())

    before_indices = insertion_indices + 3 * np.arange(len(insertion_indices))
    return (
        insert_entries(time, impact_times, impact_times, impact_times),
        insert_entries(x, impact_positions, nan_breaks, impact_positions),
        insert_entries(v, velocities_before, nan_breaks, velocities_after),
        before_indices,
    )


def _walls_at_impacts(scene, impact_sides, impact_times, start_phase):
    """Return (velocities, restitutions) of the walls at impacts on given sides at given times."""
    wall_velocities, restitutions = np.zeros(impact_times.shape), np.zeros(impact_times.shape)
    for side_sign, side_name in SIDE_NAMES.items():
        wall, is_at_wall = getattr(scene, side_name), impact_sides == side_sign
        if wall is None:
            continue
        restitutions[is_at_wall] = float(scene.bounce(side_name))
        if wall.motion is not None:
            wall_velocities[is_at_wall] = wall_velocity(
                wall, float(scene.frequency), start_phase + float(scene.frequency) * impact_times[is_at_wall]
            )
    return wall_velocities, restitutions


def wall_position(wall, drive_phase):
    """Return the position of a wall at phases of the drive."""
    wall_displacement = 0.0 if wall.motion is None else _wall_motion_term(wall, np.cos, drive_phase)
    return float(wall.position) + wall_displacement + 0.0 * drive_phase


def wall_velocity(wall, drive_frequency, drive_phase):
    """Return the velocity of a moving wall at phases of the drive."""
    return -wall.motion.harmonic * drive_frequency * _wall_motion_term(wall, np.sin, drive_phase)


def _wall_motion_term(wall, waveform, drive_phase):
    return float(wall.motion.amplitude) * waveform(wall.motion.harmonic * drive_phase + float(wall.motion.phase))
