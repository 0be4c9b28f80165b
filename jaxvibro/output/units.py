"""The units of what is written and returned, as attributes of its variables: each spelled once.

Lengths are in the unit in which the walls' positions are given; w0 is the frequency of the free oscillator without
damping, t = w0 times the time; M and K are the oscillator's mass and stiffness. Where a scene has `Scales`, each is one
of N, Hz, mm, m/s, s, W, N/m, N s/m: `PHYSICAL_UNITS`.
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
DIMENSIONLESS = "1"
FREQUENCY = "w0"
FORCE = "K length"
POWER = "K length^2 w0"
STIFFNESS = "K"
DAMPING = "2 M w0"
UNIT_SYSTEMS = ("scene", "physical")  # what may be asked for
SCALES_ATTRIBUTE = "scales"  # the attribute of a Dataset: M, K, d


class PhysicalUnit(NamedTuple):
    """A unit that instruments have. text: its name; size: `Scales` -> how much of it one of the scene's units is."""

    text: str
    size: Callable[[Scales], float]


PHYSICAL_UNITS = {
    LENGTH: PhysicalUnit("mm", lambda scales: 1e3 * scales.length),
    SPEED: PhysicalUnit("m/s", lambda scales: scales.length * scales.natural_frequency),
    TIME: PhysicalUnit("s", lambda scales: 1.0 / scales.natural_frequency),
    FREQUENCY: PhysicalUnit("Hz", lambda scales: scales.natural_frequency / (2.0 * np.pi)),
    FORCE: PhysicalUnit("N", lambda scales: scales.stiffness * scales.length),
    POWER: PhysicalUnit("W", lambda scales: scales.stiffness * scales.length**2 * scales.natural_frequency),
    STIFFNESS: PhysicalUnit("N/m", lambda scales: scales.stiffness),
    DAMPING: PhysicalUnit("N s/m", lambda scales: 2.0 * scales.mass * scales.natural_frequency),
}
_PARAMETER_UNITS = {
    "amplitude": FORCE,
    "frequency": FREQUENCY,
    "damping": DAMPING,
    "stiffness": STIFFNESS,
    "position": LENGTH,
    "motion.amplitude": LENGTH,
    "phase": ANGLE,
    "motion.phase": ANGLE,
    "restitution": DIMENSIONLESS,
    "hardness": DIMENSIONLESS,
}


def unit_of(name: str) -> str:
    """The unit of a scene's parameter; "" of a force's own number, which has whatever unit its function gives it."""
    owner, _, parameter = name.partition(".")
    if owner == "force" or ".law." in name:
        return ""
    return _PARAMETER_UNITS.get(parameter.partition(".")[2] if owner == "drive" else parameter or owner, "")


def display_unit(unit: str, scales: Scales | None) -> tuple[str, float]:
    """(the unit's name, how much of it one of the scene's units is): with scales the physical one, where there is one,
    else as it is."""
    if scales is None or unit not in PHYSICAL_UNITS:
        return unit, 1.0
    return PHYSICAL_UNITS[unit].text, PHYSICAL_UNITS[unit].size(scales)


def quantity_text(scales, unit, value):
    """A number of a scene as "4.65", or with `Scales` as "12 N"."""
    unit_text, factor = display_unit(unit, scales)
    return f"{factor * value:g}" + _unit_suffix(scales, unit_text)


def range_text(scales, unit, lower, upper):
    """Two numbers of a scene as "from -1 to 1", or with `Scales` as "from -0.5 to 0.5 mm"."""
    unit_text, factor = display_unit(unit, scales)
    return f"from {factor * lower:.4g} to {factor * upper:.4g}" + _unit_suffix(scales, unit_text)


def _unit_suffix(scales, unit_text):
    return "" if scales is None or unit_text in ("", DIMENSIONLESS) else f" {unit_text}"


def require_unit_system(units):
    """The units asked for, "scene" or "physical". Raises ArgumentError for others."""
    if not isinstance(units, str) or units not in UNIT_SYSTEMS:
        raise check.ArgumentError("units", f"must be one of {', '.join(UNIT_SYSTEMS)}", units)
    return units


def unit_in_system(scene: Scene, unit: str, units: str) -> tuple[str, float]:
    """`display_unit` in the units asked for. Raises ArgumentError for others, and where the scene has no scales."""
    require_unit_system(units)
    return display_unit(unit, None if units == "scene" else require_scales(scene))


def scales_attributes(scene):
    """{attribute: numbers} of a scene's scales, for a Dataset of it: {} without."""
    return {} if scene.scales is None else {SCALES_ATTRIBUTE: list(scene.scales.numbers.values())}


def read_scales(data):
    """The `Scales` in a Dataset's attributes. Raises ArgumentError where there are none."""
    if not isinstance(data, xr.Dataset) or SCALES_ATTRIBUTE not in data.attrs:
        rule = "must be a Dataset of a scene with scales, as scene_from_physical makes"
        raise check.ArgumentError("data", rule, type(data).__name__)
    return Scales(*np.asarray(data.attrs[SCALES_ATTRIBUTE], float))


@check.host_only("multiply by what `scene.scales` says")
def to_physical(data: xr.Dataset) -> xr.Dataset:
    """A Dataset of a scene with scales (`scene_from_physical`) in N, Hz, mm, m/s, s, W, N/m and N s/m: another Dataset.

    data: of `sweep`, `simulate`, `sections`, `basins`, `fractions`, `manifold`, `spectrum`, or a branch's or locus'
    `data`. Each variable whose attribute `units` is one of the scene's is multiplied, and told in its new unit; the
    rest, and the attributes, stay as they are.

    Raises ArgumentError for what is no such Dataset, and where its scene had no scales.
    """
    scales = read_scales(data)
    physical_data = data.copy()
    for name, variable in data.variables.items():
        unit, factor = display_unit(variable.attrs.get("units", ""), scales)
        if factor != 1.0 or unit != variable.attrs.get("units", ""):
            new_variable = xr.Variable(variable.dims, variable.values * factor, {**variable.attrs, "units": unit})
            physical_data = (
                physical_data.assign_coords({name: new_variable})
                if name in data.coords
                else physical_data.assign({name: new_variable})
            )
    return physical_data
