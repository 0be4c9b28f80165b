"""Special points that cannot be.

Under spring and damper, between passive walls, the multipliers' product is that of e^(-gamma T), of each wall's R^2 and
of what soft walls take: positive, and 1 at the most. Under any force: where it is below 1 no two multipliers are of
size 1: there is no Neimark-Sacker point, and no two of SN, SB and PD are one; nor has an orbit that is its own mirror
image a PD, as its multipliers are the squares of those of half of it (Swift and Wiesenfeld, Phys. Rev. Lett. 52, 1984).
"""

from itertools import combinations

import numpy as np

from ..problem.orbit_point import is_own_mirror_image
from ..scene.symmetry import is_symmetric

EXCLUSIVE_PAIRS = {("SB", "SN"), ("PD", "SN"), ("PD", "SB"), ("BP", "PD")}
COINCIDENCE_TOLERANCE = 1e-9  # of 1 + abs value and of the largest impact's speed: special points as near are one
MULTIPLIER_TOLERANCE = 1e-2  # between multipliers: those of one point, as near a grazing as can be
ROUNDING_FACTOR = 1e-9  # of 1 + the larger multiplier, squared: so far may the product be off


class ImpossibleError(ArithmeticError):
    """A special point was found that the scene cannot have: what was computed there is wrong."""

    def __init__(self, description, name, value, product):
        super().__init__(description, name, value, product)
        self.description, self.name, self.value, self.product = description, name, value, product

    def __str__(self):
        return (
            f"{self.description} at {self.name} = {self.value:.12g} cannot be, the multipliers' product being"
            f" {self.product:.6g}: what was computed there is wrong; please report the scene"
        )


def require_damped(name, values, multipliers):
    """Refuse points, (points,) and (points, 2), whose multipliers' product is more than 1. Raises ImpossibleError."""
    products, rounding = _products(multipliers)
    for index in np.flatnonzero(np.isfinite(products) & (products > 1.0 + rounding)):
        raise ImpossibleError("a growing area", name, float(values[index]), float(products[index]))


def require_possible(special_points):
    """Refuse special points of a branch that cannot be. Raises ImpossibleError."""
    damped_points = []
    for special in special_points:
        product, rounding = _products(special.multipliers)
        if product < 1.0 - rounding:
            damped_points.append((special, product))
    for special, product in damped_points:
        if special.kind == "PD" and is_symmetric(special.scene) and is_own_mirror_image(special.scene, special.spot):
            raise ImpossibleError("PD of an orbit that is its own mirror image", special.name, special.value, product)
    for (special, product), (other_special, _) in combinations(damped_points, 2):
        if tuple(sorted((special.kind, other_special.kind))) in EXCLUSIVE_PAIRS and _is_same_point(
            special, other_special
        ):
            raise ImpossibleError(
                f"{special.kind} and {other_special.kind} in one", special.name, special.value, product
            )


def _products(multipliers):
    """(the size of the product of the multipliers, (..., 2); how far rounding may put it off), nan where they are not
    finite, at an impact without speed."""
    with np.errstate(invalid="ignore"):
        return abs(multipliers.prod(axis=-1)), ROUNDING_FACTOR * (1.0 + abs(multipliers[..., 0])) ** 2


def _is_same_point(first_point, second_point):
    """Whether two special points have the same value, impacts and multipliers. At a grazing of a soft wall the last go
    from -1 to 1 while the others change by a rounding."""
    first_row, second_row = first_point.spot, second_point.spot
    if len(first_row.times) != len(second_row.times) or abs(
        first_row.value - second_row.value
    ) > COINCIDENCE_TOLERANCE * (1.0 + abs(first_row.value)):
        return False
    if not abs(first_point.multipliers - second_point.multipliers).max() <= MULTIPLIER_TOLERANCE:
        return False
    differences = np.concatenate(
        [
            first_row.times - second_row.times,
            first_row.speeds - second_row.speeds,
            [first_row.x - second_row.x, first_row.v - second_row.v],
        ]
    )
    return bool(
        abs(differences).max() <= COINCIDENCE_TOLERANCE * (1.0 + first_row.speeds.max(initial=abs(first_row.v)))
    )
