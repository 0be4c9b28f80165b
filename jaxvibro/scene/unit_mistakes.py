"""Values in a physical unit where the scene's own are due, in scenes with scales: refused, or asked about."""

import warnings

import numpy as np

from . import check

CERTAIN_FACTOR = 4.0  # times the scene's value: values all as far away, on a scene's physical value, are in its unit
RANGE_FACTOR = 2.0  # a few values may miss the scene's physical one by such a factor
UNIT_FACTOR = 2.0  # a physical unit that is nearer to the scene's is not told from it
FREQUENCY_FACTOR = 10.0  # times the scene's frequency: a sweep that begins so far is asked about


def physical_units(scales, name):
    """[(unit, how much of it one of the scene's units is)] of a scene's parameter; none of numbers without a unit."""
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
    """The scene's value of a parameter as a message tells it, "2.1" or with scales "2.1 (13.4 Hz)"."""
    value = float(scene.parameter(name))
    units = [] if scene.scales is None else physical_units(scene.scales, name)
    text = f"{value:.12g}"
    return f"{text} in the scene's unit, {units[0][1] * value:.4g} {units[0][0]}" if units else text


def find_unit_mistake(scene, name, lower, upper):
    """(unit, size) of the physical unit in which values from low to high are about the scene's; None where there is
    none, or where the scene's own number is among them."""
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
    """The end of a rule that values break as they are in a physical unit; "" where they are not."""
    mistake = find_unit_mistake(scene, name, lower, upper)
    return "" if mistake is None else f" (are these in {mistake[0]}? divide them by {mistake[1]:.6g})"


def require_scene_units(key, scene, name, values):
    """Refuse values of a parameter that can only be meant in a physical unit, and ask about those that may be.

    Raises ArgumentError. Warns where values may be meant so.
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
