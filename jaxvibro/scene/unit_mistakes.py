"""Find values in a physical unit where the scene's unit is due, in scenes with scales."""

import warnings

import numpy as np

from . import check

# Values that all differ by this factor from the scene's value, and match its physical value, are in the physical unit.
CERTAIN_FACTOR = 4.0
RANGE_FACTOR = 2.0  # largest factor between the values and the scene's physical value
UNIT_FACTOR = 2.0  # a physical unit nearer to the scene's unit cannot be distinguished from it
FREQUENCY_FACTOR = 10.0  # ratio of the lowest value to the scene's frequency that causes a warning


def physical_units(scales, name):
    """Return ``[(unit, size of the scene's unit in it)]`` for a parameter, empty without a unit."""
    natural_frequency, length = scales.natural_frequency, scales.length
    quantity = "position" if name.endswith("motion.amplitude") else name.rpartition(".")[2]
    if name.startswith("force.") or ".law." in name:
        return []
    units = {
        "frequency": [("Hz", natural_frequency / (2.0 * np.pi)), ("rad/s", natural_frequency)],
        "amplitude": [("N", scales.stiffness * length)],
        "position": [("mm", 1e3 * length), ("m", length)],
        "stiffness": [("N/m", scales.stiffness), ("N/mm", 1e-3 * scales.stiffness)],
        "damping": [("N s/m", 2.0 * scales.mass * natural_frequency)],
    }
    return units.get(quantity, [])


def value_text(scene, name):
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
    text = f"{value:.12g}"
    return f"{text} in the scene's unit, {units[0][1] * value:.4g} {units[0][0]}" if units else text


def find_unit_mistake(scene, name, lower, upper):
    """Return (unit, size) of the physical unit in which an interval is near the scene's value.

    None if there is no such unit, or if the scene's value itself is in the interval.
    """
    if scene.scales is None or scene.shape:
        return None
    value = float(scene.parameter(name))
    if value == 0 or lower <= value <= upper:
        return None
    for unit, factor in physical_units(scene.scales, name):
        bounds = (
            lower / RANGE_FACTOR if lower > 0 else lower * RANGE_FACTOR,
            upper * RANGE_FACTOR if upper > 0 else upper / RANGE_FACTOR,
        )
        if bounds[0] <= factor * value <= bounds[1] and not 1.0 / UNIT_FACTOR < factor < UNIT_FACTOR:
            return unit, factor
    return None


def unit_hint(scene, name, lower, upper):
    """Return the end of a rule that asks about a physical unit.

    Parameters
    ----------
    scene : Scene
        Single scene.
    name : str
        Name of the parameter.
    lower, upper : float
        Interval of the values.

    Returns
    -------
    str
        The hint, "" if the values are not near the scene's value in a physical unit.
    """
    mistake = find_unit_mistake(scene, name, lower, upper)
    return "" if mistake is None else f" (are these in {mistake[0]}? divide them by {mistake[1]:.6g})"


def require_scene_units(key, scene, name, values):
    """Check that values of a parameter are in the scene's unit.

    Parameters
    ----------
    key : str
        Argument, for the message.
    scene : Scene
        The scene; without scales, or for a batch, nothing is checked.
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
    lower, upper, value = float(values.min()), float(values.max()), float(scene.parameter(name))
    mistake = find_unit_mistake(scene, name, lower, upper)
    min_size, max_size = abs(values).min(), abs(values).max()
    if mistake is not None and (min_size >= CERTAIN_FACTOR * abs(value) or max_size <= abs(value) / CERTAIN_FACTOR):
        rule = f"must be in the scene's unit, in which {name} is {value:.6g}: these look like {mistake[0]}"
        raise check.ArgumentError(
            key, f"{rule}; divide them by {mistake[1]:.6g}", f"values from {lower:.6g} to {upper:.6g}"
        )
    if mistake is not None or (name == "frequency" and lower > FREQUENCY_FACTOR * value):
        unit, factor = mistake or physical_units(scene.scales, name)[0]
        message = f"values of {name} are in the scene's unit, in which it is {value:.6g}: are these in {unit}?"
        warnings.warn(f"{message} Divide them by {factor:.6g}", UserWarning, stacklevel=5)
