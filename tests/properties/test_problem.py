"""Properties of normal forms, grazing maps and isolas, against references in many digits and long simulations."""

from dataclasses import dataclass

import numpy as np
from mpmath import mpf, workdps

import jaxvibro as jv
from jaxvibro.branches.scenario import grazing_return_of
from tests.isolas import draw_isola, has_folds, with_moving_wall
from tests.reference import rests
from tests.reference.special import exact
from tests.special_points import reference_bend, reference_error, return_matrix
from tests.tiers import of_numbers
from tests.truths import plain

from .branches import branch_of, significant, switched_branches


@dataclass(frozen=True)
class Kind:
    """A kind of draw of this module; scenes: the name of the kind of random scenes."""

    name: str
    scenes: str = ""


@of_numbers
def test_unfolding(kind, number):
    """The coefficient of an SN, PD or SB is the curvature of the branches there, in many digits."""
    switched = switched_branches(kind, number)
    points = [point for branch in (branch_of(kind, number), *_branches(switched)) for point in significant(branch)]
    for point in [one for one in points if one.kind in ("SN", "PD", "SB") and not one.orbit.rests][:4]:
        form, expected = point.normal_form, reference_bend(point)
        assert abs(form.coefficient - expected) < 1e-7 * abs(expected) and form.side == np.sign(expected)
        half = len(form.null) // 2
        assert np.sum(form.null[:half] ** 2) <= half * (1.0 + 1e-9)


def _branches(switched):
    return [branch for _, branches in switched for branch in branches[:1]]
