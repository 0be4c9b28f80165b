"""Special points that a damped scene cannot have are refused where they are found."""

from dataclasses import replace

import numpy as np
import pytest

import jaxvibro as jv
from jaxvibro.branches import assemble
from jaxvibro.branches.assemble import ImpossiblePointError, require_no_area_growth, require_possible_points

WALLS = (jv.Wall(-1.0), jv.Wall(1.0))


@pytest.fixture(scope="module")
def symmetric():
    """P111 of figure 4, between its saddle-node and beyond its symmetry breaking."""
    scene = jv.make_scene(3.0, 2.1, 0.05, 0.7, WALLS)
    orbit = jv.find_orbit(scene, jv.State(0.9, -1.1))
    return jv.follow(orbit, "amplitude", (0.3, 4.0), direction="both")


def refused(special):
    with pytest.raises(ImpossiblePointError) as error:
        require_possible_points(special)
    return error.value


def test_what_can_be_is_not_refused(symmetric):
    assert "SB" in [one.kind for one in symmetric.special]
    require_possible_points(symmetric.special)
    require_no_area_growth("amplitude", symmetric.values, symmetric.multipliers)


def test_no_period_doubling_of_a_symmetric_orbit(symmetric):
    (broken,) = symmetric.points("SB")
    found = refused((replace(broken, kind="PD"),))
    assert found.value == broken.value and abs(found.multiplier_product - abs(broken.multipliers.prod())) < 1e-15
    assert "its own mirror image" in str(found) and f"amplitude = {broken.value:.12g}" in str(found)
    assert 0 < found.multiplier_product < 0.7**4


@pytest.mark.parametrize("kinds", [("SN", "SB"), ("SN", "PD"), ("SB", "PD"), ("BP", "PD")])
def test_no_two_multipliers_of_size_one(symmetric, kinds, monkeypatch):
    (broken,) = symmetric.points("SB")
    z = broken.spot.z.copy()
    z[broken.spot.problem.n_rows : -1] *= 1.0 + 1e-6  # the speeds
    aside = replace(broken, spot=broken.spot._replace(z=z))
    monkeypatch.setattr(assemble, "is_own_mirror_image", lambda *_: False)
    both = [replace(broken, kind=kind) for kind in kinds]
    with pytest.raises(ImpossiblePointError, match=f"of ({kinds[0]} and {kinds[1]}|{kinds[1]} and {kinds[0]}) at"):
        require_possible_points(both)
    require_possible_points([both[0], replace(aside, kind=kinds[1])])
    turned = replace(both[1], multipliers=-broken.multipliers)  # as at a grazing of a soft wall, within a rounding
    require_possible_points([both[0], turned])
    kept = replace(broken, multipliers=np.array([1.0, -1.0 + 0j]))  # no damping: the area is kept
    require_possible_points([replace(kept, kind=kind) for kind in kinds])


def test_no_growing_area(symmetric):
    values, found = symmetric.values, symmetric.multipliers.copy()
    found[3] = 1.001 * np.exp([2j, -2j])
    with pytest.raises(ImpossiblePointError, match=f"amplitude = {values[3]:.12g}"):
        require_no_area_growth("amplitude", values, found)
    found[3] = np.exp([2j, -2j])
    require_no_area_growth("amplitude", values, found)
    found[3] = 1e6, 1e-6 * (1 + 1e-5)  # a rounding of the larger one
    require_no_area_growth("amplitude", values, found)


def test_follow_refuses_what_it_finds(monkeypatch):
    """As if the doubling of a lopsided orbit were that of a symmetric one."""
    scene = jv.make_scene(4.75, 2.1, 0.05, 0.7, WALLS)
    orbit = jv.find_orbit(scene, jv.State(0.9, -1.1))
    assert jv.follow(orbit, "amplitude", (4.7, 4.8)).points("PD")
    monkeypatch.setattr(assemble, "is_own_mirror_image", lambda *_: True)
    with pytest.raises(ImpossiblePointError, match=r"amplitude = 4\.7874"):
        jv.follow(orbit, "amplitude", (4.7, 4.8))
