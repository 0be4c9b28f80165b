"""Reproduce figure 8: both Lyapunov exponents against the amplitude."""

import numpy as np
from tqdm import tqdm

from .. import plot
from ..attractors.spectrum import spectrum
from ..orbits.find import find_orbit
from ..scene.state import State
from .claim import own_claim
from .panels import FigureResult, figure_style, make_figure, png_bytes
from .special_points import ROUNDING

PERIODIC_AMPLITUDE = 2.0  # amplitude at which the motion is P111
CAPTION = (
    "Both Lyapunov exponents, per drive period, against the drive amplitude. The motion is chaotic if the larger one "
    "is positive; their sum is the contraction rate of areas."
)


def reproduce_figure(file, progress):
    """Reproduce figure 8 and its claims."""
    scene, table = file.scene.make(), file.spectrum
    start = State(table.start.x, table.start.v)
    with tqdm(desc="spectrum", total=table.count, unit=" values", disable=not progress) as bar:
        spectrum_data = spectrum(
            scene,
            table.parameter,
            table.values,
            start,
            settle=table.settle,
            error=table.error,
            progress=lambda n_done: bar.update(n_done - bar.n),
        )
    with figure_style():
        figure, ((ax,),) = make_figure(1, 1, 3.2)
        plot.spectrum(spectrum_data, ax).legend(frameon=False, loc="lower left")
        return FigureResult(
            png_bytes(figure), CAPTION, tuple(_claims(scene, table, spectrum_data)), {"": spectrum_data}
        )


def _claims(scene, table, spectrum_data):
    yield _sum_claim(scene, spectrum_data)
    yield _periodic_claim(scene, table, spectrum_data)
    largest_exponents, errors = (spectrum_data[key].values[:, 0] for key in ("exponent", "error"))
    is_chaotic = largest_exponents - 3.0 * errors > 0
    values = table.values
    range_text = (
        f"{is_chaotic.sum()} of {len(values)} values, from {values[is_chaotic].min():g} to {values[is_chaotic].max():g}"
        if is_chaotic.any()
        else "none"
    )
    row = int(np.nanargmax(largest_exponents))
    text = f"there is chaos: {range_text} (largest exponent, at A = {values[row]:g})"
    yield own_claim("8", text, (float(largest_exponents[row]), float(errors[row])), low=0.0)


def _sum_claim(scene, spectrum_data):
    """Return the claim on the sum of the exponents: areas contract by damping and impacts alone."""
    expected_sum = -4.0 * np.pi * float(scene.damping) / float(scene.frequency)
    expected_sum = expected_sum + 2.0 * np.log(float(scene.restitution)) * spectrum_data["impacts"].values
    max_difference = float(np.nanmax(abs(spectrum_data["exponent"].values.sum(axis=1) - expected_sum)))
    text = "the sum of the exponents is -2 gamma T + 2 ln R x (impacts per period) (largest difference)"
    return own_claim("8", text, (max_difference, ROUNDING), high=1e-12)


def _periodic_claim(scene, table, spectrum_data):
    """Return the claim that the exponents of a periodic motion are ``ln|multiplier| / n``."""
    row = int(np.argmin(abs(table.values - PERIODIC_AMPLITUDE)))
    periodic_scene = scene.replace(**{table.parameter: table.values[row]})
    orbit = find_orbit(periodic_scene, State(table.start.x, table.start.v))
    difference = spectrum_data["exponent"].values[row] - np.log(abs(orbit.multipliers)) / orbit.periods
    text = f"on {orbit.label} at A = {table.values[row]:g} they are ln abs(multiplier) per period (difference)"
    return own_claim("8", text, (float(abs(difference).max()), ROUNDING), high=1e-9)
