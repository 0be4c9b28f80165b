"""Figure 8: both Lyapunov exponents against the amplitude."""

import numpy as np
from tqdm import tqdm

from .. import plot
from ..attractors.spectrum import spectrum
from ..orbits.find import find_orbit
from ..scene.state import State
from .claim import own
from .located import ROUNDING
from .panels import Drawn, png, sheet, styled

KNOWN = 2.0  # an amplitude at which the motion is P111
CAPTION = (
    "Both Lyapunov exponents, per drive period, against the drive's amplitude. Where the larger one is above 0 the "
    "motion is chaotic; their sum tells how fast areas shrink."
)


def drawn(file, progress):
    """Figure 8 and its claims."""
    scene, asked = file.scene.make(), file.spectrum
    start = State(asked.start.x, asked.start.v)
    with tqdm(desc="spectrum", total=asked.count, unit=" values", disable=not progress) as bar:
        found = spectrum(
            scene,
            asked.parameter,
            asked.values,
            start,
            settle=asked.settle,
            error=asked.error,
            progress=lambda n: bar.update(n - bar.n),
        )
    with styled():
        figure, ((ax,),) = sheet(1, 1, 3.2)
        plot.spectrum(found, ax).legend(frameon=False, loc="lower left")
        return Drawn(png(figure), CAPTION, tuple(_claims(scene, asked, found)), {"": found})


def _claims(scene, asked, found):
    yield _sum(scene, found)
    yield _known(scene, asked, found)
    largest, error = (found[key].values[:, 0] for key in ("exponent", "error"))
    above = largest - 3.0 * error > 0
    values = asked.values
    told = (
        f"{above.sum()} of {len(values)} values, from {values[above].min():g} to {values[above].max():g}"
        if above.any()
        else "none"
    )
    best = int(np.nanargmax(largest))
    text = f"there is chaos: {told} (largest exponent, at A = {values[best]:g})"
    yield own("8", text, (float(largest[best]), float(error[best])), low=0.0)


def _sum(scene, found):
    """The sum rule: areas shrink by damping and impacts alone."""
    rule = -4.0 * np.pi * float(scene.damping) / float(scene.frequency)
    rule = rule + 2.0 * np.log(float(scene.restitution)) * found["impacts"].values
    largest = float(np.nanmax(abs(found["exponent"].values.sum(axis=1) - rule)))
    text = "the exponents' sum is -2 gamma T + 2 ln R x (impacts a period) (largest difference)"
    return own("8", text, (largest, ROUNDING), high=1e-12)


def _known(scene, asked, found):
    """At a periodic motion the exponents are ln abs(multiplier) / n."""
    place = int(np.argmin(abs(asked.values - KNOWN)))
    here = scene.replace(**{asked.parameter: asked.values[place]})
    orbit = find_orbit(here, State(asked.start.x, asked.start.v))
    gap = found["exponent"].values[place] - np.log(abs(orbit.multipliers)) / orbit.periods
    text = f"on {orbit.label} at A = {asked.values[place]:g} they are ln abs(multiplier) a period (difference)"
    return own("8", text, (float(abs(gap).max()), ROUNDING), high=1e-9)
