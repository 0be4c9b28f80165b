"""Branches of motions without impacts: under a force they fold, tilt and double their period as others do."""

import mpmath
import numpy as np
import pytest
from mpmath import mp, mpf

import jaxvibro as jv
from jaxvibro.problem.orbit_point import is_own_mirror_image

from .reference import own_force


def pendulum(amplitude, walls=(None, None)):
    """The pendulum of Baker and Gollub, Chaotic Dynamics, chapter 3: q = 2, driven at 2 / 3."""
    force = jv.Force("pendulum", {"damping": 0.25})
    return jv.make_scene(amplitude, 2.0 / 3.0, restitution=0.7, walls=walls, force=force)


def matrix_of(force, point):
    """(how far the orbit of a special point is from periodic, its monodromy matrix), in many digits."""
    scene, orbit = point.scene, point.orbit
    numbers = {name: float(value) for name, value in scene.force.numbers.items()}
    step, x, v = mpf(10) ** -10, mpf(orbit.state.x), mpf(orbit.state.v)

    def move(x, v):
        given = mpf(point.value), float(scene.frequency), (None, None), 0.7, x, v, orbit.periods
        return own_force.flown(force, numbers, *given)[0]

    end, ends = move(x, v), [[move(x + s * step, v), move(x, v + s * step)] for s in (1, -1)]
    columns = [[(p - q) / (2 * step) for p, q in zip(ends[0][k], ends[1][k], strict=True)] for k in (0, 1)]
    return max(abs(end[0] - x), abs(end[1] - v)), mp.matrix(columns).T


def test_a_pendulum_tilts_and_doubles_its_period_where_digits_say_so():
    orbit = jv.find_orbit(pendulum(0.95), jv.State(0.1, 0.0))
    (tilt,) = jv.follow(orbit, "amplitude", (0.95, 1.02), direction="forward").points("SB")
    tilted = jv.switch(tilt, bounds=(0.9, 1.08))
    assert [one.label for one in tilted[0].special] == ["P100", "P100", "P100"] and len(tilted) == 2
    (double,) = tilted[0].points("PD")
    assert abs(double.value - tilted[1].points("PD")[0].value) < 1e-11  # of its mirror image
    assert abs(double.value - 1.0663) < 2e-4  # as printed there
    (twice,) = jv.switch(double)
    assert twice.special[1].kind == "PD" and twice.special[1].label == "P200" and twice.stable[1]
    assert is_own_mirror_image(tilt.scene, tilt.spot) and not is_own_mirror_image(double.scene, double.spot)
    for point in (tilt, double, twice.special[1]):
        with mpmath.workdps(26):
            off, matrix = matrix_of(own_force.pendulum, point)
            sign = -1 if point.kind == "PD" else 1
            assert off < 1e-11 and abs(mp.det(matrix - sign * mp.eye(2))) < 1e-9
    assert tilt.normal_form is None and "P200" in twice.table()
    for ask in (lambda: jv.sensitivity(double, ["force.damping"]), lambda: jv.located(tilt)):
        with pytest.raises(jv.ArgumentError, match="special: must belong to an orbit with impacts"):
            ask()


def test_duffings_resonance_folds_where_digits_say_so():
    """The hard spring without walls: driven at 1.6, between two folds two motions are stable."""
    force = jv.Force("duffing", {"cubic": 1.0, "damping": 0.05})
    scene = jv.make_scene(0.1, 1.6, restitution=0.7, walls=(None, None), force=force)
    branch = jv.follow(jv.find_orbit(scene, jv.State(0.0, 0.0)), "amplitude", (0.05, 1.5))
    folds = branch.points("SN")
    assert len(folds) == 2 and branch.data["least_clearance"].values.min() == np.inf
    assert all(one.normal_form is None for one in folds) and "SN" in branch.table()
    between = abs(branch.values - np.mean([one.value for one in folds])) < 0.05
    assert branch.stable[between].any() and not branch.stable[between].all()
    for point in folds:
        with mpmath.workdps(26):
            off, matrix = matrix_of(own_force.duffing, point)
            assert off < 1e-11 and abs(mp.det(matrix - mp.eye(2))) < 1e-9


def test_a_spring_without_walls_has_a_branch():
    scene = jv.make_scene(1.0, 2.0, 0.05, 0.7, (None, None))
    branch = jv.follow(jv.find_orbit(scene, jv.State(0.0, 0.0)), "frequency", (0.5, 3.0))
    assert [one.kind for one in branch.special] == ["EP", "EP"]
    peak = np.hypot(branch.data["x"].values[:, 0], branch.data["v"].values[:, 0] / branch.values)
    assert np.allclose(peak, 1.0 / np.hypot(1.0 - branch.values**2, 0.1 * branch.values), rtol=1e-9)
    assert np.isinf(branch.data["least_clearance"].values).all()
