"""Which orbits along a branch are wanted, which touch ends it, what is looked at again, and which ways lead on."""

from types import SimpleNamespace

import numpy as np
import pytest

from continuation.augmented_systems import RootAndResidual
from jaxvibro.loci import loci_of_branches
from jaxvibro.problem import curve_ends, grazing_contact
from jaxvibro.problem.grazing_contact import are_admissible
from jaxvibro.problem.orbit_problem import PERIODIC

NO_RESTS = dict.fromkeys(("sticking_time", "min_contact_force", "hop_margin"), np.zeros((1, 0)))


@pytest.mark.parametrize(
    ("speeds", "clear", "good"),
    [
        ((0.3, 0.2), (0.1, 0.2), True),
        ((0.3, 0.2), (0.0, 0.2), True),
        ((0.3, 0.2), (0.1, -1e-9), False),
        ((0.3, 0.0), (0.1, 0.2), False),
        ((-0.3, 0.2), (0.1, 0.2), False),
        ((0.3, np.nan), (0.1, 0.2), False),
    ],
)
def test_orbits_keep_to_their_walls_and_hit_them_with_a_speed(speeds, clear, good):
    along = SimpleNamespace(
        sequence=SimpleNamespace(sides=np.array([1.0, -1.0])),
        impact_rows=np.array([0, 1]),
        slack=0.0,
        condition=PERIODIC,
    )
    zs, look = np.array([[0.1, 0.2, *speeds, 2.0]]), SimpleNamespace(clearance=np.reshape(clear, (1, 2, 1)), **NO_RESTS)
    assert are_admissible(along, zs, look).tolist() == [good]


@pytest.mark.parametrize(("clear", "found"), [(0.0, True), (-1e-12, True), (-1e-3, False)])
def test_a_touch_that_another_is_before_is_not_the_first(clear, found, monkeypatch):
    z = np.array([0.1, 0.2, 1.3])
    rows = {"sequence": SimpleNamespace(sides=np.zeros(0)), "impact_rows": np.zeros(0, int)}
    along = SimpleNamespace(**rows, condition=PERIODIC, length_scale=1.0)
    task = SimpleNamespace(args=along, control=SimpleNamespace(scale=np.ones(3)))
    monkeypatch.setattr(curve_ends, "locate_grazing", lambda *_: RootAndResidual(z, 1e-15))
    monkeypatch.setattr(curve_ends, "diagnose", lambda *_: SimpleNamespace(clearance=np.array([[[clear]]])))
    good = SimpleNamespace(z=np.array([0.1, 0.2, 1.0]), tangent=np.array([0.0, 0.0, 1.0]))
    there, seen = (
        SimpleNamespace(z=np.array([0.1, 0.2, 1.5])),
        SimpleNamespace(
            clearance=-np.ones((1, 1)),
            turning_time=np.ones((1, 1)),
            sticking_time=np.zeros(0),
            min_contact_force=np.zeros(0),
        ),
    )
    told = curve_ends._locate_first_grazing(task, good, there, seen, 0.0, 0.5)
    assert (told is not None) == found
    assert curve_ends._locate_first_grazing(task, good, there, seen, 0.0, 0.2) is None  # it is beyond


@pytest.mark.parametrize(
    ("values", "places"),
    [((1.0, 0.1, 0.2), [0, 1]), ((1.0, 0.1, 1.0), []), ((1.0, 0.5, 0.1), []), ((1.0, 0.1, 0.4), [])],
)
def test_a_value_whose_parabola_falls_to_half_of_it_is_looked_at_more_closely(values, places, monkeypatch):
    """A parabola through three values falls below the middle one by the outer ones' difference squared over 8 bends."""
    seen = []
    monkeypatch.setattr(curve_ends, "_find_inadmissible_point", lambda task, points, after, columns: seen.append(after))
    along = SimpleNamespace(sequence=SimpleNamespace(sides=np.zeros(0)), impact_rows=np.zeros(0, int), slack=0.0)
    points, look = SimpleNamespace(z=np.zeros((3, 3))), SimpleNamespace(clearance=np.reshape(values, (3, 1, 1)))
    assert curve_ends.insert_missed_grazings(SimpleNamespace(args=along), points, look) == (points, look)
    assert seen == places


@pytest.mark.parametrize(("rates", "leaves"), [((1.0, 0.3), True), ((1.0, -1e-9), True), ((1.0, -1e-3), False)])
def test_a_branch_leaves_a_grazing_where_speeds_and_distances_grow(rates, leaves, monkeypatch):
    monkeypatch.setattr(grazing_contact, "step_along_exit", lambda *_: ("way", True))
    found = grazing_contact.check_exit_along_tangent(None, np.zeros(3), np.ones(3), np.array(rates), (True, False))
    assert found == (("way", True) if leaves else (None, True))


class Branch:
    """Of five points."""

    stable = np.array([True, False, False, True, True])
    segments = (SimpleNamespace(first=0, last=2, label="P100"), SimpleNamespace(first=3, last=4, label="P111"))

    def __len__(self):
        return 5


def test_two_motions_exist_together_where_both_are_stable():
    told = [
        loci_of_branches._stable_motion_labels(Branch(), *pair)
        for pair in ((0, 3), (3, 4), (0, 1), (2, 4), (-1, 3), (0, 5))
    ]
    assert told == ["P100 and P111", "P111", None, None, None, None]
