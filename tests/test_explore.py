"""`explore` and `diagrams` against closed forms, attractors of random starts, and each other."""

import mpmath
import numpy as np
import pytest

import jaxvibro as jv

from . import figure_4
from .figure_4 import GAMMA, OMEGA, R
from .reference import closed

BOUNDS, NARROW = (0.0, 6.0), (0.0, 2.0)


@pytest.fixture(scope="module")
def scene():
    return figure_4.scene()


@pytest.fixture(scope="module")
def diagram(scene):
    return jv.explore(scene, "amplitude", BOUNDS, max_period=2)


def test_figure_4_by_itself(diagram):
    assert diagram.complete and diagram.reason == "all that was found has been followed"
    found = {part.label for branch in diagram.branches for part in branch.segments}
    assert found == {"P100", "P111", "P112", "P121", "P223", "P224", "P232", "P242"}
    assert len(diagram) == 5
    with mpmath.workdps(30):
        fold = float(closed.fold(GAMMA, OMEGA, R, 1, symmetric=True).amplitude)
        touch = float(closed.grazing(GAMMA, OMEGA, 1))
    values = {kind: [one.value for one in diagram.points(kind)] for kind in ("SN", "SB", "PD", "GR")}
    assert abs(values["SN"][0] - fold) < 1e-12 and abs(values["GR"][0] - touch) < 1e-12
    assert np.allclose(values["SB"], [3.543892249375], rtol=0, atol=1e-11)
    assert np.allclose(values["SN"][1:3], 4.525079701581, rtol=0, atol=1e-11)
    assert np.allclose(values["PD"][:2], 4.787450372300, rtol=0, atol=1e-11)
    assert np.allclose(values["PD"][2:4], 4.929889076576, rtol=0, atol=1e-11)


def test_the_same_again_in_two_parts_and_from_a_file(scene, diagram, tmp_path):
    first = jv.explore(scene, "amplitude", BOUNDS, max_period=2, budget=3)
    assert not first.complete and len(first) == 3 and first.reason == "the budget of 3 branches is spent"
    first.save(tmp_path / "part")
    with pytest.raises(FileExistsError):
        first.save(tmp_path / "part")
    seen = []
    whole = jv.explore(scene, "amplitude", BOUNDS, 2, resume=jv.load_diagram(tmp_path / "part"), progress=seen.append)
    assert whole.complete and seen == [5]
    for one, other in zip(whole.branches, diagram.branches, strict=True):
        # but for roundings, as what is asked again may be compiled by then (`continuation.hostcall`)
        np.testing.assert_allclose(one.values, other.values, rtol=1e-11, atol=1e-11)
        values = [[each.value for each in branch.special] for branch in (one, other)]
        np.testing.assert_allclose(*values, rtol=1e-13, atol=1e-13)
    assert whole.table() == diagram.table()


def test_the_motion_that_meets_no_wall_is_there_where_no_start_settles_on_it():
    scene = jv.make_scene(2.3, 2.8, 0.02, 0.8, (None, 0.3))
    diagram = jv.explore(scene, "amplitude", (1.9, 2.2), max_period=1)
    (grazing,) = (one for branch in diagram.branches for one in branch.points("GR"))
    size = np.hypot(1.0 - 2.8**2, 2 * 0.02 * 2.8)
    assert grazing.label == "P100" and abs(grazing.value - 0.3 * size) < 1e-12


def test_around_a_resonance_the_motion_that_meets_no_wall_is_there_on_both_sides():
    scene = jv.make_scene(0.2, 1.0, 0.02, 0.3, (-1.0, 1.0))
    diagram = jv.explore(scene, "frequency", (0.5, 1.6), max_period=1)
    found = [one.value for branch in diagram.branches for one in branch.points("GR")]
    w = np.sqrt(np.roots([1.0, 2.0 * (2 * 0.02**2 - 1.0), 1.0 - 0.2**2]))  # |1 - w^2 + 2 i gamma w| = A
    assert [min(abs(np.array(found) - each)) < 1e-12 for each in w] == [True, True]


