"""Compute derivatives of the value of a special point with respect to other scene parameters: `sensitivity`.

A special point satisfies ``L(y, q) = 0`` (`special_point_equations`). The unknowns ``y`` include the value, and ``q``
are all numbers of the scene. The derivative is the row of ``-(L_y)^-1 L_q`` that belongs to the value. The gradient of
`located` is the same derivative."""

from collections.abc import Sequence

import jax
import numpy as np
import xarray as xr

from continuation.hostcall import persistent_jit
from continuation.implicit_function import root_derivatives

from ..branches.branch import Special
from ..loci.locus_start import check_special_point, problems_at_locus_start
from ..scene import check
from ..scene.scene import SIDES
from ..scene.scene_parameters import common_parameter_value, flatten_names
from ..scene.scene_properties import stays_symmetric
from .special_point_equations import SpecialPointEquations, complete_scene, equations_at_point, parameter_mask

EQUAL_TOLERANCE = 1e-6  # derivatives closer than this agree


@check.host_only("use jax.grad of located")
def sensitivity(
    special: Special, names: str | Sequence[str | tuple[str, ...]] | None = None, wall: str | None = None
) -> xr.DataArray:
    """Compute the derivatives of the value of a special point with respect to other parameters.

    Parameters
    ----------
    special : Special
        Special point of a branch, of kind SN, PD, SB or GR.
    names : str or sequence of str or tuple of str, optional
        Parameters other than that of the point. By default all parameters for which the scene has numbers, except the
        hardness and, at an SB, the parameters that break the symmetry. A tuple is one parameter of several numbers that
        share a value and change together: ``[("left.damping", "right.damping")]``. If their values differ, the
        derivative is that of a common shift, the sum of the individual derivatives.
    wall : {"left", "right"}, optional
        Wall of a GR that touches both walls at once. The value has a corner with respect to a parameter that moves one
        of the walls. The result is then the derivative of the value at which the given wall is touched. This derivative
        holds on the side of the corner on which the given wall is touched first.

    Returns
    -------
    xarray.DataArray
        Derivatives along the dimension ``"number"``. The coordinate ``"value"`` holds the value of each parameter.

    Raises
    ------
    ArgumentError
        If the point is of another kind, if `names` is invalid, for example because a parameter breaks the symmetry that
        an SB requires, or if the value has a corner and no wall is given. The attribute ``value`` of
        this error holds the derivatives for each wall.

    See Also
    --------
    located : Value of a special point as a differentiable function of scenes.

    Examples
    --------
    >>> derivatives = jv.sensitivity(branch.points("SN")[0], ["damping", "frequency"])
    >>> round(float(derivatives.sel(number="damping")), 6)
    4.00908
    """
    check_special_point(special)
    name_groups = _check_name_groups(special, names)
    if wall not in (None, *SIDES):
        raise check.ArgumentError("wall", 'must be "left", "right" or None', wall)
    values = [common_parameter_value(special.scene, name_group) for name_group in name_groups]
    parameter_masks = np.stack(
        [np.max([parameter_mask(special.scene, name) for name in name_group], axis=0) for name_group in name_groups]
    )
    derivatives = _select_wall_derivatives(
        [(side, parameter_masks @ number_derivatives) for side, number_derivatives in _contact_derivatives(special)],
        wall,
    )
    array_attributes = {"long_name": f"d {special.name} / d number", "point": f"{special.kind} of {special.label}"}
    array_coordinates = {"number": [" = ".join(name_group) for name_group in name_groups], "value": ("number", values)}
    return xr.DataArray(
        derivatives, array_coordinates, ("number",), attrs=array_attributes | {special.name: special.value}
    )


def _check_name_groups(special, names):
    """Check the parameter names and return each as a tuple of names."""
    scene, point_parameter = special.scene, special.name
    if names is None:
        return [
            (name,)
            for name in scene.names
            if name not in (point_parameter, "hardness") and _is_allowed_parameter(special, name)
        ]
    name_groups = [check.make_name_tuple("names", entry) for entry in check.make_name_tuple("names", names)]
    all_names = flatten_names(name_groups)
    for name in all_names:
        check.require_parameter(name, scene.names, name)
    if not name_groups or not all(name_groups) or point_parameter in all_names or len(set(all_names)) < len(all_names):
        raise check.ArgumentError(
            "names", f"must be one or more different parameters other than {point_parameter}", names
        )
    check.require_independent(point_parameter, *all_names)
    for name_group in name_groups:
        if not _keeps_point_kind(special, name_group):
            raise check.ArgumentError("names", "must keep the scene symmetric, as an SB requires", name_group)
    return name_groups


def _is_allowed_parameter(special, name):
    depends_on_hardness = special.name == "hardness" and name.endswith((".stiffness", ".damping"))
    return not depends_on_hardness and _keeps_point_kind(special, (name,))


def _keeps_point_kind(special, name_group):
    """Check that a parameter preserves the symmetry that the kind of the point requires."""
    return special.kind != "SB" or stays_symmetric(special.scene, *name_group)


def _contact_derivatives(special):
    """Yield (side of the wall, derivatives of the value by all numbers of the scene) for each grazing contact.

    The side is None for a point other than a GR, which yields a single pair. Contacts that do not determine the value
    are omitted.
    """
    scene = complete_scene(special.scene)
    point_parameter_mask = parameter_mask(special.scene, special.name)
    scene_vector = np.stack([np.asarray(leaf) for leaf in jax.tree.leaves(scene)]) * (1.0 - point_parameter_mask)
    for problem_and_z in problems_at_locus_start(
        special.kind, special.scene, special.spot, (special.name,), use_whole_orbit=True
    ):
        equations, unknowns = equations_at_point(special.kind, *problem_and_z)
        if special.name == "hardness":
            unknowns[equations.n_orbit_unknowns] = 0.0
        jacobians = _point_jacobians(equations, unknowns, scene_vector, point_parameter_mask)
        try:
            value_derivatives = root_derivatives(*jacobians)[equations.n_orbit_unknowns]
        except np.linalg.LinAlgError:
            continue
        yield (SIDES[int(equations.sequence.sides[0] > 0)] if equations.is_grazing else None), value_derivatives


@persistent_jit(numpy_first=True)
def _point_jacobians(equations, unknowns, scene_vector, scene_direction):
    """Return the Jacobians of the equations of the point by their unknowns and by the numbers of the scene."""
    return jax.jacfwd(SpecialPointEquations.residual, (1, 2))(equations, unknowns, scene_vector, scene_direction)


def _select_wall_derivatives(derivatives_by_contact, wall):
    """Return the derivatives at the given wall, or those on which all contacts agree; else raise ArgumentError."""
    wall_matches = [(side, derivatives) for side, derivatives in derivatives_by_contact if wall in (None, side)]
    if not wall_matches:
        raise check.ArgumentError("wall", "must be a touched wall on which the value of the point depends", wall)
    _, derivatives = wall_matches[0]
    if all(
        np.allclose(derivatives, match_derivatives, rtol=EQUAL_TOLERANCE, atol=EQUAL_TOLERANCE)
        for _, match_derivatives in wall_matches
    ):
        return derivatives
    derivatives_by_side = {
        side: [float(f"{number:.6g}") for number in derivatives] for side, derivatives in sorted(wall_matches)
    }
    raise check.ArgumentError(
        "wall", 'must be "left" or "right" at a corner; each holds where its wall is touched first', derivatives_by_side
    )
