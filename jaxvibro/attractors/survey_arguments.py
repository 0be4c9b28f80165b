"""Check the arguments of surveys: values of a parameter, and the initial state."""

import numpy as np

from ..scene import check
from ..scene.scene_parameters import require_scene_units
from ..scene.state import State

SEQUENCE_RULE = "must be a sequence of at least one value"


def check_survey_values(scene, name, values, key, rule, is_valid):
    """Check the values of a parameter and return them as an array of the scene's type.

    Parameters
    ----------
    scene : Scene
        Scene.
    name : str
        Name of the parameter.
    values : array_like
        Values.
    key : str
        Argument that contains the values, for the error of values that look like SI units.
    rule : str
        Rule for the shape and the order of the values, for the error message.
    is_valid : callable
        Function of the array that returns True if it obeys the rule.

    Returns
    -------
    ndarray
        Finite values.

    Raises
    ------
    ArgumentError
        If the parameter is unknown, or the values are not finite, break the rule or look like SI units.
    """
    check.require_parameter(name, scene.names, name)
    value_array = check.check_finite_array(name, values, scene.dtype)
    if not is_valid(value_array):
        raise check.ArgumentError(name, rule, value_array)
    require_scene_units(key, scene, name, value_array)
    return value_array


def is_increasing(values):
    """Return True for a one-dimensional array of at least one value in increasing order."""
    return values.ndim == 1 and len(values) > 0 and bool((np.diff(values) > 0).all())


def check_start_state(state, dtype, other_named_arrays):
    """Return the state as finite arrays of type `dtype`, which must broadcast with the named arrays."""
    component_names = ("x", "v", "phase", "contact")
    arrays = [check.check_finite_array(f"state.{key}", getattr(state, key), dtype) for key in component_names]
    check.require_broadcast(
        [*other_named_arrays, *zip((f"state.{key}" for key in component_names), arrays, strict=True)]
    )
    return State(*arrays)
