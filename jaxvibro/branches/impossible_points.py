"""Reject special points that are impossible.

With a linear spring and damper between passive walls, the product of the multipliers is between 0 and 1. The factors of
the product are e^(-2 d T) with the damping d and the period T, R^2 with the restitution R for each impact, and the
factors of soft walls. Under any force a product below 1 excludes two multipliers of modulus 1. Therefore there is no
Neimark-Sacker point, and no two of SN, SB and PD coincide. An orbit that is its own mirror image has no PD, because its
multipliers are the squares of those of half the orbit (Swift and Wiesenfeld, Phys. Rev. Lett. 52, 1984).
"""

from itertools import combinations

import numpy as np

from ..problem.orbit_point import is_own_mirror_image
from ..scene.symmetry import is_symmetric

EXCLUSIVE_PAIRS = {("SB", "SN"), ("PD", "SN"), ("PD", "SB"), ("BP", "PD")}
COINCIDENCE_TOLERANCE = 1e-9  # relative to 1 + abs(value) and to the largest speed; closer special points coincide
MULTIPLIER_TOLERANCE = 1e-2  # largest difference of multipliers of one point, also close to a grazing
ROUNDING_FACTOR = 1e-9  # rounding of the product, relative to (1 + larger multiplier)^2


class ImpossiblePointError(ArithmeticError):
    """Error raised if a computed special point cannot exist in the scene."""

    def __init__(self, description, name, value, multiplier_product):
        super().__init__(description, name, value, multiplier_product)
        self.description, self.name, self.value, self.multiplier_product = description, name, value, multiplier_product

    def __str__(self):
        return (
            f"{self.description} at {self.name} = {self.value:.12g} is impossible, because the product of the"
            f" multipliers is {self.multiplier_product:.6g}; the computation is wrong there; please report the scene"
        )


def require_no_area_growth(name, values, multipliers):
    """Check that the products of multipliers, array of shape (points, 2), are at most 1. Raises
    ImpossiblePointError."""
    multiplier_products, rounding_error = _multiplier_products(multipliers)
    for index in np.flatnonzero(np.isfinite(multiplier_products) & (multiplier_products > 1.0 + rounding_error)):
        raise ImpossiblePointError("a growing area", name, float(values[index]), float(multiplier_products[index]))


def require_possible_points(special_points):
    """Check that the special points of a branch are possible. Raises ImpossiblePointError."""
    contracting_points = []
    for special in special_points:
        multiplier_product, rounding_error = _multiplier_products(special.multipliers)
        if multiplier_product < 1.0 - rounding_error:
            contracting_points.append((special, multiplier_product))
    for special, multiplier_product in contracting_points:
        if (
            special.kind == "PD"
            and is_symmetric(special.scene)
            and is_own_mirror_image(special.spot.problem, special.spot.z)
        ):
            raise ImpossiblePointError(
                "PD of an orbit that is its own mirror image", special.name, special.value, multiplier_product
            )
    for (special, multiplier_product), (other_special, _) in combinations(contracting_points, 2):
        if tuple(sorted((special.kind, other_special.kind))) in EXCLUSIVE_PAIRS and _are_coincident(
            special, other_special
        ):
            raise ImpossiblePointError(
                f"coincidence of {special.kind} and {other_special.kind}",
                special.name,
                special.value,
                multiplier_product,
            )


def _multiplier_products(multipliers):
    """Return the moduli of the products of multipliers and their rounding errors; nan at an impact with zero speed."""
    with np.errstate(invalid="ignore"):
        return abs(multipliers.prod(axis=-1)), ROUNDING_FACTOR * (1.0 + abs(multipliers[..., 0])) ** 2


def _are_coincident(first_point, second_point):
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
    orbit_differences = np.concatenate(
        [
            first_row.times - second_row.times,
            first_row.speeds - second_row.speeds,
            [first_row.x - second_row.x, first_row.v - second_row.v],
        ]
    )
    return bool(
        abs(orbit_differences).max() <= COINCIDENCE_TOLERANCE * (1.0 + first_row.speeds.max(initial=abs(first_row.v)))
    )
