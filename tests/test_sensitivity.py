"""What moves special points: against differences of points found again, and against the gradient of `located`."""

from dataclasses import replace

import jax
import numpy as np
import pytest

import jaxvibro as jv
from continuation import augmented_systems
from jaxvibro.loci.locus_start import make_locus_start, problems_at_locus_start
from jaxvibro.loci.point_continuation import make_continued_point, value_gradient
from jaxvibro.problem.orbit_equations import continuation_problem


def begun(kind):
    """P111 between unlike walls, or between walls that are alike, as an SB needs them."""
    right = 1.0 if kind == "SB" else jv.Wall(1.05, 0.66)
    scene = jv.make_scene(2.0, 2.1, 0.05, 0.7, (-1.0, right))
    return jv.find_orbit(scene, jv.State(0.9, -1.1))


def point_of(orbit, kind):
    """The first of the kind on the branch through an orbit."""
    return jv.follow(orbit, "amplitude", (0.0, 6.0), stop=kind).points(kind)[0]


@pytest.fixture(scope="module")
def points():
    return {kind: point_of(begun(kind), kind) for kind in ("PD", "SB")}


def test_slopes_are_differences_of_points_found_again(points):
    point, step = points["PD"], 1e-5
    table = jv.sensitivity(point)
    alone = ["left.restitution", "right.restitution", "left.position", "right.position"]
    assert sorted(table["number"].values) == sorted(["frequency", "damping", "restitution", *alone])
    assert table.attrs["amplitude"] == point.value
    for name in ("damping", "right.position"):
        value = float(point.scene.parameter(name))
        assert float(table["value"].sel(number=name)) == value
        slope, ends = float(table.sel(number=name)), []
        for way in (step, -step):
            scene = begun("PD").scene.replace(**{name: value + way})
            ends.append(point_of(jv.find_orbit(scene, jv.State(0.9, -1.1)), "PD").value)
        assert slope == pytest.approx((ends[0] - ends[1]) / (2.0 * step), rel=1e-6), name


def test_slopes_are_the_gradient_of_the_located_point(points):
    by = jax.grad(jv.located(points["PD"]))(points["PD"].scene)
    table = jv.sensitivity(points["PD"], ["damping", "frequency"])
    assert np.allclose(table, [by.damping, by.frequency], rtol=1e-11, atol=0)


def test_several_that_are_one_keep_an_sb(points):
    assert jv.sensitivity(points["SB"])["number"].values.tolist() == ["frequency", "damping", "restitution"]
    both = jv.sensitivity(points["SB"], [("left.restitution", "right.restitution"), "damping"])
    more = {"left.restitution": 0.7001, "right.restitution": 0.7001}
    known = jv.located(points["SB"]).solve(points["SB"].scene.replace(**more))
    assert both["number"].values.tolist() == ["left.restitution = right.restitution", "damping"]
    assert float(both[0]) == pytest.approx((float(known.value) - points["SB"].value) / 1e-4, rel=1e-3)
    with pytest.raises(jv.ArgumentError, match=r"^names: must keep the scene symmetric"):
        jv.sensitivity(points["SB"], "right.position")


def test_a_fold_that_is_held_moves_as_its_sensitivity_says():
    orbit, names = begun("PD"), ("damping", "frequency")
    (point,) = jv.follow(orbit, "amplitude", (0.0, 6.0), "backward", stop="SN").points("SN")
    assert value_gradient(make_continued_point(point, names)) == pytest.approx(
        jv.sensitivity(point, names).values, rel=1e-8
    )


@pytest.mark.parametrize("kind", ["PD", "SB"])
def test_the_equations_of_a_locus_are_zero_at_the_point(points, kind):
    """A change comes back as its opposite, after the whole or half of the orbit."""
    ((curve, z),) = problems_at_locus_start(make_locus_start(points[kind]), ("amplitude", "damping"))
    assert abs(np.asarray(augmented_systems.evaluate_problem(continuation_problem(curve), z, curve)[0])).max() < 1e-9
    turned = curve._replace(multiplier=-curve.multiplier)
    assert abs(np.asarray(augmented_systems.evaluate_problem(continuation_problem(turned), z, turned)[0][-1])) > 1e-3


@pytest.mark.parametrize("names", [(), ("amplitude",), ("damping", "damping"), ("size",)])
def test_names_that_cannot_be_are_one_clear_error(points, names):
    with pytest.raises(jv.ArgumentError, match=r"^names|size"):
        jv.sensitivity(points["PD"], names)


def test_a_point_of_another_kind_is_refused(points):
    with pytest.raises(jv.ArgumentError, match=r"^special: must be a special point of kind SN, PD, SB, GR; got .bound"):
        jv.sensitivity(replace(points["PD"], kind="bound"), ("damping",))
