"""Reproduce figure 8: both Lyapunov exponents against the amplitude."""

import numpy as np
from tqdm import tqdm

from .. import plot
from ..attractors.spectrum import spectrum
from ..orbits.find import find_orbit
from ..scene.state import State
from .claim import additional_claim
from .figure_panels import FigureResult, make_figure, png_bytes
from .special_points import ROUNDING

PERIODIC_AMPLITUDE = 2.0  # amplitude at which the motion is P111
CAPTION = (
    "Both Lyapunov exponents, per drive period, against the drive amplitude. The motion is chaotic if the larger one "
    "is positive; their sum is the contraction rate of areas."
)


def reproduce_figure_8(scene_file, show_progress):
    """Reproduce figure 8 and its claims."""
    scene, spectrum_table = scene_file.scene.make(), scene_file.spectrum
    initial_state = State(spectrum_table.start.x, spectrum_table.start.v)
    with tqdm(desc="spectrum", total=spectrum_table.count, unit=" values", disable=not show_progress) as progress_bar:
        exponent_data = spectrum(
            scene,
            spectrum_table.parameter,
            spectrum_table.values,
            initial_state,
            settle=spectrum_table.settle,
            error=spectrum_table.error,
            progress=lambda n_done: progress_bar.update(n_done - progress_bar.n),
        )
    figure, ((ax,),) = make_figure(1, 1, 3.2)
    plot.spectrum(exponent_data, ax).legend(frameon=False, loc="lower left")
    return FigureResult(
        png_bytes(figure),
        CAPTION,
        tuple(_exponent_claims(scene, spectrum_table, exponent_data)),
        {"": exponent_data},
    )


def _exponent_claims(scene, spectrum_table, exponent_data):
    yield _sum_claim(scene, exponent_data)
    yield _periodic_claim(scene, spectrum_table, exponent_data)
    largest_exponents, exponent_errors = (
        exponent_data[field_name].values[:, 0] for field_name in ("exponent", "error")
    )
    is_chaotic = largest_exponents - 3.0 * exponent_errors > 0
    parameter_values = spectrum_table.values
    chaotic_range_text = (
        f"{is_chaotic.sum()} of {len(parameter_values)} values, from {parameter_values[is_chaotic].min():g} to"
        f" {parameter_values[is_chaotic].max():g}"
        if is_chaotic.any()
        else "none"
    )
    largest_exponent_index = int(np.nanargmax(largest_exponents))
    claim_text = (
        f"there is chaos: {chaotic_range_text} (largest exponent, at A = {parameter_values[largest_exponent_index]:g})"
    )
    yield additional_claim(
        "8",
        claim_text,
        (float(largest_exponents[largest_exponent_index]), float(exponent_errors[largest_exponent_index])),
        low=0.0,
    )


def _sum_claim(scene, exponent_data):
    """Return the claim that the sum of the exponents equals the contraction rate by damping and impacts."""
    expected_sums = -4.0 * np.pi * float(scene.damping) / float(scene.frequency)
    expected_sums = expected_sums + 2.0 * np.log(float(scene.restitution)) * exponent_data["impacts"].values
    max_difference = float(np.nanmax(abs(exponent_data["exponent"].values.sum(axis=1) - expected_sums)))
    claim_text = "the sum of the exponents is -2 gamma T + 2 ln R x (impacts per period) (largest difference)"
    return additional_claim("8", claim_text, (max_difference, ROUNDING), high=1e-12)


def _periodic_claim(scene, spectrum_table, exponent_data):
    """Return the claim that the exponents of a motion with n drive periods are ``ln|multiplier| / n``."""
    row = int(np.argmin(abs(spectrum_table.values - PERIODIC_AMPLITUDE)))
    periodic_scene = scene.replace(**{spectrum_table.parameter: spectrum_table.values[row]})
    orbit = find_orbit(periodic_scene, State(spectrum_table.start.x, spectrum_table.start.v))
    exponent_differences = exponent_data["exponent"].values[row] - np.log(abs(orbit.multipliers)) / orbit.periods
    claim_text = (
        f"on {orbit.label} at A = {spectrum_table.values[row]:g} they are ln abs(multiplier) per period (difference)"
    )
    return additional_claim("8", claim_text, (float(abs(exponent_differences).max()), ROUNDING), high=1e-9)
