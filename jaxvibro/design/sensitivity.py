"""How the value of a special point changes with the other numbers of its scene: `sensitivity`.

At a point L(y, q) = 0 (`point_equations`): y its unknowns, the value among them, q all numbers of the scene. Its
derivative is that row of -(L_y)^-1 L_q, which is what `located` has for one.
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

EQUAL_TOLERANCE = 1e-6  # derivatives as near are one


@check.host_only("use jax.grad of located")
def sensitivity(
    special: Special, names: str | Sequence[str | tuple[str, ...]] | None = None, wall: str | None = None
) -> xr.DataArray:
    """How the value of a special point changes with other numbers of its scene: a table, a row for each name.

    special: a `Special` of a branch, SN, PD, SB or GR; names: of parameters but the point's own, one or a sequence, by
    default all that the scene has numbers for; a tuple among them is one parameter, of several that have one value and
    change together: [("left.damping", "right.damping")]. Where their values differ, a common shift does what the single
    ones do, added. wall: "left" or "right", for a GR that touches both at once: along what moves one of them it has a
    corner, and what is given is how the value at which this wall is touched changes. It counts on the side where this
    wall is touched first.

    The table is an `xarray.DataArray` along "number": d value / d number, with each number's own value beside it.

    Raises ArgumentError for points of other kinds, names that cannot be, as such that take a scene's symmetry from an
    SB, and a corner where no wall is given; its value is then what each wall gives.
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
    """The parameters asked for, each a tuple of names, checked."""
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
        raise check.ArgumentError("names", f"must be different, one at least, and none {own_name}", names)
    check.require_independent(own_name, *flat_names)
    for name_group in name_groups:
        if not _keeps_kind(locus_start, name_group):
            raise check.ArgumentError(
                "names", "must keep the scene symmetric: an SB is no point of another", name_group
            )
    return name_groups


def _is_allowed(locus_start, name):
    is_conflicting = locus_start.name == "hardness" and name.endswith((".stiffness", ".damping"))
    return not is_conflicting and _keeps_kind(locus_start, (name,))


def _keeps_kind(locus_start, name_group):
    """Whether the point's kind is one of the scenes that differ in such a parameter."""
    return locus_start.kind != "SB" or stays_symmetric(locus_start.scene, *name_group)


def _contact_derivatives(locus_start):
    """(side of the wall that is touched, None: none is, d value / d number for all numbers of the scene) of each touch;
    what the value does not matter to is left out."""
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
    """The derivatives of the point's equations by their unknowns and by the scene's numbers."""
    return jax.jacfwd(PointEquations.residual, (1, 2))(equations, unknowns, scene_vector, direction)


def _select_wall(candidates, wall):
    """The one of some, (side, derivatives) each, that is meant: that of a wall, or what all give."""
    matches = [(side, derivatives) for side, derivatives in candidates if wall in (None, side)]
    if not matches:
        raise check.ArgumentError("wall", "must be one that is touched, and that the point's value changes", wall)
    _, derivatives = matches[0]
    if all(
        np.allclose(derivatives, other_derivatives, rtol=EQUAL_TOLERANCE, atol=EQUAL_TOLERANCE)
        for _, other_derivatives in matches
    ):
        return derivatives
    values_by_side = {side: [float(f"{number:.6g}") for number in derivatives] for side, derivatives in sorted(matches)}
    raise check.ArgumentError(
        "wall", 'must be "left" or "right" at a corner: each counts where it is touched first', values_by_side
    )
