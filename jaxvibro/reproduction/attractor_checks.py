"""Compute properties of attractors for the claims, with an allowance for unresolved initial states."""

import numpy as np

from ..attractors.spectrum import spectrum
from ..maps.initial_conditions import draw_initial_states
from ..scene.state import State

CHAOS_SIGMAS = 3.0  # standard errors by which a chaotic exponent exceeds 0
# Search for the onset of chaos.
AMPLITUDE_STEP, STARTS_PER_AMPLITUDE, EXPONENT_ERROR, MAX_PERIODS = 0.02, 16, 0.03, 2**14
LONG_SETTLE = 3000  # drive periods after which the motion must still be chaotic


def basin_shares_text(attractors):
    """Format the labels and basin fractions of attractors as text."""
    return ", ".join(f"{attractor.label} ({100 * attractor.share:.0f} %)" for attractor in attractors)


def unresolved_allowance(attractors):
    """Return the possible number of undetected attractors: infinity if initial states are unresolved, else 0."""
    return np.inf if any(attractor.kind == "unresolved" for attractor in attractors) else 0.0


def largest_exponent(scene, attractors):
    """Return the largest Lyapunov exponent among attractors as ((exponent, error), allowance).

    The allowance is infinite if initial states are unresolved, because their exponents may be larger, and else 0.
    """
    scene_amplitude = float(scene.amplitude)
    x, v, contact_codes = (
        np.array([getattr(attractor.state, field_name) for attractor in attractors], float)
        for field_name in ("x", "v", "contact")
    )
    exponent_data = spectrum(scene, "amplitude", np.full(len(x), scene_amplitude), State(x, v, 0.0, contact_codes))
    exponents, errors = (exponent_data[field_name].values[:, 0] for field_name in ("exponent", "error"))
    if np.isnan(exponents).all():
        return (np.nan, np.nan), unresolved_allowance(attractors)
    largest_index = int(np.nanargmax(exponents))
    return (float(exponents[largest_index]), float(errors[largest_index])), unresolved_allowance(attractors)


def locate_chaos_onset(scene, lower_amplitude, upper_amplitude):
    """Find the lowest amplitude at which an initial state leads to chaos, on a grid of step `AMPLITUDE_STEP`.

    At each amplitude `STARTS_PER_AMPLITUDE` random initial states are tested. The motion must still be chaotic after
    `LONG_SETTLE` drive periods. Returns (amplitude, grid step, number of chaotic initial states, largest exponent), or
    (nan, nan, 0, nan) if no initial state leads to chaos. Chaos may begin below the returned amplitude.
    """
    amplitudes = np.arange(upper_amplitude, lower_amplitude, -AMPLITUDE_STEP)[::-1]
    initial_states = draw_initial_states(scene, len(amplitudes) * STARTS_PER_AMPLITUDE, 0)
    lane_amplitudes = np.repeat(amplitudes, STARTS_PER_AMPLITUDE)
    is_chaotic, _ = _test_for_chaos(scene, lane_amplitudes, initial_states, error=EXPONENT_ERROR, most=MAX_PERIODS)
    for amplitude in amplitudes[is_chaotic.reshape(-1, STARTS_PER_AMPLITUDE).any(axis=1)]:
        is_at_amplitude = is_chaotic & (lane_amplitudes == amplitude)
        is_still_chaotic, exponents = _test_for_chaos(
            scene,
            lane_amplitudes[is_at_amplitude],
            State(initial_states.x[is_at_amplitude], initial_states.v[is_at_amplitude]),
            settle=LONG_SETTLE,
        )
        if is_still_chaotic.any():
            return (
                float(amplitude),
                AMPLITUDE_STEP,
                int(is_still_chaotic.sum()),
                float(exponents[is_still_chaotic].max()),
            )
    return np.nan, np.nan, 0, np.nan


def _test_for_chaos(scene, amplitudes, initial_states, **spectrum_settings):
    """Return (mask of the initial states that lead to chaos, largest exponent of the motion from each state).

    The motion is chaotic if it is not periodic and its largest exponent exceeds `CHAOS_SIGMAS` standard errors.
    """
    exponent_data = spectrum(scene, "amplitude", amplitudes, initial_states, **spectrum_settings)
    exponents, errors = (exponent_data[key].values[:, 0] for key in ("exponent", "error"))
    return (exponents - CHAOS_SIGMAS * errors > 0) & (exponent_data["periods"].values == 0), exponents


def stable_labels_at(branches, parameter_value):
    """Return the labels of the stable orbits at a parameter value, one label for each crossing of a branch."""
    return [
        segment.label
        for branch in branches
        for segment in branch.segments
        for row in crossing_rows(branch, segment, parameter_value)
        if branch.values[row] != parameter_value and branch.stable[row] and branch.stable[row + 1]
    ]


def crossing_rows(branch, segment, parameter_value):
    """Return the rows of a branch inside a segment between which and the next row a parameter value lies."""
    value_offsets = branch.values[segment.first : segment.last + 1] - parameter_value
    return segment.first + np.flatnonzero(value_offsets[:-1] * value_offsets[1:] <= 0)
