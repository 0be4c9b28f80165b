"""Diagrams for values of another parameter: as `explore` gives them one by one, closed forms, input."""

import mpmath
import numpy as np
import pytest

import jaxvibro as jv
from jaxvibro.branches.explore import make_exploration_request, seed_orbits_of_requests
from tests.reference import closed

OMEGA, R = 2.1, 0.7
BOUNDS = (0.0, 4.0)


@pytest.fixture(scope="module")
def scene():
    return jv.make_scene(2.0, OMEGA, 0.05, R, (-1.0, 1.0))


def test_as_explore_gives_them(scene):
    values = [0.3, 0.05]
    seen = []
    found = jv.diagrams(scene, "amplitude", BOUNDS, "damping", values, max_period=1, progress=seen.append)
    assert len(found) == 2 and max(seen) == max(map(len, found))
    for gamma, one in zip(values, found, strict=True):
        other = jv.explore(scene.replace(damping=gamma), "amplitude", BOUNDS, max_period=1)
        assert float(one.scene.damping) == gamma and one.complete and one.settings == other.settings
        assert one.left == other.left and len(one) == len(other)
        for mine, theirs in zip(one.branches, other.branches, strict=True):
            assert len(mine) == len(theirs) and mine.reasons == theirs.reasons
            assert np.allclose(mine.values, theirs.values, rtol=0, atol=1e-9)
        for mine, theirs in zip(one.special, other.special, strict=True):
            assert mine.kind == theirs.kind and abs(mine.value - theirs.value) < 1e-9
        with mpmath.workdps(30):
            fold = float(closed.fold(gamma, OMEGA, R, 1, symmetric=True).amplitude)
            touch = float(closed.grazing(gamma, OMEGA, 1))
        assert abs(one.points("SN")[0].value - fold) < 1e-11
        assert min(abs(each.value - touch) for each in one.points("GR")) < 1e-11


def test_kept_in_a_store(scene, tmp_path):
    asked, seen = ("amplitude", (0.0, 2.0), "damping", [0.3, 0.1]), []
    plain = jv.diagrams(scene, *asked, max_period=1)
    for _ in range(2):
        kept = jv.diagrams(scene, *asked, max_period=1, progress=seen.append, store=jv.Store(tmp_path / "diagrams"))
        for mine, other in zip(kept, plain, strict=True):
            assert mine.settings == other.settings and mine.left == other.left and len(mine) == len(other)
            assert float(mine.scene.damping) == float(other.scene.damping)
            for one, another in zip(mine.branches, other.branches, strict=True):
                np.testing.assert_allclose(one.values, another.values, rtol=0, atol=1e-9)
    assert seen == [0, 1, 2, 2]
    with pytest.raises(jv.ArgumentError, match="settings differs"):
        jv.diagrams(scene, *asked, max_period=2, store=jv.Store(tmp_path / "diagrams"))


def test_what_the_starts_of_all_values_settle_on(scene):
    scenes = [scene.replace(damping=gamma) for gamma in (0.3, 0.05)]
    tasks = [make_exploration_request(each, "amplitude", BOUNDS, 1, 0, None, 0.1) for each in scenes]
    for mine, theirs in zip(
        seed_orbits_of_requests(tasks), map(seed_orbits_of_requests, ([one] for one in tasks)), strict=True
    ):
        assert [one.orbit_row.value for one in mine] == [one.orbit_row.value for one in theirs[0]] and len(mine) > 100
        assert [one.orbit_row.periods for one in mine] == [one.orbit_row.periods for one in theirs[0]]
        assert (
            max(abs(one.section_states - two.section_states).max() for one, two in zip(mine, theirs[0], strict=True))
            < 1e-6
        )


@pytest.mark.parametrize(
    ("key", "given"),
    [
        ("third", {"third": "amplitude"}),
        ("force", {"third": "force"}),
        ("force", {"name": "force"}),
        ("values", {"values": ()}),
        ("values", {"values": 0.1}),
        ("damping", {"values": [0.1, np.inf]}),
        ("damping", {"values": [0.1, -0.1]}),
        ("bounds", {"bounds": (4.0, 0.0)}),
        ("max_period", {"max_period": 0}),
        ("seed", {"seed": -1}),
        ("budget", {"budget": 0}),
        ("largest_step", {"largest_step": 0.0}),
        ("scene", {"scene": "batch"}),
    ],
)
def test_bad_arguments(key, given, scene):
    given = {"scene": scene, "name": "amplitude", "bounds": BOUNDS, "third": "damping", "values": [0.1]} | given
    if given["scene"] == "batch":
        given["scene"] = scene.replace(amplitude=np.array([1.0, 2.0]))
    with pytest.raises(jv.ArgumentError) as error:
        jv.diagrams(**given)
    assert error.value.key == key
