"""What a parameter of a scene may be, and along which leaf of the scene it lies."""

from dataclasses import replace

import jax
import numpy as np

from . import check
from .scene import replace_unchecked
from .unit_mistakes import require_scene_units, unit_hint, value_text

EQUALITY_TOLERANCE = 8.0 * np.finfo(float).eps  # of a value: as near are two equal


def parameter_domain(scene, name):
    """(low, high): between them, ends left out where the walls would meet or the drive stand, the scene is one."""
    inf = np.inf
    if name.startswith("force."):
        return -inf, inf
    if name == "frequency" or name.endswith("stiffness"):
        return np.finfo(float).tiny, inf
    if name.endswith("damping"):
        return 0.0, inf
    if name.endswith("restitution"):
        return 0.0, 1.0
    if name.endswith("position") and len(scene.walls) == 2:
        total_amplitude = sum(
            abs(float(wall.motion.amplitude)) for wall in scene.walls.values() if wall.motion is not None
        )
        lower = -inf if name.startswith("left") else float(scene.left.position) + total_amplitude
        upper = inf if name.startswith("right") else float(scene.right.position) - total_amplitude
        return lower, upper
    return -inf, inf


def check_bounds(scene, name, bounds):
    """(low, high) as plain numbers, checked: two finite numbers, the first smaller, with the scene's value between."""
    check.require_parameter(name, scene.names, name)
    interval = np.asarray(bounds, float) if np.shape(bounds) == (2,) else np.array([np.nan, np.nan])
    if not (np.isfinite(interval).all() and interval[0] < interval[1]):
        raise check.ArgumentError("bounds", "must be (low, high), two finite numbers, the first smaller", bounds)
    value = float(scene.parameter(name))
    if not interval[0] <= value <= interval[1]:
        rule = f"must hold the start's {name}, {value_text(scene, name)}{unit_hint(scene, name, *interval)}"
        raise check.ArgumentError("bounds", rule, bounds)
    return float(interval[0]), float(interval[1])


def check_values(scene, name, values):
    """Values of a parameter as an array, checked: a row of one at least, with each of which the scene is one."""
    check.require_parameter(name, scene.names, values)
    array = check.real_array("values", values, np.float64)
    if array.ndim != 1 or not len(array):
        raise check.ArgumentError("values", f"must be a row of values of {name}, one at least", values)
    require_scene_units("values", scene, name, array)
    scene.replace(**{name: array})
    return array


def mark_parameters(scene, *names):
    """(the scene with numbers of its own at the parameters, the same tree with 1 at the first, 2 at the second, else
    0). A parameter may be several that have one value, a tuple of their names.

    The hardness of soft walls gets a leaf, whatever the parameters are: what is compiled is then the same for all. The
    numbers are NumPy's, as the host asks for each of them again and again.
    """
    scene = jax.tree.map(np.asarray, scene)
    for name in flatten_names(names):
        scene = replace_unchecked(scene, {name: 0.0 if name == "hardness" else scene.parameter(name)})
    if scene.hardens:
        scene = replace(scene, harder=np.zeros(()))
    marker_tree = jax.tree.map(lambda leaf: np.int32(0), scene)
    for number, group in enumerate(names, 1):
        for name in flatten_names([group]):
            marker = np.int32(number)
            marker_tree = (
                replace(marker_tree, harder=marker)
                if name == "hardness"
                else replace_unchecked(marker_tree, {name: marker})
            )
    return scene, marker_tree


def flatten_names(names):
    """Names of parameters, those in tuples too, in a row."""
    return [name for group in names for name in check.name_tuple("names", group)]


def common_value(scene, name):
    """The value of a parameter, or of several that are one, a tuple of names.

    Raises ArgumentError where their values differ: no number is then that of all.
    """
    values = {parameter: float(scene.parameter(parameter)) for parameter in check.name_tuple("names", name)}
    min_value, max_value = min(values.values()), max(values.values())
    if max_value - min_value > EQUALITY_TOLERANCE * max(abs(min_value), abs(max_value)):
        rule = "in one tuple must have one value; for a common shift take the sum of what each gives alone"
        raise check.ArgumentError("names", rule, values)
    return min_value
