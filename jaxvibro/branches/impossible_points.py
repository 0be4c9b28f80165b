"""Reject special points that are impossible.

Under spring and damper, between passive walls, the product of the multipliers is that of e^(-gamma T), of R^2 at each
impact, and of the factors of soft walls: positive and at most 1. Under any force a product below 1 excludes two
multipliers of modulus 1. So there is no Neimark-Sacker point, and no two of SN, SB and PD coincide. An orbit that is
its own mirror image has no PD, because its multipliers are the squares of those of half of it (Swift and Wiesenfeld,
Phys. Rev. Lett. 52, 1984).
"""

from itertools import combinations

import numpy as np

from ..problem.orbit_point import is_own_mirror_image
from ..scene.symmetry import is_symmetric

EXCLUSIVE_PAIRS = {("SB", "SN"), ("PD", "SN"), ("PD", "SB"), ("BP", "PD")}
COINCIDENCE_TOLERANCE = 1e-9  # relative to 1 + abs(value) and to the largest speed; closer special points coincide
MULTIPLIER_TOLERANCE = 1e-2  # largest difference of multipliers of one point, also close to a grazing
ROUNDING_FACTOR = 1e-9  # rounding of the product, relative to (1 + larger multiplier)^2


class ImpossibleError(ArithmeticError):
    """Error for a special point that the scene cannot have, so that its computation is wrong."""

    def __init__(self, description, name, value, product):
        super().__init__(description, name, value, product)
        self.description, self.name, self.value, self.product = description, name, value, product

    def __str__(self):
        return (
            f"{self.description} at {self.name} = {self.value:.12g} is impossible, because the product of the"
            f" multipliers is {self.product:.6g}; the computation is wrong there; please report the scene"
        )


def require_damped(name, values, multipliers):
    """Check that the products of multipliers, array of shape (points, 2), are at most 1. Raises ImpossibleError."""
    products, rounding = _products(multipliers)
    for index in np.flatnonzero(np.isfinite(products) & (products > 1.0 + rounding)):
        raise ImpossibleError("a growing area", name, float(values[index]), float(products[index]))


def require_possible(special_points):
    """Check that the special points of a branch are possible. Raises ImpossibleError."""
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
                f"coincidence of {special.kind} and {other_special.kind}", special.name, special.value, product
            )


def _products(multipliers):
    """Return the moduli of the products of multipliers and their rounding, nan at an impact with zero speed."""
    with np.errstate(invalid="ignore"):
        return abs(multipliers.prod(axis=-1)), ROUNDING_FACTOR * (1.0 + abs(multipliers[..., 0])) ** 2


def _is_same_point(first_point, second_point):
    """Test whether two special points have the same value, impacts and multipliers.

    At a grazing of a soft wall the multipliers change from -1 to 1 while value and impacts change by rounding.
    """
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
