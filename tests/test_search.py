"""Bifurcations looked for without an orbit: against closed forms; aims against differences of orbits found again."""

import jax
import numpy as np
import pytest

import jaxvibro as jv
from jaxvibro.branches.follow import polish_orbit
from jaxvibro.design.bifurcation_gradients import FLIP, FOLD, ZERO_SPEED, evaluate_test_gradients
from jaxvibro.design.parameter_rays import impact_sequence_of
from jaxvibro.design.special_point_equations import complete_scene, parameter_mask
from jaxvibro.problem.orbit_diagnostics import diagnose

FREE = {"amplitude": 0.5, "frequency": 0.2}


def grazing(scene):
    """The amplitude at which P100 touches the wall at a."""
    w, gamma = float(scene.frequency), float(scene.damping)
    return float(scene.right.position) * np.hypot(1.0 - w * w, 2.0 * gamma * w)


@pytest.fixture(scope="module")
def one_wall():
    return jv.make_scene(1.5, 1.7, 0.12, 0.6, (None, 0.8))


def test_a_boundary_that_is_known_is_met(one_wall):
    bounds = {"amplitude": (0.9, 1.9), "frequency": (1.5, 1.9)}
    found = jv.search(one_wall, "GR", FREE, bounds, starts=60, max_period=1)
    (free,) = (one for one in found.points if one.label == "P100")
    assert free.kind == "GR"
    assert float(free.scene.amplitude) == pytest.approx(grazing(free.scene), abs=1e-12)
    for one, distance in zip(found.points, found.distances, strict=True):
        apart = [(float(one.scene.parameter(name)) - float(one_wall.parameter(name))) / u for name, u in FREE.items()]
        assert distance == pytest.approx(np.linalg.norm(apart), rel=1e-12)
        for name, (low, high) in bounds.items():
            assert low <= float(one.scene.parameter(name)) <= high
    assert list(found.distances) == sorted(found.distances)
    assert found.starts == 60 and 0 < found.settled <= 60 and found.followed >= sum(found.met)
    assert "60 random scenes" in found.table() and "GR" in found.table()
    value = jv.located(free, "amplitude")  # a point is taken on as any other
    assert float(value(one_wall)) == pytest.approx(grazing(one_wall), abs=1e-12)


def test_what_finds_nothing_says_how_far_it_looked(one_wall):
    near = {"amplitude": (1.49, 1.51), "frequency": (1.69, 1.71)}
    found = jv.search(one_wall, ["PD", "SB"], FREE, near, starts=8, max_period=1)
    assert found.points == () and found.table().startswith("nothing found\n8 random scenes, ")


def test_aims_are_differences_of_orbits_found_again():
    scene = jv.make_scene(2.3, 2.15, 0.07, 0.75, (-1.1, jv.Wall(0.9, 0.6)))
    orbit, names, step = jv.find_orbit(scene, jv.State(0.8, -1.2)), ("amplitude", "right.position"), 1e-5
    assert orbit.impacts.count > 0
    numbers, units = complete_scene(scene), np.stack([parameter_mask(scene, name) * 0.1 for name in names])
    rows = np.stack([np.asarray(leaf) for leaf in jax.tree.leaves(numbers)])
    given = jax.tree.map(lambda leaf: np.asarray(leaf)[None], impact_sequence_of(orbit))
    tests, slopes = (
        np.asarray(each)[0] for each in evaluate_test_gradients(jax.tree.structure(numbers), given, rows[None], units)
    )

    def seen(scene):
        along, z = polish_orbit(jv.find_orbit(scene, jv.State(0.8, -1.2)), "amplitude")
        look, rows = diagnose(along, z[None]), along.impact_rows + len(along.sequence.sides)
        return np.array([look.fold_test[0], look.flip_test[0], z[rows].min()])

    chosen = [FOLD, FLIP, ZERO_SPEED]
    assert tests[chosen] == pytest.approx(seen(scene), rel=1e-9)
    for k, name in enumerate(names):
        ends = [seen(scene.replace(**{name: float(scene.parameter(name)) + way})) for way in (step, -step)]
        assert slopes[chosen, k] == pytest.approx(0.1 * (ends[0] - ends[1]) / (2.0 * step), rel=1e-5), name


def test_what_cannot_be_is_one_clear_error(one_wall):
    bounds = {"amplitude": (0.9, 1.9), "frequency": (1.5, 1.9)}
    with pytest.raises(jv.ArgumentError, match=r"^kinds: must be one or more of SN, SB, PD, GR"):
        jv.search(one_wall, "HB", FREE, bounds)
    with pytest.raises(jv.ArgumentError, match=r"^bounds.amplitude: must be given"):
        jv.search(one_wall, "PD", FREE, {"frequency": (1.5, 1.9)})
    with pytest.raises(
        jv.ArgumentError, match=r"^bounds.frequency: must be \(low, high\) and contain the value of the scene, 1.7"
    ):
        jv.search(one_wall, "PD", FREE, bounds | {"frequency": (1.8, 1.9)})
    with pytest.raises(jv.ArgumentError, match=r"^free.amplitude: must be a positive number"):
        jv.search(one_wall, "PD", {"amplitude": 0.0}, bounds)
    with pytest.raises(jv.ArgumentError, match=r"^max_period: "):
        jv.search(one_wall, "PD", FREE, bounds, max_period=0)
