"""Define the free parameters of a scene: units, bounds, and the scenes that they span."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float

from continuation.array_type import Array

from ..scene import check
from ..scene.scene import Scene
from ..scene.scene_parameters import format_parameter_value, parameter_domain, unit_hint
from .special_point_equations import complete_scene, parameter_mask


class SceneSpace(NamedTuple):
    """Scenes that free parameters span, as vectors of all numbers of the scene.

    Attributes
    ----------
    treedef : jax.tree_util.PyTreeDef
        Tree structure of the complete scene.
    scene_vector : numpy.ndarray
        Numbers of the scene from which changes are measured. Array of shape (numbers,).
    unit_changes : numpy.ndarray
        Change of these numbers for one unit of each free parameter. Array of shape (free, numbers).
    """

    treedef: jax.tree_util.PyTreeDef
    scene_vector: Float[np.ndarray, " numbers"]
    unit_changes: Float[np.ndarray, "free numbers"]

    def vector_after(self, change: Float[np.ndarray, "*rows free"]) -> Float[np.ndarray, "*rows numbers"]:
        """Return the numbers of the scene after a change, in units."""
        return self.scene_vector + change @ self.unit_changes


@dataclass(frozen=True, eq=False)
class FreeParameters:
    """Free parameters of a scene. Their changes are measured in units.

    Attributes
    ----------
    scene : Scene
        Scene from which changes are measured.
    units : dict of str to float
        Unit of each free parameter.
    lower, upper : numpy.ndarray
        Bounds of the change of each free parameter, in units. Arrays of shape (free,).
    """

    scene: Scene
    units: dict[str, float]
    lower: Float[np.ndarray, " free"]
    upper: Float[np.ndarray, " free"]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the free parameters."""
        return tuple(self.units)

    def values_after(self, change: Float[Array, "*rows free"]) -> dict[str, Any]:
        """Return the values of the free parameters after a change."""
        units_and_changes = zip(self.units.items(), change.T, strict=True)
        return {name: float(self.scene.parameter(name)) + unit * step for (name, unit), step in units_and_changes}

    def scene_after(self, change: Float[Array, "*rows free"]) -> Scene:
        """Return the scene after a change; several rows of changes give a batch of scenes."""
        return self.scene.replace(**self.values_after(change))

    def changes_by_name(self, change: Float[np.ndarray, " free"]) -> dict[str, float]:
        """Return the change of each free parameter, not in units."""
        return {name: float(unit * step) for (name, unit), step in zip(self.units.items(), change, strict=True)}

    def select_names(self, mask: Bool[np.ndarray, " free"]) -> tuple[str, ...]:
        """Return the names of the free parameters in a mask."""
        return tuple(name for name, is_selected in zip(self.units, mask, strict=True) if is_selected)

    def scene_space(self) -> SceneSpace:
        """Return the scenes that the free parameters span as a `SceneSpace`."""
        leaves, treedef = jax.tree.flatten(complete_scene(self.scene))
        unit_changes = [parameter_mask(self.scene, name) * unit for name, unit in self.units.items()]
        return SceneSpace(treedef, np.stack([np.asarray(leaf) for leaf in leaves]), np.stack(unit_changes))


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
