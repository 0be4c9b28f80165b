"""Define the domain of each parameter of a scene, and the leaf of the scene that holds it."""

from dataclasses import replace

import jax
import numpy as np

from . import check
from .scene import replace_unchecked
from .unit_mistakes import require_scene_units, unit_hint, value_text

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
        Upper end. An end at which the walls meet or the frequency is 0 is not itself a valid value.
    """
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
    interval = np.asarray(bounds, float) if np.shape(bounds) == (2,) else np.array([np.nan, np.nan])
    if not (np.isfinite(interval).all() and interval[0] < interval[1]):
        raise check.ArgumentError("bounds", "must be (low, high), two finite numbers, the first smaller", bounds)
    value = float(scene.parameter(name))
    if not interval[0] <= value <= interval[1]:
        rule = f"must contain the initial {name}, {value_text(scene, name)}{unit_hint(scene, name, *interval)}"
        raise check.ArgumentError("bounds", rule, bounds)
    return float(interval[0]), float(interval[1])


def check_values(scene, name, values):
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
    array = check.real_array("values", values, np.float64)
    if array.ndim != 1 or not len(array):
        raise check.ArgumentError("values", f"must be a one-dimensional array of at least one value of {name}", values)
    require_scene_units("values", scene, name, array)
    scene.replace(**{name: array})
    return array


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
        The scene with its own numbers at the parameters.
    markers : Scene
        The same tree with 1 at the first parameter, 2 at the second, and 0 elsewhere.

    Notes
    -----
    The hardness of soft walls gets a leaf for any choice of parameters, so that the compiled code is the same for all.
    The numbers are NumPy arrays, because the host reads each of them many times.
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
    """Return names of parameters, those in tuples included, in one list.

    Parameters
    ----------
    names : sequence of str or tuple of str
        The names.

    Returns
    -------
    list of str
        The names in order.
    """
    return [name for group in names for name in check.name_tuple("names", group)]


def common_value(scene, name):
    """Return the value of a parameter, or the common value of several that are varied together.

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
    values = {parameter: float(scene.parameter(parameter)) for parameter in check.name_tuple("names", name)}
    min_value, max_value = min(values.values()), max(values.values())
    if max_value - min_value > EQUALITY_TOLERANCE * max(abs(min_value), abs(max_value)):
        rule = "must have one value in one tuple; for a common shift add the results of each alone"
        raise check.ArgumentError("names", rule, values)
    return min_value
