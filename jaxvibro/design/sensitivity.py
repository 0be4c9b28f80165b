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
from ..loci.first_point import equations, start_of
from ..scene import check
from ..scene.parameters import flat, tied
from ..scene.scene import SIDES
from ..scene.symmetry import stays_symmetric
from .point_equations import PointEquations, at_point, mark, whole

ALIKE = 1e-6  # derivatives as near are one


@check.host("use jax.grad of located")
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
    start = start_of(special)
    groups = _groups(start, names)
    if wall not in (None, *SIDES):
        raise check.ArgumentError("wall", 'must be "left", "right" or None', wall)
    values = [tied(start.scene, group) for group in groups]
    marks = np.stack([np.max([mark(start.scene, name) for name in group], axis=0) for group in groups])
    found = _only([(side, marks @ by) for side, by in _touched(start)], wall)
    about = {"long_name": f"d {special.name} / d number", "point": f"{special.kind} of {special.label}"}
    labels = {"number": [" = ".join(group) for group in groups], "value": ("number", values)}
    return xr.DataArray(found, labels, ("number",), attrs=about | {special.name: special.value})


def _groups(start, names):
    """The parameters asked for, each a tuple of names, checked."""
    scene, own = start.scene, start.name
    if names is None:
        return [(name,) for name in scene.names if name not in (own, "hardness") and _may(start, name)]
    groups = [check.sequence("names", one) for one in check.sequence("names", names)]
    each = flat(groups)
    for name in each:
        check.require_known(name, scene.names, name)
    if not groups or not all(groups) or own in each or len(set(each)) < len(each):
        raise check.ArgumentError("names", f"must be different, one at least, and none {own}", names)
    check.require_apart(own, *each)
    for group in groups:
        if not _is_kept(start, group):
            raise check.ArgumentError("names", "must keep the scene symmetric: an SB is no point of another", group)
    return groups


def _may(start, name):
    apart = start.name == "hardness" and name.endswith((".stiffness", ".damping"))
    return not apart and _is_kept(start, (name,))


def _is_kept(start, group):
    """Whether the point's kind is one of the scenes that differ in such a parameter."""
    return start.kind != "SB" or stays_symmetric(start.scene, *group)


def _touched(start):
    """(side of the wall that is touched, None: none is, d value / d number for all numbers of the scene) of each touch;
    what the value does not matter to is left out."""
    scene = whole(start.scene)
    here = mark(start.scene, start.name)
    numbers = np.stack([np.asarray(leaf) for leaf in jax.tree.leaves(scene)]) * (1.0 - here)
    for sheet in equations(start, (start.name,), whole=True):
        point, unknowns = at_point(start.kind, *sheet)
        if start.name == "hardness":
            unknowns[point.size] = 0.0
        by_unknowns, by_numbers = _slopes(point, unknowns, numbers, here)
        try:
            slopes = -np.linalg.solve(by_unknowns, by_numbers)[point.size]
        except np.linalg.LinAlgError:
            continue
        yield (SIDES[int(point.cycle.sides[0] > 0)] if point.grazes else None), slopes


@persistent_jit(numpy_first=True)
def _slopes(point, unknowns, numbers, direction):
    """The derivatives of the point's equations by their unknowns and by the scene's numbers."""
    return jax.jacfwd(PointEquations.left, (1, 2))(point, unknowns, numbers, direction)


def _only(found, wall):
    """The one of some, (side, derivatives) each, that is meant: that of a wall, or what all give."""
    chosen = [(side, by) for side, by in found if wall in (None, side)]
    if not chosen:
        raise check.ArgumentError("wall", "must be one that is touched, and that the point's value changes", wall)
    _, by = chosen[0]
    if all(np.allclose(by, other, rtol=ALIKE, atol=ALIKE) for _, other in chosen):
        return by
    told = {side: [float(f"{each:.6g}") for each in by] for side, by in sorted(chosen)}
    raise check.ArgumentError(
        "wall", 'must be "left" or "right" at a corner: each counts where it is touched first', told
    )
