"""What a special point does: the coefficient of its normal form, and the consequence for a motion that comes to it."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ..orbits.orbit import MARGIN, multipliers
from ..problem import unfolding
from ..problem.depths import Depth, depths
from ..problem.diagnostics import diagnose
from ..problem.orbit_on_branch import place_orbit
from ..scene.scale import scene_length

JUMP, SOFT, HARMLESS = "jump", "soft", "harmless"
UNFOLDED = {"SN": unfolding.folded, "PD": unfolding.doubled, "SB": unfolding.broken}
KINDS = (*UNFOLDED, "GR")
CRITICAL = ("", "supercritical", "subcritical")


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


def normal_form(kind, name, scene, spot, roots, joins):
    """The `NormalForm` of a special point, None of other kinds, of one of an orbit without impacts but a GR, and where
    its equations are too singular to say. scene: at the point; spot: its orbit; roots: the multipliers; joins:
    `OrbitPoint`s of the orbits that meet at a GR."""
    if kind not in KINDS or (kind != "GR" and not len(spot.times)):
        return None
    try:
        with np.errstate(all="ignore"):
            along, z = place_orbit(scene, name, spot)
            if kind == "GR":
                return _grazing(depths(scene, along, z, scene_length(scene)), _goes_on(name, scene, spot, joins))
            return unfolded(kind, UNFOLDED[kind](scene, along, z), abs(roots).min() < 1.0 - MARGIN)
    except np.linalg.LinAlgError:
        return None


def unfolded(kind, found, stable):
    """The `NormalForm` of an `Unfolding`, if there is one; stable: whether the multiplier that is not at 1 or -1 is."""
    if not np.isfinite(found.bend):
        return None
    side = int(np.sign(found.bend))
    critical, consequence = "", JUMP
    if kind != "SN":  # the others are where the multiplier is beyond 1, or -1
        beyond = side * found.rate * (1.0 if kind == "SB" else -1.0) > 0
        critical, consequence = ("supercritical", SOFT) if beyond else ("subcritical", JUMP)
    return NormalForm(found.bend, side, found.rate, found.null, (), critical, consequence if stable else HARMLESS)


def _grazing(found, goes_on):
    """The `NormalForm` of `Depth`s, if there are any."""
    if not found or np.isnan([(one.root, one.slope) for one in found]).any():
        return None
    first = max(found, key=lambda one: one.root)
    consequence = HARMLESS if goes_on else JUMP
    return NormalForm(first.root, int(np.sign(first.slope)), first.slope, np.zeros(0), found, "", consequence)


def _goes_on(name, scene, spot, joins):
    """Whether stable orbits, if any meet at a GR, are on both sides of its value."""
    sides = set()
    for one in joins:
        along, z = place_orbit(scene, name, one)
        look = diagnose(along, z[None])
        if abs(multipliers(float(look.trace[0]), float(look.determinant[0]))).max() < 1.0 - MARGIN:
            sides.add(one.value > spot.value)
    return len(sides) != 1


def plain(form):
    """A `NormalForm` as a list of plain numbers and texts, for a file; of None None."""
    if form is None:
        return None
    each = form.coefficient, form.side, form.rate, form.null.tolist(), list(map(list, form.depths))
    return [*each, form.criticality, form.consequence]


def of_plain(form):
    """The `NormalForm` of a list that `plain` made, or None. Raises ValueError for one that cannot be."""
    if form is None:
        return None
    coefficient, side, rate, null, found, critical, consequence = form
    if side not in (-1, 0, 1) or critical not in CRITICAL or consequence not in (JUMP, SOFT, HARMLESS):
        raise ValueError("its normal_forms cannot be")
    found = tuple(Depth(*each) for each in found)
    return NormalForm(coefficient, side, rate, np.array(null, float), found, critical, consequence)
