"""Values in a physical unit where the scene's own are due, in scenes with scales: refused, or asked about."""

import warnings

import numpy as np

from . import check

APART = 4.0  # times the scene's value: values all as far away, on a scene's physical value, are in its unit
NARROW = 2.0  # a few values may miss the scene's physical one by such a factor
LIKE = 2.0  # a physical unit that is nearer to the scene's is not told from it
FAR = 10.0  # times the scene's frequency: a sweep that begins so far is asked about


def physical(scales, name):
    """[(unit, how much of it one of the scene's units is)] of a scene's parameter; none of numbers without a unit."""
    natural, length = scales.natural_frequency, scales.length
    last = "position" if name.endswith("motion.amplitude") else name.rpartition(".")[2]
    if name.startswith("force.") or ".law." in name:
        return []
    units = {
        "frequency": [("Hz", natural / (2.0 * np.pi)), ("rad/s", natural)],
        "amplitude": [("N", scales.stiffness * length)],
        "position": [("mm", 1e3 * length), ("m", length)],
        "stiffness": [("N/m", scales.stiffness), ("N/mm", 1e-3 * scales.stiffness)],
        "damping": [("N s/m", 2.0 * scales.mass * natural)],
    }
    return units.get(last, [])


def in_units(scene, name):
    """The scene's value of a parameter as a message tells it, "2.1" or with scales "2.1 (13.4 Hz)"."""
    value = float(scene.parameter(name))
    units = [] if scene.scales is None else physical(scene.scales, name)
    told = f"{value:.12g}"
    return f"{told} in the scene's unit, {units[0][1] * value:.4g} {units[0][0]}" if units else told


def slip(scene, name, low, high):
    """(unit, size) of the physical unit in which values from low to high are about the scene's; None where there is
    none, or where the scene's own number is among them."""
    if scene.scales is None or scene.shape:
        return None
    value = float(scene.parameter(name))
    if value == 0 or low <= value <= high:
        return None
    for unit, size in physical(scene.scales, name):
        ends = (low / NARROW if low > 0 else low * NARROW, high * NARROW if high > 0 else high / NARROW)
        if ends[0] <= size * value <= ends[1] and not 1.0 / LIKE < size < LIKE:
            return unit, size
    return None


def hint(scene, name, low, high):
    """The end of a rule that values break as they are in a physical unit; "" where they are not."""
    found = slip(scene, name, low, high)
    return "" if found is None else f" (are these in {found[0]}? divide them by {found[1]:.6g})"


def require_scene_units(key, scene, name, values):
    """Refuse values of a parameter that can only be meant in a physical unit, and ask about those that may be.

    Raises ArgumentError. Warns where values may be meant so.
    """
    values = np.asarray(values)
    if not values.size or scene.scales is None or scene.shape:
        return
    low, high, value = float(values.min()), float(values.max()), float(scene.parameter(name))
    found = slip(scene, name, low, high)
    least, most = abs(values).min(), abs(values).max()
    if found is not None and (least >= APART * abs(value) or most <= abs(value) / APART):
        rule = f"must be in the scene's unit, in which {name} is {value:.6g}: these look like {found[0]}"
        raise check.ArgumentError(key, f"{rule}; divide them by {found[1]:.6g}", f"values from {low:.6g} to {high:.6g}")
    if found is not None or (name == "frequency" and low > FAR * value):
        unit, size = found or physical(scene.scales, name)[0]
        told = f"values of {name} are in the scene's unit, in which it is {value:.6g}: are these in {unit}?"
        warnings.warn(f"{told} Divide them by {size:.6g}", UserWarning, stacklevel=5)
