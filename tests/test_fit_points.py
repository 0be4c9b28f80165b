"""Numbers of a scene fitted to values of special points: against points of a scene whose numbers are known."""

import numpy as np
import pytest

import jaxvibro as jv

FREE = {"damping": 0.02, "restitution": 0.05}


@pytest.fixture(scope="module")
def scene():
    return jv.make_scene(2.0, 2.1, 0.05, 0.7, (-1.0, 1.0))


@pytest.fixture(scope="module")
def points(scene):
    branch = jv.follow(jv.find_orbit(scene, jv.State(0.9, -1.1)), "amplitude", (0.0, 6.0))
    return branch.points("SN")[0], branch.points("SB")[0]


@pytest.fixture(scope="module")
def values(scene):
    """Of both points where damping and restitution are others, found anew there."""
    true = scene.replace(damping=0.062, restitution=0.74)
    branch = jv.follow(jv.find_orbit(true, jv.State(0.9, -1.1)), "amplitude", (0.0, 6.0))
    return [branch.points(kind)[0].value for kind in ("SN", "SB")]


def test_the_numbers_that_made_the_values_are_found_with_their_errors(scene, points, values):
    fit = jv.fit(scene, jv.PointRecord(points, values, 1e-4), FREE)
    assert fit.status == jv.FitStatus.OK and fit.dof == 0
    assert list(fit.values.values()) == pytest.approx([0.062, 0.74], abs=1e-12)
    assert float(fit.scene.damping) == fit.values["damping"]
    by = np.stack([jv.sensitivity(one, list(FREE)).values for one in points])  # at 0.05 and 0.7, not far away
    rough = 1e-4 * np.sqrt(np.diag(np.linalg.inv(by.T @ by)))
    assert list(fit.sigma.values()) == pytest.approx(rough, rel=0.2)
    assert "damping" in fit.table() and "OK" in fit.table()


def test_several_numbers_may_be_one(scene, points, values):
    pair = ("left.restitution", "right.restitution")
    fit = jv.fit(scene, jv.PointRecord(points, values, 1e-4), {"damping": 0.02, pair: 0.05}, {pair: (0.5, 0.9)})
    assert list(fit.values) == ["damping", "left.restitution = right.restitution"]
    assert list(fit.values.values()) == pytest.approx([0.062, 0.74], abs=1e-12)
    assert [float(wall.restitution) for wall in fit.scene.walls.values()] == pytest.approx([0.74, 0.74], abs=1e-12)


def test_more_values_than_numbers_and_a_combination_that_they_do_not_say(scene, points, values):
    for off in (0.05, 0.06, 0.07, 0.2, 1.0):
        one = jv.fit(scene, jv.PointRecord(points, [values[0], values[1] + off], 1e-3), {"damping": 0.02})
        assert one.status == jv.FitStatus.MISFIT and one.dof == 1 and one.chi2 > 100.0
    rough = jv.fit(scene, jv.PointRecord(points, values, 0.5), FREE)
    assert rough.status == jv.FitStatus.UNIDENTIFIABLE and len(rough.unidentifiable) >= 1


def test_what_cannot_be_is_one_clear_error(scene, points, values):
    data = jv.PointRecord(points, values, 1e-4)
    for free, told in (
        ({}, r"^free: must be"),
        ({"amplitude": 0.1}, r"^free.amplitude: must not be the parameter of a point"),
        (
            {"damping": 0.02, "restitution": 0.05, "frequency": 0.1},
            r"^data: must hold at least 3 values, as many as unknowns",
        ),
        ({"damping": None}, r"^free.damping: must be a real number"),
        ({"size": 1.0}, r"^size: is not a parameter"),
    ):
        with pytest.raises(jv.ArgumentError, match=told):
            jv.fit(scene, data, free)
    with pytest.raises(jv.ArgumentError, match=r"^bounds.damping: must be \(low, high\)"):
        jv.fit(scene, data, FREE, {"damping": (0.1, 0.2)})
    with pytest.raises(jv.ArgumentError, match=r"^values: must have one entry for each point, 2"):
        jv.PointRecord(points, values[:1], 1e-4)
    with pytest.raises(jv.ArgumentError, match=r"^values: must be finite"):
        jv.PointRecord(points, [np.nan, 1.0], 1e-4)
    with pytest.raises(jv.ArgumentError, match=r"^walls: must be"):
        jv.PointRecord(points, values, 1e-4, ("up", None))
