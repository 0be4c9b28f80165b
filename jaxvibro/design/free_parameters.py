"""Check the free parameters of a scene: the unit of each, in which changes are measured, and its bounds."""

from collections.abc import Mapping

import numpy as np

from ..scene import check
from ..scene.parameters import parameter_domain
from ..scene.unit_mistakes import unit_hint, value_text


def check_units(scene, free):
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
        number = check.finite_array(f"free.{name}", unit, np.float64)
        if number.ndim or number <= 0:
            raise check.ArgumentError(f"free.{name}", "must be a positive number, the unit of the parameter", unit)
    if len(free) > 1:
        check.require_independent(*free)
    return {name: float(unit) for name, unit in free.items()}


def allowed_changes(scene, units, bounds):
    """Return the bounds of the change of each free parameter in its unit.

    Parameters
    ----------
    scene : Scene
        The scene from which changes are measured.
    units : dict of str to float
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
        If a bound is not that of a free parameter, or if the bounds do not contain the value of the scene.
    """
    change_bounds = []
    for name in bounds:
        if name not in units:
            raise check.ArgumentError(
                f"bounds.{name}", f"must belong to a free parameter{check.describe_choices(name, units)}", name
            )
    for name, unit in units.items():
        value, domain_bounds = float(scene.parameter(name)), parameter_domain(scene, name)
        requested_bounds = bounds.get(name, domain_bounds)
        numeric_bounds = (
            np.asarray(requested_bounds, float) if np.shape(requested_bounds) == (2,) else np.full(2, np.nan)
        )
        if not numeric_bounds[0] <= value <= numeric_bounds[1]:
            rule = (
                "must be (low, high) and contain the value of the scene,"
                f" {value_text(scene, name)}{unit_hint(scene, name, *numeric_bounds)}"
            )
            raise check.ArgumentError(f"bounds.{name}", rule, requested_bounds)
        change_bounds.append(
            [
                (max(requested_bounds[0], domain_bounds[0]) - value) / unit,
                (min(requested_bounds[1], domain_bounds[1]) - value) / unit,
            ]
        )
    lower, upper = np.array(change_bounds).T
    return lower, upper
