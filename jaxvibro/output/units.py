"""The units of what is written and returned, as attributes of its variables: each spelled once.

Lengths are in the unit in which the walls' positions are given; w0 is the frequency of the free oscillator without
damping, t = w0 times the time; M and K are the oscillator's mass and stiffness. Where a scene has `Scales`, each is one
of N, Hz, mm, m/s, s, W, N/m, N s/m: `PHYSICAL`.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import xarray as xr

from ..scene import check
from ..scene.scales import Scales, require_scales
from ..scene.scene import Scene

LENGTH = "length"
SPEED = "length w0"
TIME = "1/w0"
ANGLE = "rad"
ONE = "1"
FREQUENCY = "w0"
FORCE = "K length"
POWER = "K length^2 w0"
STIFFNESS = "K"
DAMPING = "2 M w0"
SYSTEMS = ("scene", "physical")  # what may be asked for
SCALES = "scales"  # the attribute of a Dataset: M, K, d


class Physical(NamedTuple):
    """A unit that instruments have. text: its name; size: `Scales` -> how much of it one of the scene's units is."""

    text: str
    size: Callable[[Scales], float]


PHYSICAL = {
    LENGTH: Physical("mm", lambda one: 1e3 * one.length),
    SPEED: Physical("m/s", lambda one: one.length * one.natural_frequency),
    TIME: Physical("s", lambda one: 1.0 / one.natural_frequency),
    FREQUENCY: Physical("Hz", lambda one: one.natural_frequency / (2.0 * np.pi)),
    FORCE: Physical("N", lambda one: one.stiffness * one.length),
    POWER: Physical("W", lambda one: one.stiffness * one.length**2 * one.natural_frequency),
    STIFFNESS: Physical("N/m", lambda one: one.stiffness),
    DAMPING: Physical("N s/m", lambda one: 2.0 * one.mass * one.natural_frequency),
}
_OF_PARAMETERS = {
    "amplitude": FORCE,
    "frequency": FREQUENCY,
    "damping": DAMPING,
    "stiffness": STIFFNESS,
    "position": LENGTH,
    "motion.amplitude": LENGTH,
    "phase": ANGLE,
    "motion.phase": ANGLE,
    "restitution": ONE,
    "hardness": ONE,
}


def unit_of(name: str) -> str:
    """The unit of a scene's parameter; "" of a force's own number, which has whatever unit its function gives it."""
    first, _, rest = name.partition(".")
    if first == "force" or ".law." in name:
        return ""
    return _OF_PARAMETERS.get(rest.partition(".")[2] if first == "drive" else rest or first, "")


def told(unit: str, scales: Scales | None) -> tuple[str, float]:
    """(the unit's name, how much of it one of the scene's units is): with scales the physical one, where there is one,
    else as it is."""
    if scales is None or unit not in PHYSICAL:
        return unit, 1.0
    return PHYSICAL[unit].text, PHYSICAL[unit].size(scales)


def amount_text(scales, unit, value):
    """A number of a scene as "4.65", or with `Scales` as "12 N"."""
    text, size = told(unit, scales)
    return f"{size * value:g}" + _after(scales, text)


def range_text(scales, unit, low, high):
    """Two numbers of a scene as "from -1 to 1", or with `Scales` as "from -0.5 to 0.5 mm"."""
    text, size = told(unit, scales)
    return f"from {size * low:.4g} to {size * high:.4g}" + _after(scales, text)


def _after(scales, text):
    return "" if scales is None or text in ("", ONE) else f" {text}"


def require_system(units):
    """The units asked for, "scene" or "physical". Raises ArgumentError for others."""
    if not isinstance(units, str) or units not in SYSTEMS:
        raise check.ArgumentError("units", f"must be one of {', '.join(SYSTEMS)}", units)
    return units


def unit_in(scene: Scene, unit: str, units: str) -> tuple[str, float]:
    """`told` in the units asked for. Raises ArgumentError for others, and where the scene has no scales."""
    require_system(units)
    return told(unit, None if units == "scene" else require_scales(scene))


def scales_in(scene):
    """{attribute: numbers} of a scene's scales, for a Dataset of it: {} without."""
    return {} if scene.scales is None else {SCALES: list(scene.scales.numbers.values())}


def scales_from(data):
    """The `Scales` in a Dataset's attributes. Raises ArgumentError where there are none."""
    if not isinstance(data, xr.Dataset) or SCALES not in data.attrs:
        rule = "must be a Dataset of a scene with scales, as scene_from_physical makes"
        raise check.ArgumentError("data", rule, type(data).__name__)
    return Scales(*np.asarray(data.attrs[SCALES], float))


@check.host("multiply by what `scene.scales` says")
def to_physical(data: xr.Dataset) -> xr.Dataset:
    """A Dataset of a scene with scales (`scene_from_physical`) in N, Hz, mm, m/s, s, W, N/m and N s/m: another Dataset.

    data: of `sweep`, `simulate`, `sections`, `basins`, `fractions`, `manifold`, `spectrum`, or a branch's or locus'
    `data`. Each variable whose attribute `units` is one of the scene's is multiplied, and told in its new unit; the
    rest, and the attributes, stay as they are.

    Raises ArgumentError for what is no such Dataset, and where its scene had no scales.
    """
    scales = scales_from(data)
    found = data.copy()
    for name, one in data.variables.items():
        unit, size = told(one.attrs.get("units", ""), scales)
        if size != 1.0 or unit != one.attrs.get("units", ""):
            scaled = xr.Variable(one.dims, one.values * size, {**one.attrs, "units": unit})
            found = found.assign_coords({name: scaled}) if name in data.coords else found.assign({name: scaled})
    return found
