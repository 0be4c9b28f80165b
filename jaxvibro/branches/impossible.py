"""Special points that cannot be.

Under spring and damper, between passive walls, the multipliers' product is that of e^(-gamma T), of each wall's R^2 and
of what soft walls take: positive, and 1 at the most. Under any force: where it is below 1 no two multipliers are of
size 1: there is no Neimark-Sacker point, and no two of SN, SB and PD are one; nor has an orbit that is its own mirror
image a PD, as its multipliers are the squares of those of half of it (Swift and Wiesenfeld, Phys. Rev. Lett. 52, 1984).
"""

from itertools import combinations

import numpy as np

from ..problem.orbit_on_branch import is_own_image
from ..scene.symmetry import is_symmetric

PAIRS = {("SB", "SN"), ("PD", "SN"), ("PD", "SB"), ("BP", "PD")}
NEAR = 1e-9  # of 1 + abs value and of the largest impact's speed: special points as near are one
ALIKE = 1e-2  # between multipliers: those of one point, as near a grazing as can be
ROUNDING = 1e-9  # of 1 + the larger multiplier, squared: so far may the product be off


class ImpossibleError(ArithmeticError):
    """A special point was found that the scene cannot have: what was computed there is wrong."""

    def __init__(self, what, name, value, product):
        super().__init__(what, name, value, product)
        self.what, self.name, self.value, self.product = what, name, value, product

    def __str__(self):
        return (
            f"{self.what} at {self.name} = {self.value:.12g} cannot be, the multipliers' product being"
            f" {self.product:.6g}: what was computed there is wrong; please report the scene"
        )


def require_damped(name, values, multipliers):
    """Refuse points, (points,) and (points, 2), whose multipliers' product is more than 1. Raises ImpossibleError."""
    products, rounding = _products(multipliers)
    for place in np.flatnonzero(np.isfinite(products) & (products > 1.0 + rounding)):
        raise ImpossibleError("a growing area", name, float(values[place]), float(products[place]))


def require_possible(special):
    """Refuse special points of a branch that cannot be. Raises ImpossibleError."""
    damped = []
    for one in special:
        product, rounding = _products(one.multipliers)
        if product < 1.0 - rounding:
            damped.append((one, product))
    for one, product in damped:
        if one.kind == "PD" and is_symmetric(one.scene) and is_own_image(one.scene, one.spot):
            raise ImpossibleError("PD of an orbit that is its own mirror image", one.name, one.value, product)
    for (one, product), (other, _) in combinations(damped, 2):
        if tuple(sorted((one.kind, other.kind))) in PAIRS and _is_one(one, other):
            raise ImpossibleError(f"{one.kind} and {other.kind} in one", one.name, one.value, product)


def _products(multipliers):
    """(the size of the product of the multipliers, (..., 2); how far rounding may put it off), nan where they are not
    finite, at an impact without speed."""
    with np.errstate(invalid="ignore"):
        return abs(multipliers.prod(axis=-1)), ROUNDING * (1.0 + abs(multipliers[..., 0])) ** 2


def _is_one(one, other):
    """Whether two special points have the same value, impacts and multipliers. At a grazing of a soft wall the last go
    from -1 to 1 while the others change by a rounding."""
    a, b = one.spot, other.spot
    if len(a.times) != len(b.times) or abs(a.value - b.value) > NEAR * (1.0 + abs(a.value)):
        return False
    if not abs(one.multipliers - other.multipliers).max() <= ALIKE:
        return False
    apart = np.concatenate([a.times - b.times, a.speeds - b.speeds, [a.x - b.x, a.v - b.v]])
    return bool(abs(apart).max() <= NEAR * (1.0 + a.speeds.max(initial=abs(a.v))))
