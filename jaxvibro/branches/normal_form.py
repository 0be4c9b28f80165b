"""Compute normal forms of special points and their consequences for stable motions."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ..orbits.orbit import STABILITY_MARGIN, eigenvalue_pair
from ..problem import normal_forms
from ..problem.grazing_return_map import GrazingJump, grazing_jumps
from ..problem.orbit_equations import diagnose

JUMP, SOFT, HARMLESS = "jump", "soft", "harmless"
UNFOLDING_FUNCTIONS = {
    "SN": normal_forms.unfold_saddle_node,
    "PD": normal_forms.unfold_period_doubling,
    "SB": normal_forms.unfold_symmetry_breaking,
}
NORMAL_FORM_KINDS = (*UNFOLDING_FUNCTIONS, "GR")
CRITICALITIES = ("", "supercritical", "subcritical")


@dataclass(frozen=True, eq=False)
class NormalForm:
    """Normal form of a special point SN, PD, SB or GR.

    Attributes
    ----------
    coefficient : float
        At SN, PD and SB the coefficient b: the other orbits exist at value + b s^2. The other orbits are the two orbits
        of the SN, the doubled orbit, or the two asymmetric orbits. s is the distance of their impacts from those of the
        point's orbit along `null`: the root mean square of the changes of time and of the changes of speed divided by
        the length of the scene (`scene_properties.typical_length`). At a GR the largest, over the grazing contacts,
        of the jump of the velocity divided by the square root of the depth that the contact would have.
    side : int
        Side of the parameter on which the other orbits, or the contact, exist: 1 or -1.
    rate : float
        Derivative of the multiplier that is 1 or -1 with respect to the parameter at PD and SB, nan at an SN. At a GR
        the derivative of the depth.
    null : ndarray
        Null vector of times and speeds, array of shape (2 * impacts,), empty at a GR.
    depths : tuple of GrazingJump
        One entry for each grazing contact at a GR, else empty.
    criticality : str
        ``"supercritical"`` or ``"subcritical"``; empty at SN and GR.
    consequence : str
        Effect on a stable motion as the parameter passes the point. ``"jump"``: no stable motion exists nearby beyond
        the point. ``"soft"``: the motion continues as the doubled or an asymmetric orbit, which departs gradually.
        ``"harmless"``: a stable motion continues, or no motion near the point is stable.
    """

    coefficient: float
    side: int
    rate: float
    null: Float[np.ndarray, " unknowns"]
    depths: tuple[GrazingJump, ...]
    criticality: str
    consequence: str

    def __str__(self) -> str:
        if not self.depths:
            return f"{self.coefficient:+.6g} s^2{self.criticality and f', {self.criticality}'}"
        return f"{self.coefficient:.6g} sqrt(depth), {self.rate:+.6g} a unit"


def make_normal_form(kind, scene, orbit_point, floquet_multipliers, neighbours):
    """Compute the normal form of a special point.

    Returns None for kinds other than SN, PD, SB and GR, for orbits without impacts except at a GR, if the linear
    equations are singular, and if the coefficient is not finite. `scene` is the scene at the point; `neighbours` are
    the orbits that meet at a GR.
    """
    if kind not in NORMAL_FORM_KINDS or (kind != "GR" and not orbit_point.problem.n_rows):
        return None
    try:
        with np.errstate(all="ignore"):
            problem, z = orbit_point.problem, orbit_point.z
            if kind == "GR":
                return _grazing_normal_form(
                    grazing_jumps(scene, problem, z), _is_stable_on_both_sides(orbit_point, neighbours)
                )
            return normal_form_of_unfolding(
                kind,
                UNFOLDING_FUNCTIONS[kind](scene, problem, z),
                abs(floquet_multipliers).min() < 1.0 - STABILITY_MARGIN,
            )
    except np.linalg.LinAlgError:
        return None


def normal_form_of_unfolding(kind, expansion, is_otherwise_stable):
    """Make the `NormalForm` of an `Unfolding`.

    Parameters
    ----------
    kind : str
        SN, PD or SB.
    expansion : Unfolding
        Expansion at the point.
    is_otherwise_stable : bool
        True if the other multiplier, which is not 1 or -1, is inside the unit circle.

    Returns
    -------
    NormalForm or None
        Normal form; None if the coefficient is not finite.
    """
    if not np.isfinite(expansion.coefficient):
        return None
    side = int(np.sign(expansion.coefficient))
    criticality, consequence = "", JUMP
    if kind != "SN":  # supercritical: the other orbits exist where the multiplier is beyond 1 or -1
        is_supercritical = side * expansion.multiplier_rate * (1.0 if kind == "SB" else -1.0) > 0
        criticality, consequence = ("supercritical", SOFT) if is_supercritical else ("subcritical", JUMP)
    return NormalForm(
        expansion.coefficient,
        side,
        expansion.multiplier_rate,
        expansion.null_vector,
        (),
        criticality,
        consequence if is_otherwise_stable else HARMLESS,
    )


def _grazing_normal_form(contact_depths, is_stable_beyond):
    """Make the `NormalForm` from the `GrazingJump` records of a grazing; None without records or with nan."""
    if not contact_depths or np.isnan([(depth.root, depth.slope) for depth in contact_depths]).any():
        return None
    largest_depth = max(contact_depths, key=lambda depth: depth.root)
    consequence = HARMLESS if is_stable_beyond else JUMP
    return NormalForm(
        largest_depth.root,
        int(np.sign(largest_depth.slope)),
        largest_depth.slope,
        np.zeros(0),
        contact_depths,
        "",
        consequence,
    )


def _is_stable_on_both_sides(orbit_point, neighbours):
    """Return True if stable orbits meet at a GR from both sides of its value, or from neither side."""
    stable_sides = set()
    for neighbour in neighbours:
        diagnostics = diagnose(neighbour.problem, neighbour.z[None])
        if (
            abs(eigenvalue_pair(float(diagnostics.trace[0]), float(diagnostics.determinant[0]))).max()
            < 1.0 - STABILITY_MARGIN
        ):
            stable_sides.add(neighbour.value > orbit_point.value)
    return len(stable_sides) != 1


def normal_form_fields(normal_form):
    """Convert a `NormalForm`, or None, to plain numbers and texts for a file."""
    if normal_form is None:
        return None
    fields = (
        normal_form.coefficient,
        normal_form.side,
        normal_form.rate,
        normal_form.null.tolist(),
        list(map(list, normal_form.depths)),
    )
    return [*fields, normal_form.criticality, normal_form.consequence]


def parse_normal_form(form_fields):
    """Convert the fields of a file to a `NormalForm`, or None. Raises ValueError if they are invalid."""
    if form_fields is None:
        return None
    coefficient, side, rate, null, contact_depths, criticality, consequence = form_fields
    if side not in (-1, 0, 1) or criticality not in CRITICALITIES or consequence not in (JUMP, SOFT, HARMLESS):
        raise ValueError("its normal_forms are invalid")
    contact_depths = tuple(GrazingJump(*depth_fields) for depth_fields in contact_depths)
    return NormalForm(coefficient, side, rate, np.array(null, float), contact_depths, criticality, consequence)
