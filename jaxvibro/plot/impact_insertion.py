"""Insert the impacts of a trajectory between its samples, so that a line breaks at each impact."""

import numpy as np

SIDE_SIGNS = {"left": -1, "right": 1}


def insert_impacts(trajectory, scene):
    """Return (time, x, v, indices) of a Dataset of `simulate`, with three entries per impact: before, nan, after.

    `indices` are the indices of the entries before the impacts.
    """
    time, x, v = (trajectory[name].values for name in ("time", "x", "v"))
    impact_times, impact_positions = (trajectory[name].values for name in ("impact_time", "position"))
    impact_sides, impact_speeds = (trajectory[name].values for name in ("side", "speed"))
    drive_frequency = float(scene.frequency)
    impact_phases = float(trajectory["phase"].values[0]) + drive_frequency * impact_times
    wall_velocities, restitutions = np.zeros(impact_times.shape), np.zeros(impact_times.shape)
    for side, wall in scene.walls.items():
        is_at_wall = impact_sides == SIDE_SIGNS[side]
        restitutions[is_at_wall] = float(scene.bounce(side))
        wall_velocities[is_at_wall] = wall_position_velocity(wall, drive_frequency, impact_phases[is_at_wall])[1]
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


def wall_position_velocity(wall, drive_frequency, drive_phase):
    """Return (position, velocity) of a wall at phases of the drive."""
    fixed_position = np.full(np.shape(drive_phase), float(wall.position))
    if wall.motion is None:
        return fixed_position, np.zeros(fixed_position.shape)
    amplitude, harmonic = float(wall.motion.amplitude), wall.motion.harmonic
    motion_phase = harmonic * drive_phase + float(wall.motion.phase)
    return fixed_position + amplitude * np.cos(motion_phase), -harmonic * drive_frequency * (
        amplitude * np.sin(motion_phase)
    )
