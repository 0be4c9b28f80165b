"""Check attractors for verdicts, with an allowance for unresolved initial states."""

import numpy as np

from ..attractors.spectrum import spectrum
from ..maps.initial_conditions import draw_initial_states
from ..scene.state import State

CHAOS_SIGMAS = 3.0  # standard errors by which a chaotic exponent exceeds 0
# Search for the onset of chaos.
AMPLITUDE_STEP, STARTS_PER_AMPLITUDE, EXPONENT_ERROR, MAX_PERIODS = 0.02, 16, 0.03, 2**14
LONG_SETTLE = 3000  # drive periods after which the motion must still be chaotic


def shares_text(motions):
    """Return attractors and their basin fractions as text."""
    return ", ".join(f"{motion.label} ({100 * motion.share:.0f} %)" for motion in motions)


def unresolved_excess(motions):
    """Return the possible number of further attractors: infinity if some initial states are unresolved, else 0."""
    return np.inf if any(motion.kind == "unresolved" for motion in motions) else 0.0


def largest_exponent(scene, attractors):
    """Return ((exponent, error), excess) of the largest Lyapunov exponent of attractors and one unresolved state.

    `excess` is the amount by which the exponent of another unresolved state may be larger.
    """
    amplitude = float(scene.amplitude)
    x, v, contact = (
        np.array([getattr(attractor.state, key) for attractor in attractors], float) for key in ("x", "v", "contact")
    )
    spectrum_data = spectrum(scene, "amplitude", np.full(len(x), amplitude), State(x, v, 0.0, contact))
    exponent, error = (spectrum_data[key].values[:, 0] for key in ("exponent", "error"))
    if np.isnan(exponent).all():
        return (np.nan, np.nan), unresolved_excess(attractors)
    index = int(np.nanargmax(exponent))
    return (float(exponent[index]), float(error[index])), unresolved_excess(attractors)


def chaos_onset(scene, lower, upper):
    """Return (amplitude, error, number of chaotic initial states, largest exponent) of the lowest chaotic amplitude.

    Amplitudes are `AMPLITUDE_STEP` apart, and an amplitude is chaotic if one of its initial states leads to chaos.
    Chaos begins there or below. All are nan, and the number 0, without chaos.
    """
    amplitudes = np.arange(upper, lower, -AMPLITUDE_STEP)[::-1]
    starts = draw_initial_states(scene, len(amplitudes) * STARTS_PER_AMPLITUDE, 0)
    lane_amplitudes = np.repeat(amplitudes, STARTS_PER_AMPLITUDE)
    is_chaotic, _ = _chaotic_starts(scene, lane_amplitudes, starts, error=EXPONENT_ERROR, most=MAX_PERIODS)
    for amplitude in amplitudes[is_chaotic.reshape(-1, STARTS_PER_AMPLITUDE).any(axis=1)]:
        is_selected = is_chaotic & (lane_amplitudes == amplitude)
        is_confirmed, exponents = _chaotic_starts(
            scene, lane_amplitudes[is_selected], State(starts.x[is_selected], starts.v[is_selected]), settle=LONG_SETTLE
        )
        if is_confirmed.any():
            return float(amplitude), AMPLITUDE_STEP, int(is_confirmed.sum()), float(exponents[is_confirmed].max())
    return np.nan, np.nan, 0, np.nan


def _chaotic_starts(scene, amplitudes, starts, **settings):
    """Return (True for each initial state with a significantly positive exponent, the exponents)."""
    spectrum_data = spectrum(scene, "amplitude", amplitudes, starts, **settings)
    exponent, error = (spectrum_data[key].values[:, 0] for key in ("exponent", "error"))
    return (exponent - CHAOS_SIGMAS * error > 0) & (spectrum_data["periods"].values == 0), exponent


def stable_labels_at(branches, value):
    """Return the labels of the stable orbits on branches at a value of their parameter, once per crossing."""
    labels = []
    for branch in branches:
        for segment in branch.segments:
            rows = slice(segment.first, segment.last + 1)
            offsets, stable = branch.values[rows] - value, branch.stable[rows]
            is_crossing = (offsets[:-1] * offsets[1:] <= 0) & (offsets[:-1] != 0) & stable[:-1] & stable[1:]
            labels += [segment.label] * int(is_crossing.sum())
    return labels
