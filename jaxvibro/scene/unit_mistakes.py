"""Detect values that are in a physical unit instead of the scene's unit, for scenes with scales."""

import warnings

import numpy as np

from . import check

# Values that all differ by this factor from the scene's value, and match its physical value, are in the physical unit.
CERTAIN_FACTOR = 4.0
RANGE_FACTOR = 2.0  # largest factor between the values and the scene's physical value
UNIT_FACTOR = 2.0  # a physical unit nearer to the scene's unit cannot be distinguished from it
FREQUENCY_FACTOR = 10.0  # ratio of the lowest value to the scene's frequency that causes a warning


def physical_units(scales, name):
    """Return ``[(physical unit, size of the scene's unit in this unit)]``; empty if the parameter has no unit."""
    natural_frequency, length = scales.natural_frequency, scales.length
    quantity_name = "position" if name.endswith("motion.amplitude") else name.rpartition(".")[2]
    if name.startswith("force.") or ".law." in name:
        return []
    units = {
        "frequency": [("Hz", natural_frequency / (2.0 * np.pi)), ("rad/s", natural_frequency)],
        "amplitude": [("N", scales.stiffness * length)],
        "position": [("mm", 1e3 * length), ("m", length)],
        "stiffness": [("N/m", scales.stiffness), ("N/mm", 1e-3 * scales.stiffness)],
        "damping": [("N s/m", 2.0 * scales.mass * natural_frequency)],
    }
    return units.get(quantity_name, [])


def format_parameter_value(scene, name):
    """Format the scene's value of a parameter, with its physical value if the scene has scales.

    Parameters
    ----------
    scene : Scene
        Single scene.
    name : str
        Name of the parameter.

    Returns
    -------
    str
        For example "2.1", or "2.1 in the scene's unit, 13.4 Hz".
    """
    value = float(scene.parameter(name))
    units = [] if scene.scales is None else physical_units(scene.scales, name)
    scene_value_text = f"{value:.12g}"
    return (
        f"{scene_value_text} in the scene's unit, {units[0][1] * value:.4g} {units[0][0]}"
        if units
        else scene_value_text
    )


def find_unit_mistake(scene, name, min_user_value, max_user_value):
    """Return (unit, size) of the physical unit in which an interval of values is near the scene's value.

    The result is None if there is no such unit, or if the scene's value itself is in the interval.
    """
    if scene.scales is None or scene.shape:
        return None
    value = float(scene.parameter(name))
    if value == 0 or min_user_value <= value <= max_user_value:
        return None
    for unit_name, unit_factor in physical_units(scene.scales, name):
        tolerant_bounds = (
            min_user_value / RANGE_FACTOR if min_user_value > 0 else min_user_value * RANGE_FACTOR,
            max_user_value * RANGE_FACTOR if max_user_value > 0 else max_user_value / RANGE_FACTOR,
        )
        if (
            tolerant_bounds[0] <= unit_factor * value <= tolerant_bounds[1]
            and not 1.0 / UNIT_FACTOR < unit_factor < UNIT_FACTOR
        ):
            return unit_name, unit_factor
    return None


def unit_hint(scene, name, min_user_value, max_user_value):
    """Return the end of an error message, which asks about a physical unit.

    Parameters
    ----------
    scene : Scene
        Single scene.
    name : str
        Name of the parameter.
    min_user_value, max_user_value : float
        Interval of the values.

    Returns
    -------
    str
        The hint, "" if the values are not near the scene's value in a physical unit.
    """
    unit_name_and_factor = find_unit_mistake(scene, name, min_user_value, max_user_value)
    return (
        ""
        if unit_name_and_factor is None
        else f" (are these in {unit_name_and_factor[0]}? divide them by {unit_name_and_factor[1]:.6g})"
    )


def require_scene_units(key, scene, name, values):
    """Check that values of a parameter are in the scene's unit.

    Parameters
    ----------
    key : str
        Argument, for the message.
    scene : Scene
        The scene. A batch, or a scene without scales, is not checked.
    name : str
        Name of the parameter.
    values : array_like
        The values.

    Raises
    ------
    ArgumentError
        If the values are certainly in a physical unit.

    Warns
    -----
    UserWarning
        If the values may be in a physical unit.
    """
    values = np.asarray(values)
    if not values.size or scene.scales is None or scene.shape:
        return
    min_user_value, max_user_value, scene_parameter_value = (
        float(values.min()),
        float(values.max()),
        float(scene.parameter(name)),
    )
    unit_name_and_factor = find_unit_mistake(scene, name, min_user_value, max_user_value)
    min_user_magnitude, max_user_magnitude = abs(values).min(), abs(values).max()
    if unit_name_and_factor is not None and (
        min_user_magnitude >= CERTAIN_FACTOR * abs(scene_parameter_value)
        or max_user_magnitude <= abs(scene_parameter_value) / CERTAIN_FACTOR
    ):
        rule = (
            f"must be in the scene's unit, in which {name} is {scene_parameter_value:.6g}: these look like"
            f" {unit_name_and_factor[0]}"
        )
        raise check.ArgumentError(
            key,
            f"{rule}; divide them by {unit_name_and_factor[1]:.6g}",
            f"values from {min_user_value:.6g} to {max_user_value:.6g}",
        )
    if unit_name_and_factor is not None or (
        name == "frequency" and min_user_value > FREQUENCY_FACTOR * scene_parameter_value
    ):
        unit_name, unit_factor = unit_name_and_factor or physical_units(scene.scales, name)[0]
        message = (
            f"values of {name} are in the scene's unit, in which it is {scene_parameter_value:.6g}: are"
            f" these in {unit_name}?"
        )
        warnings.warn(f"{message} Divide them by {unit_factor:.6g}", UserWarning, stacklevel=5)
