"""What a special point does: the coefficient of its normal form, and the consequence for a motion that comes to it."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ..orbits.orbit import STABILITY_MARGIN, eigenvalue_pair
from ..problem import unfolding
from ..problem.diagnostics import diagnose
from ..problem.grazing_depths import Depth, grazing_depths
from ..problem.orbit_point import set_up_problem
from ..scene.typical_scales import scene_length

JUMP, SOFT, HARMLESS = "jump", "soft", "harmless"
UNFOLDING_FUNCTIONS = {
    "SN": unfolding.unfold_saddle_node,
    "PD": unfolding.unfold_period_doubling,
    "SB": unfolding.unfold_symmetry_breaking,
}
NORMAL_FORM_KINDS = (*UNFOLDING_FUNCTIONS, "GR")
CRITICALITIES = ("", "supercritical", "subcritical")


@dataclass(frozen=True, eq=False)
class NormalForm:
    """What happens at a special point, SN, PD, SB or GR, and how fast.

    coefficient: b of SN, PD and SB, where the others are at value + b s^2: the two orbits of the SN, the doubled orbit,
    the two lopsided ones; s: how far the impacts are from the point's orbit, the root mean square over them of the
    changes of time and of speed over the scene's length (`scene.scale.scene_length`), to either side along `null`. At a
    GR, of the touch of a rigid wall where it is the largest: the jump of the velocity over the root of the depth that
    the contact would have. side: of the parameter, 1 or -1, on which the others are, or the contact is. rate: how fast
    the multiplier changes with the parameter at PD and SB, nan at an SN; at a GR how fast the depth grows. null: v,
    (times, speeds), empty at a GR. depths: of each touch at a GR. criticality: "supercritical", "subcritical", or ""
    at SN and GR. consequence: "jump": a stable motion that comes there along the parameter has no other beside it to go
    on as; "soft": it goes on as the doubled or a lopsided one, which leaves it gradually; "harmless": a stable one goes
    on, or none comes there.
    """

    coefficient: float
    side: int
    rate: float
    null: Float[np.ndarray, " unknowns"]
    depths: tuple[Depth, ...]
    criticality: str
    consequence: str

    def __str__(self) -> str:
        if not self.depths:
            return f"{self.coefficient:+.6g} s^2{self.criticality and f', {self.criticality}'}"
        return f"{self.coefficient:.6g} sqrt(depth), {self.rate:+.6g} a unit"


def make_normal_form(kind, name, scene, orbit_row, floquet_multipliers, neighbours):
    """The `NormalForm` of a special point, None of other kinds, of one of an orbit without impacts but a GR, and where
    its equations are too singular to say. scene: at the point; orbit_row: its orbit; floquet_multipliers: the
    multipliers; joins: `OrbitPoint`s of the orbits that meet at a GR."""
    if kind not in NORMAL_FORM_KINDS or (kind != "GR" and not len(orbit_row.times)):
        return None
    try:
        with np.errstate(all="ignore"):
            problem, z = set_up_problem(scene, name, orbit_row)
            if kind == "GR":
                return _grazing_normal_form(
                    grazing_depths(scene, problem, z, scene_length(scene)),
                    _stable_on_both_sides(name, scene, orbit_row, neighbours),
                )
            return normal_form_of_unfolding(
                kind,
                UNFOLDING_FUNCTIONS[kind](scene, problem, z),
                abs(floquet_multipliers).min() < 1.0 - STABILITY_MARGIN,
            )
    except np.linalg.LinAlgError:
        return None


def normal_form_of_unfolding(kind, expansion, stable):
    """The `NormalForm` of an `Unfolding`, if there is one; stable: whether the multiplier that is not at 1 or -1 is."""
    if not np.isfinite(expansion.coefficient):
        return None
    side = int(np.sign(expansion.coefficient))
    criticality, consequence = "", JUMP
    if kind != "SN":  # the others are where the multiplier is beyond 1, or -1
        is_beyond = side * expansion.multiplier_rate * (1.0 if kind == "SB" else -1.0) > 0
        criticality, consequence = ("supercritical", SOFT) if is_beyond else ("subcritical", JUMP)
    return NormalForm(
        expansion.coefficient,
        side,
        expansion.multiplier_rate,
        expansion.null_vector,
        (),
        criticality,
        consequence if stable else HARMLESS,
    )


def _grazing_normal_form(contact_depths, continues):
    """The `NormalForm` of `Depth`s, if there are any."""
    if not contact_depths or np.isnan([(depth.root, depth.slope) for depth in contact_depths]).any():
        return None
    largest_depth = max(contact_depths, key=lambda depth: depth.root)
    consequence = HARMLESS if continues else JUMP
    return NormalForm(
        largest_depth.root,
        int(np.sign(largest_depth.slope)),
        largest_depth.slope,
        np.zeros(0),
        contact_depths,
        "",
        consequence,
    )


def _stable_on_both_sides(name, scene, orbit_row, neighbours):
    """Whether stable orbits, if any meet at a GR, are on both sides of its value."""
    sides = set()
    for neighbour in neighbours:
        problem, z = set_up_problem(scene, name, neighbour)
        diagnostics = diagnose(problem, z[None])
        if (
            abs(eigenvalue_pair(float(diagnostics.trace[0]), float(diagnostics.determinant[0]))).max()
            < 1.0 - STABILITY_MARGIN
        ):
            sides.add(neighbour.value > orbit_row.value)
    return len(sides) != 1


def normal_form_fields(form):
    """A `NormalForm` as a list of plain numbers and texts, for a file; of None None."""
    if form is None:
        return None
    fields = form.coefficient, form.side, form.rate, form.null.tolist(), list(map(list, form.depths))
    return [*fields, form.criticality, form.consequence]


def parse_normal_form(form):
    """The `NormalForm` of a list that `normal_form_fields` made, or None. Raises ValueError for one that cannot be."""
    if form is None:
        return None
    coefficient, side, rate, null, contact_depths, criticality, consequence = form
    if side not in (-1, 0, 1) or criticality not in CRITICALITIES or consequence not in (JUMP, SOFT, HARMLESS):
        raise ValueError("its normal_forms cannot be")
    contact_depths = tuple(Depth(*depth_fields) for depth_fields in contact_depths)
    return NormalForm(coefficient, side, rate, np.array(null, float), contact_depths, criticality, consequence)