def test_a_folder_without_a_diagram(tmp_path):
    (tmp_path / "diagram.json").write_text("{}")
    with pytest.raises(jv.ArgumentError, match="folder"):
        jv.load_diagram(tmp_path)
    with pytest.raises(FileNotFoundError):
        jv.load_diagram(tmp_path / "none")


def test_both_halves_of_symmetric_orbits_leave_a_breaking_that_is_come_to_from_aside():
    """The starts' P112 goes through the SB into its mirror image: of the symmetric P111 that leaves it one half is
    stable, and neither is the other's image."""
    scene = jv.make_scene(4.0, 2.1, 0.05, 0.7, (-1.0, 1.0))
    found = jv.explore(scene, "frequency", (1.68, 2.72), max_period=1)
    assert found.complete
    here = scene.replace(frequency=2.4586)
    orbit = jv.find_orbit(here, jv.State(0.70557727, 2.45965016))
    assert orbit.label == "P111" and orbit.stable
    at = [abs(one.values - 2.4586) + abs(one.data["x"].values[:, 0] - orbit.state.x) for one in found.branches]
    assert min(each.min() for each in at) < 0.05
    branch = found.branches[int(np.argmin([each.min() for each in at]))]
    np.testing.assert_allclose(branch.values.max(), 2.72)
    assert branch.values.min() == pytest.approx(found.points("SB")[0].value, abs=1e-6)
    assert branch.stable[len(branch) // 2]


def assert_same_diagram(one, other):
    assert one.settings == other.settings and one.left == other.left and len(one) == len(other)
    assert float(one.scene.damping) == float(other.scene.damping) and one.complete and other.complete
    for mine, theirs in zip(one.branches, other.branches, strict=True):
        assert len(mine) == len(theirs) and mine.reasons == theirs.reasons
        assert np.allclose(mine.values, theirs.values, rtol=0, atol=1e-9)
    for mine, theirs in zip(one.special, other.special, strict=True):
        assert mine.kind == theirs.kind and abs(mine.value - theirs.value) < 1e-9


def test_diagrams_are_those_that_explore_gives_and_are_kept_in_a_store(scene, tmp_path):
    asked, values, seen = ("amplitude", NARROW, "damping"), [0.3, 0.1], []
    plain = jv.diagrams(scene, *asked, values, max_period=1)
    for gamma, one in zip(values, plain, strict=True):
        assert_same_diagram(one, jv.explore(scene.replace(damping=gamma), "amplitude", NARROW, max_period=1))
        with mpmath.workdps(30):
            fold = float(closed.fold(gamma, OMEGA, R, 1, symmetric=True).amplitude)
        assert abs(one.points("SN")[0].value - fold) < 1e-11
    store = {"store": jv.Store(tmp_path / "diagrams"), "progress": seen.append}
    for _ in range(2):
        for one, other in zip(jv.diagrams(scene, *asked, values, max_period=1, **store), plain, strict=True):
            assert_same_diagram(one, other)
    assert seen == [0, 1, 2, 2]
    with pytest.raises(jv.ArgumentError, match="settings differs"):
        jv.diagrams(scene, *asked, values, max_period=2, **store)


def test_bad_arguments(scene, diagram):
    batch = scene.replace(amplitude=np.array([1.0, 2.0]))
    for key, given in (
        ("max_period", {"max_period": 33}),
        ("resume", {"max_period": 1, "resume": diagram}),
        ("third", {"third": "amplitude", "values": [0.1]}),
        ("damping", {"third": "damping", "values": [0.1, -0.1]}),
        ("scene", {"scene": batch, "third": "damping", "values": [0.1]}),
    ):
        call = jv.diagrams if "third" in given else jv.explore
        with pytest.raises(jv.ArgumentError) as error:
            call(**({"scene": scene, "name": "amplitude", "bounds": BOUNDS, "max_period": 2} | given))
        assert error.value.key == key
