"""Compute derivatives of the value of a special point with respect to the other numbers of its scene: `sensitivity`.

A point satisfies ``L(y, q) = 0`` (`point_equations`), with its unknowns ``y``, which include the value, and all numbers
``q`` of the scene. The derivative is the row of ``-(L_y)^-1 L_q`` that belongs to the value. `located` has the same
derivative for a single point.
"""

from collections.abc import Sequence

import jax
import numpy as np
import xarray as xr

from continuation.persistent_jit import persistent_jit

from ..branches.branch import Special
from ..loci.locus_start import locus_problems, make_locus_start
from ..scene import check
from ..scene.parameters import common_value, flatten_names
from ..scene.scene import SIDES
from ..scene.symmetry import stays_symmetric
from .point_equations import PointEquations, complete_scene, equations_at_point, parameter_mask

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
        Parameters other than that of the point. By default all parameters for which the scene has numbers. A tuple is
        one parameter of several numbers that share a value and change together: ``[("left.damping",
        "right.damping")]``. If their values differ, the derivative is that of a common shift, the sum of the individual
        derivatives.
    wall : {"left", "right"}, optional
        Wall of a GR that touches both walls at once. The value has a corner with respect to a parameter that moves one
        of them. The result is then the derivative of the value at which this wall is touched. It holds on the side on
        which this wall is touched first.

    Returns
    -------
    xarray.DataArray
        Derivatives along the dimension ``"number"``. The coordinate ``"value"`` holds the value of each parameter.

    Raises
    ------
    ArgumentError
        If the point is of another kind, if `names` is invalid, for example because a parameter breaks the symmetry that
        an SB requires, or if the value has a corner and no wall is given. The value of this error holds the derivatives
        for each wall.

    See Also
    --------
    located : Value of a special point as a differentiable function of scenes.

    Examples
    --------
    >>> derivatives = jv.sensitivity(branch.points("SN")[0], ["damping", "frequency"])
    >>> round(float(derivatives.sel(number="damping")), 6)
    4.00908
    """
    locus_start = make_locus_start(special)
    name_groups = _parse_names(locus_start, names)
    if wall not in (None, *SIDES):
        raise check.ArgumentError("wall", 'must be "left", "right" or None', wall)
    values = [common_value(locus_start.scene, name_group) for name_group in name_groups]
    masks = np.stack(
        [np.max([parameter_mask(locus_start.scene, name) for name in name_group], axis=0) for name_group in name_groups]
    )
    derivatives = _select_wall(
        [(side, masks @ wall_derivatives) for side, wall_derivatives in _contact_derivatives(locus_start)], wall
    )
    attributes = {"long_name": f"d {special.name} / d number", "point": f"{special.kind} of {special.label}"}
    labels = {"number": [" = ".join(name_group) for name_group in name_groups], "value": ("number", values)}
    return xr.DataArray(derivatives, labels, ("number",), attrs=attributes | {special.name: special.value})


def _parse_names(locus_start, names):
    """Check the parameter names and return each as a tuple of names."""
    scene, own_name = locus_start.scene, locus_start.name
    if names is None:
        return [
            (name,) for name in scene.names if name not in (own_name, "hardness") and _is_allowed(locus_start, name)
        ]
    name_groups = [check.name_tuple("names", entry) for entry in check.name_tuple("names", names)]
    flat_names = flatten_names(name_groups)
    for name in flat_names:
        check.require_parameter(name, scene.names, name)
    if not name_groups or not all(name_groups) or own_name in flat_names or len(set(flat_names)) < len(flat_names):
        raise check.ArgumentError("names", f"must be one or more different parameters other than {own_name}", names)
    check.require_independent(own_name, *flat_names)
    for name_group in name_groups:
        if not _keeps_kind(locus_start, name_group):
            raise check.ArgumentError("names", "must keep the scene symmetric, as an SB requires", name_group)
    return name_groups


def _is_allowed(locus_start, name):
    is_conflicting = locus_start.name == "hardness" and name.endswith((".stiffness", ".damping"))
    return not is_conflicting and _keeps_kind(locus_start, (name,))


def _keeps_kind(locus_start, name_group):
    """Check that a parameter preserves the symmetry that the kind of the point requires."""
    return locus_start.kind != "SB" or stays_symmetric(locus_start.scene, *name_group)


def _contact_derivatives(locus_start):
    """Yield the touched wall (or None) and the derivatives with respect to all numbers of the scene for each contact.

    Contacts that do not determine the value are omitted.
    """
    scene = complete_scene(locus_start.scene)
    mask = parameter_mask(locus_start.scene, locus_start.name)
    scene_vector = np.stack([np.asarray(leaf) for leaf in jax.tree.leaves(scene)]) * (1.0 - mask)
    for problem_and_z in locus_problems(locus_start, (locus_start.name,), whole_orbit=True):
        equations, unknowns = equations_at_point(locus_start.kind, *problem_and_z)
        if locus_start.name == "hardness":
            unknowns[equations.n_orbit_unknowns] = 0.0
        unknown_jacobian, number_jacobian = _jacobians(equations, unknowns, scene_vector, mask)
        try:
            derivatives = -np.linalg.solve(unknown_jacobian, number_jacobian)[equations.n_orbit_unknowns]
        except np.linalg.LinAlgError:
            continue
        yield (SIDES[int(equations.sequence.sides[0] > 0)] if equations.is_grazing else None), derivatives


@persistent_jit(numpy_first=True)
def _jacobians(equations, unknowns, scene_vector, direction):
    """Return the derivatives of the equations of the point in their unknowns and in the numbers of the scene."""
    return jax.jacfwd(PointEquations.residual, (1, 2))(equations, unknowns, scene_vector, direction)


def _select_wall(candidates, wall):
    """Select the derivatives of the given wall, or those on which all candidates agree."""
    matches = [(side, derivatives) for side, derivatives in candidates if wall in (None, side)]
    if not matches:
        raise check.ArgumentError("wall", "must be a touched wall on which the value of the point depends", wall)
    _, derivatives = matches[0]
    if all(
        np.allclose(derivatives, other_derivatives, rtol=EQUAL_TOLERANCE, atol=EQUAL_TOLERANCE)
        for _, other_derivatives in matches
    ):
        return derivatives
    values_by_side = {side: [float(f"{number:.6g}") for number in derivatives] for side, derivatives in sorted(matches)}
    raise check.ArgumentError(
        "wall", 'must be "left" or "right" at a corner; each holds where its wall is touched first', values_by_side
    )
