"""Check the free parameters of a scene, their units and their bounds."""

from collections.abc import Mapping

import numpy as np

from ..scene import check
from ..scene.scene_parameters import parameter_domain
from ..scene.unit_mistakes import format_parameter_value, unit_hint


def check_free_parameters(scene, free):
    """Check the free parameters of a scene and their units.

    Parameters
    ----------
    scene : Scene
        The scene.
    free : dict of str to float
        Unit of each free parameter.

    Returns
    -------
    dict of str to float
        The same units as plain floats.

    Raises
    ------
    ArgumentError
        If `free` is empty, if a name is not a parameter of the scene, if a unit is not a positive number, or if two
        parameters depend on each other.
    """
    if not isinstance(free, Mapping) or not free:
        raise check.ArgumentError("free", "must be {name: unit} with at least one parameter", free)
    for name, unit in free.items():
        check.require_parameter(name, scene.names, name)
        unit_as_array = check.check_finite_array(f"free.{name}", unit, np.float64)
        if unit_as_array.ndim or unit_as_array <= 0:
            raise check.ArgumentError(f"free.{name}", "must be a positive number, the unit of the parameter", unit)
    if len(free) > 1:
        check.require_independent(*free)
    return {name: float(unit) for name, unit in free.items()}


def bounds_of_changes(scene, parameter_units, bounds):
    """Return the bounds of the change of each free parameter, in units of the parameter.

    Parameters
    ----------
    scene : Scene
        The scene from which changes are measured.
    parameter_units : dict of str to float
        Unit of each free parameter.
    bounds : dict of str to sequence of float
        Lower and upper bound of free parameters, by name. By default their domains.

    Returns
    -------
    lower : numpy.ndarray
        Lower bound of each change, within the domain of the parameter. Array of shape (free,).
    upper : numpy.ndarray
        Upper bound of each change. Array of shape (free,).

    Raises
    ------
    ArgumentError
        If `bounds` names a parameter that is not free, or if the bounds do not contain the value in the scene.
    """
    change_bound_pairs = []
    for name in bounds:
        if name not in parameter_units:
            raise check.ArgumentError(
                f"bounds.{name}",
                f"must belong to a free parameter{check.describe_choices(name, parameter_units)}",
                name,
            )
    for name, unit in parameter_units.items():
        value, domain_value_bounds = float(scene.parameter(name)), parameter_domain(scene, name)
        requested_value_bounds = bounds.get(name, domain_value_bounds)
        value_bounds_array = (
            np.asarray(requested_value_bounds, float)
            if np.shape(requested_value_bounds) == (2,)
            else np.full(2, np.nan)
        )
        if not value_bounds_array[0] <= value <= value_bounds_array[1]:
            rule = (
                "must be (low, high) and contain the value of the scene,"
                f" {format_parameter_value(scene, name)}{unit_hint(scene, name, *value_bounds_array)}"
            )
            raise check.ArgumentError(f"bounds.{name}", rule, requested_value_bounds)
        change_bound_pairs.append(
            [
                (max(requested_value_bounds[0], domain_value_bounds[0]) - value) / unit,
                (min(requested_value_bounds[1], domain_value_bounds[1]) - value) / unit,
            ]
        )
    lower, upper = np.array(change_bound_pairs).T
    return lower, upper
