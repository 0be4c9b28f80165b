"""Define the units of results and convert them to physical units.

The unit of length is that of the positions of the walls. w0 is the natural frequency of the oscillator without damping,
and the dimensionless time t is w0 times the time. M and K are the mass and the stiffness of the oscillator. If a scene
has `Scales`, `PHYSICAL_UNITS` maps each unit except rad and 1 to one of N, Hz, mm, m/s, s, W, N/m, N s/m.
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
    """Physical unit, as used by measuring instruments.

    Attributes
    ----------
    text : str
        Symbol of the unit.
    size : callable
        Function of `Scales` that returns the size of the scene's unit in this physical unit.
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


def unit_of(parameter_name: str) -> str:
    """Return the unit of a scene's parameter.

    Parameters
    ----------
    parameter_name : str
        Name of the parameter, for example ``"left.position"``.

    Returns
    -------
    str
        Unit in the scene. ``""`` for a parameter of a user-defined force or contact law, whose unit depends on its
        function.
    """
    before_first_dot, _, after_first_dot = parameter_name.partition(".")
    if before_first_dot == "force" or ".law." in parameter_name:
        return ""
    return _PARAMETER_UNITS.get(
        after_first_dot.partition(".")[2] if before_first_dot == "drive" else after_first_dot or before_first_dot, ""
    )


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
        Symbol of the physical unit if there is one, else the scene's unit.
    factor : float
        Size of the scene's unit in the displayed unit.
    """
    if scales is None or unit not in PHYSICAL_UNITS:
        return unit, 1.0
    return PHYSICAL_UNITS[unit].text, PHYSICAL_UNITS[unit].size(scales)


def quantity_text(scales, unit, value):
    """Format a quantity in the scene's units as ``"4.65"``, or in physical units as ``"12 N"``.

    Parameters
    ----------
    scales : Scales or None
        Scales of the scene. None keeps the scene's unit.
    unit : str
        Unit in the scene.
    value : float
        Value in the scene's unit.

    Returns
    -------
    str
        Text.
    """
    unit_text, unit_factor = display_unit(unit, scales)
    return f"{unit_factor * value:g}" + _unit_suffix(scales, unit_text)


def range_text(scales, unit, lower, upper):
    """Format a range as ``"from -1 to 1"``, or in physical units as ``"from -0.5 to 0.5 mm"``.

    Parameters
    ----------
    scales : Scales or None
        Scales of the scene. None keeps the scene's unit.
    unit : str
        Unit in the scene.
    lower : float
        Lower end in the scene's unit.
    upper : float
        Upper end in the scene's unit.

    Returns
    -------
    str
        Text.
    """
    unit_text, unit_factor = display_unit(unit, scales)
    return f"from {unit_factor * lower:.4g} to {unit_factor * upper:.4g}" + _unit_suffix(scales, unit_text)


def _unit_suffix(scales, unit_text):
    """Return a space and the physical unit, or ``""`` for the scene's units and dimensionless quantities."""
    return "" if scales is None or unit_text in ("", DIMENSIONLESS) else f" {unit_text}"


def require_unit_system(units):
    """Return a unit system if it is valid; raise ArgumentError otherwise.

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
        If `units` is unknown.
    """
    if not isinstance(units, str) or units not in UNIT_SYSTEMS:
        raise check.ArgumentError("units", f"must be one of {', '.join(UNIT_SYSTEMS)}", units)
    return units


def unit_in_system(scene: Scene, unit: str, units: str) -> tuple[str, float]:
    """Return the unit in which a quantity is displayed in a unit system.

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
        Symbol of the unit.
    factor : float
        Size of the scene's unit in the displayed unit.

    Raises
    ------
    ArgumentError
        If `units` is unknown, or is "physical" for a scene without scales.
    """
    require_unit_system(units)
    return display_unit(unit, None if units == "scene" else require_scales(scene))


def scales_attributes(scene):
    """Return the Dataset attributes that store the scales of a scene; empty for a scene without scales.

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
    """Read the scales of a scene from the attributes of a Dataset.

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
        If the Dataset has no scales.
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
        New dataset. Each variable whose attribute ``units`` is a unit of the scene is converted, and its ``units`` is
        the physical unit. All other variables and the attributes of the dataset are unchanged.

    Raises
    ------
    ArgumentError
        If `data` is not a dataset, or its scene has no scales.

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
        unit, unit_factor = display_unit(variable.attrs.get("units", ""), scales)
        if unit_factor != 1.0 or unit != variable.attrs.get("units", ""):
            physical_variable = xr.Variable(
                variable.dims, variable.values * unit_factor, {**variable.attrs, "units": unit}
            )
            physical_data = (
                physical_data.assign_coords({name: physical_variable})
                if name in data.coords
                else physical_data.assign({name: physical_variable})
            )
    return physical_data
