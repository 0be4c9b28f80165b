"""Define the parameters of a scene: leaf, domain, and values in another unit that are detected."""

import warnings
from dataclasses import replace

import jax
import numpy as np

from . import check
from .scene import replace_unchecked
from .scene_checks import RULES

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


EQUALITY_TOLERANCE = 8.0 * np.finfo(float).eps  # relative difference up to which two values count as equal


def parameter_domain(scene, name):
    """Return the interval of values that a parameter may have.

    Parameters
    ----------
    scene : Scene
        Single scene.
    name : str
        Name of the parameter.

    Returns
    -------
    lower : float
        Lower end.
    upper : float
        Upper end. An end at which the walls meet is not a valid value.
    """
    quantity, infinity = name.rpartition(".")[2], np.inf
    if quantity in RULES and not name.startswith("force."):
        return RULES[quantity].domain
    if name.endswith("position") and len(scene.walls) == 2:
        total_wall_amplitude = sum(
            abs(float(wall.motion.amplitude)) for wall in scene.walls.values() if wall.motion is not None
        )
        lower = -infinity if name.startswith("left") else float(scene.left.position) + total_wall_amplitude
        upper = infinity if name.startswith("right") else float(scene.right.position) - total_wall_amplitude
        return lower, upper
    return -infinity, infinity


def limit_bounds_to_domains(scene, names, bounds):
    """Limit bounds of parameters to the domains of the parameters.

    Parameters
    ----------
    scene : Scene
        Single scene.
    names : sequence of str
        Names of the parameters.
    bounds : iterable of tuple of float
        (low, high) of each parameter.

    Returns
    -------
    limited_bounds : tuple of tuple of float
        (low, high) of each parameter within its domain.
    domain_ends : tuple of tuple of float
        For each parameter, the ends of its domain that are not bounds.
    """
    intervals = [(interval, parameter_domain(scene, name)) for name, interval in zip(names, bounds, strict=True)]
    limited_bounds = tuple((max(interval[0], domain[0]), min(interval[1], domain[1])) for interval, domain in intervals)
    domain_ends = tuple(tuple(end for end in domain if end not in interval) for interval, domain in intervals)
    return limited_bounds, domain_ends


def check_parameter_bounds(scene, name, bounds):
    """Check the bounds of a parameter.

    Parameters
    ----------
    scene : Scene
        Single scene.
    name : str
        Name of the parameter.
    bounds : tuple of float
        Lower and upper bound.

    Returns
    -------
    lower : float
        Lower bound.
    upper : float
        Upper bound.

    Raises
    ------
    ArgumentError
        If `name` is not a parameter, or `bounds` are not two finite numbers, the first smaller, that enclose the
        scene's value.
    """
    check.require_parameter(name, scene.names, name)
    checked_bounds = np.asarray(bounds, float) if np.shape(bounds) == (2,) else np.array([np.nan, np.nan])
    if not (np.isfinite(checked_bounds).all() and checked_bounds[0] < checked_bounds[1]):
        raise check.ArgumentError("bounds", "must be (low, high), two finite numbers, the first smaller", bounds)
    value = float(scene.parameter(name))
    if not checked_bounds[0] <= value <= checked_bounds[1]:
        rule = (
            f"must contain the initial {name},"
            f" {format_parameter_value(scene, name)}{unit_hint(scene, name, *checked_bounds)}"
        )
        raise check.ArgumentError("bounds", rule, bounds)
    return float(checked_bounds[0]), float(checked_bounds[1])


def check_parameter_values(scene, name, values):
    """Check values of a parameter.

    Parameters
    ----------
    scene : Scene
        Single scene.
    name : str
        Name of the parameter.
    values : array_like
        One-dimensional, with at least one value.

    Returns
    -------
    ndarray
        The values, float64.

    Raises
    ------
    ArgumentError
        If `name` is not a parameter, or a value makes no valid scene.
    """
    check.require_parameter(name, scene.names, values)
    checked_values = check.check_real_array("values", values, np.float64)
    if checked_values.ndim != 1 or not len(checked_values):
        raise check.ArgumentError("values", f"must be a one-dimensional array of at least one value of {name}", values)
    require_scene_units("values", scene, name, checked_values)
    scene.replace(**{name: checked_values})
    return checked_values


def mark_parameters(scene, *names):
    """Mark the leaves of the scene that hold some parameters.

    Parameters
    ----------
    scene : Scene
        Single scene.
    *names : str or tuple of str
        Parameters. A tuple of names is one parameter that several leaves share.

    Returns
    -------
    scene : Scene
        The scene with a leaf for each parameter, which holds the value of the parameter. If the hardness is among the
        parameters, the soft walls have the hardness 0, and the leaf `harder` is 0.
    markers : Scene
        Tree of the same structure with 1 at the first parameter, 2 at the second, and 0 elsewhere.

    Notes
    -----
    The scene gets the leaf `harder`, an increase of the hardness, for any choice of parameters if the scene has a
    hardness. The compiled code is therefore the same for all choices. The leaves are NumPy arrays, because the host
    reads them many times.
    """
    scene = jax.tree.map(np.asarray, scene)
    for name in flatten_names(names):
        scene = replace_unchecked(scene, {name: 0.0 if name == "hardness" else scene.parameter(name)})
    if scene.hardens:
        scene = replace(scene, harder=np.zeros(()))
    marker_tree = jax.tree.map(lambda leaf: np.int32(0), scene)
    for marker_value, name_or_tuple in enumerate(names, 1):
        for name in flatten_names([name_or_tuple]):
            marker = np.int32(marker_value)
            marker_tree = (
                replace(marker_tree, harder=marker)
                if name == "hardness"
                else replace_unchecked(marker_tree, {name: marker})
            )
    return scene, marker_tree


def flatten_names(names):
    """Return the names of parameters, with tuples of names flattened, as one list.

    Parameters
    ----------
    names : sequence of str or tuple of str
        The names.

    Returns
    -------
    list of str
        The names in order.
    """
    return [name for name_or_tuple in names for name in check.make_name_tuple("names", name_or_tuple)]


def common_parameter_value(scene, name):
    """Return the value of a parameter, or the common value of several parameters that vary together.

    Parameters
    ----------
    scene : Scene
        Single scene.
    name : str or tuple of str
        One parameter, or several.

    Returns
    -------
    float
        The value.

    Raises
    ------
    ArgumentError
        If the values differ.
    """
    values = {
        parameter_name: float(scene.parameter(parameter_name))
        for parameter_name in check.make_name_tuple("names", name)
    }
    min_value, max_value = min(values.values()), max(values.values())
    if max_value - min_value > EQUALITY_TOLERANCE * max(abs(min_value), abs(max_value)):
        rule = "must have one value in one tuple; for a common shift add the results of each alone"
        raise check.ArgumentError("names", rule, values)
    return min_value
