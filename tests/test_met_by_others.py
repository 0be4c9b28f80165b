"""What users of other packages met: ours right in each case to rounding; diffrax's as the page tells it."""

import math

import pytest

from reliability import met_by_others

CASES = met_by_others.cases()


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_ours_is_right(case):
    told = case.ours()
    assert told.error < 1e-12 and told.right


def test_an_answer_is_judged_by_its_numbers_and_its_contacts():
    assert met_by_others.Told("", "", 1e-7).right
    assert not met_by_others.Told("", "", 1e-5).right and not met_by_others.Told("", "", math.inf).right


def test_diffrax_as_it_is_locked():
    met = met_by_others.measure()
    right = {each.case.source: [] for each in met}
    for each in met:
        right[each.case.source] += [told.right for told in each.others]
    assert right == {
        "diffrax #507": [False, False],  # the wall that swings, the shallow arc
        "diffrax #639": [True, False],  # the wall written first, and last
        "diffrax #492": [True, False],  # rising events, and both directions
        "diffrax #713": [True],
        "OrdinaryDiffEq.jl #3222": [],
        "ChaosTools.jl #324": [],
    }
    (gone,) = (each for each in met if "the fault is gone" in each.words)
    assert gone.case.source == "diffrax #713"
    text = met_by_others.table(met)
    assert text.count("**no**") == 4 and text.count("| jaxvibro |") == len(CASES)
