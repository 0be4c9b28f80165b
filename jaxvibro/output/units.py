"""Define the units of results, as attributes of their variables.

Lengths are in the unit of the walls' positions. w0 is the frequency of the free oscillator without damping, and t is w0
times the time. M and K are the oscillator's mass and stiffness. If a scene has `Scales`, each unit corresponds to one
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
UNIT_SYSTEMS = ("scene", "physical")  # choices of `units`
SCALES_ATTRIBUTE = "scales"  # attribute of a Dataset with M, K, d


class PhysicalUnit(NamedTuple):
    """Unit of measuring instruments.

    Parameters
    ----------
    text : str
        Name.
    size : callable
        Function from `Scales` to the size of the scene's unit in this one.
    """

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
    """Return the unit of a scene's parameter.

    Parameters
    ----------
    name : str
        Parameter.

    Returns
    -------
    str
        Unit; ``""`` for a parameter of a user-defined force, whose unit is that of its function.
    """
    owner, _, parameter = name.partition(".")
    if owner == "force" or ".law." in name:
        return ""
    return _PARAMETER_UNITS.get(parameter.partition(".")[2] if owner == "drive" else parameter or owner, "")


def display_unit(unit: str, scales: Scales | None) -> tuple[str, float]:
    """Return the unit in which a quantity is displayed.

    Parameters
    ----------
    unit : str
        Unit in the scene.
    scales : Scales or None
        Scales of the scene. None keeps the scene's unit.

    Returns
    -------
    text : str
        Name of the physical unit if there is one, else of the scene's unit.
    factor : float
        Size of the scene's unit in it.
    """
    if scales is None or unit not in PHYSICAL_UNITS:
        return unit, 1.0
    return PHYSICAL_UNITS[unit].text, PHYSICAL_UNITS[unit].size(scales)


def quantity_text(scales, unit, value):
    """Format a quantity of a scene as ``"4.65"``, or with scales as ``"12 N"``.

    Parameters
    ----------
    scales : Scales or None
        Scales of the scene.
    unit : str
        Unit in the scene.
    value : float
        Value in the scene.

    Returns
    -------
    str
        Text.
    """
    unit_text, factor = display_unit(unit, scales)
    return f"{factor * value:g}" + _unit_suffix(scales, unit_text)


def range_text(scales, unit, lower, upper):
    """Format a range of a scene as ``"from -1 to 1"``, or with scales as ``"from -0.5 to 0.5 mm"``.

    Parameters
    ----------
    scales : Scales or None
        Scales of the scene.
    unit : str
        Unit in the scene.
    lower : float
        Lower end in the scene.
    upper : float
        Upper end in the scene.

    Returns
    -------
    str
        Text.
    """
    unit_text, factor = display_unit(unit, scales)
    return f"from {factor * lower:.4g} to {factor * upper:.4g}" + _unit_suffix(scales, unit_text)


def _unit_suffix(scales, unit_text):
    """Return the unit with a leading space, or an empty text."""
    return "" if scales is None or unit_text in ("", DIMENSIONLESS) else f" {unit_text}"


def require_unit_system(units):
    """Return the requested unit system, checked.

    Parameters
    ----------
    units : {"scene", "physical"}
        Unit system.

    Returns
    -------
    str
        Unit system.

    Raises
    ------
    ArgumentError
        If it is unknown.
    """
    if not isinstance(units, str) or units not in UNIT_SYSTEMS:
        raise check.ArgumentError("units", f"must be one of {', '.join(UNIT_SYSTEMS)}", units)
    return units


def unit_in_system(scene: Scene, unit: str, units: str) -> tuple[str, float]:
    """Return `display_unit` in the requested unit system.

    Parameters
    ----------
    scene : Scene
        Scene.
    unit : str
        Unit in the scene.
    units : {"scene", "physical"}
        Unit system.

    Returns
    -------
    text : str
        Name of the unit.
    factor : float
        Size of the scene's unit in it.

    Raises
    ------
    ArgumentError
        If `units` is unknown, or physical units are requested of a scene without scales.
    """
    require_unit_system(units)
    return display_unit(unit, None if units == "scene" else require_scales(scene))


def scales_attributes(scene):
    """Return the attributes that store a scene's scales in a Dataset; empty without scales.

    Parameters
    ----------
    scene : Scene
        Scene.

    Returns
    -------
    dict of str to list of float
        Attributes.
    """
    return {} if scene.scales is None else {SCALES_ATTRIBUTE: list(scene.scales.numbers.values())}


def read_scales(data):
    """Return the scales in a Dataset's attributes.

    Parameters
    ----------
    data : xarray.Dataset
        Dataset.

    Returns
    -------
    Scales
        Scales.

    Raises
    ------
    ArgumentError
        If there are none.
    """
    if not isinstance(data, xr.Dataset) or SCALES_ATTRIBUTE not in data.attrs:
        rule = "must be a Dataset of a scene with scales; make the scene with scene_from_physical"
        raise check.ArgumentError("data", rule, type(data).__name__)
    return Scales(*np.asarray(data.attrs[SCALES_ATTRIBUTE], float))


@check.host_only("multiply by the factors of `scene.scales`")
def to_physical(data: xr.Dataset) -> xr.Dataset:
    """Convert a dataset of a scene with scales to physical units.

    The units are N, Hz, mm, m/s, s, W, N/m and N s/m.

    Parameters
    ----------
    data : xarray.Dataset
        Dataset of `sweep`, `simulate`, `sections`, `basins`, `fractions`, `manifold` or `spectrum`, or the ``data`` of
        a branch or locus.

    Returns
    -------
    xarray.Dataset
        New dataset. Each variable whose attribute ``units`` is a unit of the scene is multiplied and has its new unit.
        All other variables and the attributes are unchanged.

    Raises
    ------
    ArgumentError
        If `data` is not such a dataset, or its scene has no scales.

    See Also
    --------
    scene_from_physical : Make a scene with scales from SI quantities.

    Examples
    --------
    >>> physical = jv.scene_from_physical(2.0, 4.0, 800.0, 16.0, 40.0, 0.7, walls=(-0.01, 0.01))
    >>> data = jv.to_physical(jv.sweep(physical, "amplitude", [2.0], state, settle=10, keep=1))
    >>> data["x"].attrs["units"], data["amplitude"].values.tolist()
    ('mm', [16.0])
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
