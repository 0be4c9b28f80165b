"""Warn about valid numbers that look as if they were in another unit."""

import warnings

import numpy as np

HZ_RANGE = (0.4, 2.5)  # frequency ratios, if the number is read as Hz, at which it looks like Hz
MM_RATIO = 20.0  # wall distance over response amplitude above which positions look like mm
MILLI = 1e-3


def warn_about_scene_units(scene, is_in_rad_per_s, damping_ratio=None, gap=None):
    """Warn once about numbers of a single scene that look as if they were in another unit.

    The warning covers a frequency in rad/s that looks like Hz, wall positions that look like mm, a damping ratio that
    looks like per cent, and a gap that looks like positions.
    """
    frequency = float(scene.frequency)
    warning_questions = []
    looks_like_hz = is_in_rad_per_s and HZ_RANGE[0] <= 2.0 * np.pi * frequency <= HZ_RANGE[1]
    if looks_like_hz:
        frequency_comparison = f"the drive is at {frequency:.3g} of the natural frequency, and would be at"
        warning_questions.append(
            f"is the frequency in Hz ({frequency_comparison} {2.0 * np.pi * frequency:.3g})? Use frequency_hz= for Hz"
        )
    likely_frequency = 2.0 * np.pi * frequency if looks_like_hz else frequency
    wall_distances = [abs(float(wall.position)) for wall in scene.walls.values() if wall.motion is None]
    response_amplitude = (
        float(scene.amplitude) / abs(1.0 - likely_frequency**2 + 2j * float(scene.damping) * likely_frequency)
        if likely_frequency != 1
        else np.inf
    )
    if (
        len(wall_distances) == len(scene.walls)
        and wall_distances
        and response_amplitude > 0
        and min(wall_distances) > MM_RATIO * response_amplitude >= MM_RATIO * MILLI * min(wall_distances)
    ):
        distance_ratio_text = f"{min(wall_distances) / response_amplitude:.3g} times as far as the drive moves the mass"
        warning_questions.append(f"are the walls' positions in mm (they are {distance_ratio_text})? They are read in m")
    if damping_ratio is not None and float(damping_ratio) > 1.0:
        warning_questions.append(f"is the damping ratio in per cent ({float(damping_ratio):g})? 1 is critical")
    if isinstance(gap, tuple | list) and any(
        gap_distance is not None and float(gap_distance) < 0 for gap_distance in gap
    ):
        warning_questions.append(
            f"is gap ({', '.join(map(str, gap))}) meant as positions? Use walls= for positions; a gap is a distance"
        )
    if warning_questions:
        warnings.warn("; ".join(warning_questions), UserWarning, stacklevel=4)


def warn_if_times_in_seconds(scene, measured_record):
    """Warn about a record that covers less than a drive period, so that its times look like seconds.

    Parameters
    ----------
    scene : Scene
        Scene. A scene without scales causes no warning.
    measured_record : ImpactRecord or SampleRecord
        The record.
    """
    n_covered_periods = float(np.ptp(measured_record.times)) * float(scene.frequency) / (2.0 * np.pi)
    if scene.scales is not None and n_covered_periods < 1.0:
        message = f"the record covers {n_covered_periods:.2g} of a drive period: are its times in seconds?"
        warnings.warn(f"{message} Use record_from_physical for times in seconds", UserWarning, stacklevel=4)
