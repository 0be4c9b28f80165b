"""The nearest bifurcations, and bifurcations moved: against closed forms, loci and what may not be."""

import numpy as np
import pytest
from scipy.optimize import minimize

import jaxvibro as jv
from tests.reference import closed

GAMMA, OMEGA, R = 0.05, 2.1, 0.7
FREE = {"amplitude": 0.1, "frequency": 0.05, "damping": 0.01}


@pytest.fixture(scope="module")
def orbit():
    scene = jv.make_scene(2.0, OMEGA, GAMMA, R, (-1.0, 1.0))
    return jv.find_orbit(scene, jv.State(0.9, -1.1))


@pytest.fixture(scope="module")
def near(orbit):
    return jv.margin(orbit, FREE)


def fold(frequency, damping):
    return float(closed.fold(damping, frequency, R, 1.0, symmetric=True).amplitude)


def least(value, start):
    """The least distance to where the amplitude is a function of frequency and damping: by another's search."""

    def square(change):
        frequency, damping = OMEGA + 0.05 * change[0], GAMMA + 0.01 * change[1]
        return ((value(frequency, damping) - 2.0) / 0.1) ** 2 + change @ change

    found = minimize(square, start, method="Nelder-Mead", options={"xatol": 1e-9, "fatol": 1e-14, "maxiter": 4000})
    return np.sqrt(found.fun), found.x


def test_the_nearest_fold_is_that_of_the_closed_form(near):
    (point,) = (one for one in near.points if one.kind == "SN")
    distance, change = least(fold, np.array([4.0, 5.0]))
    assert point.distance == pytest.approx(distance, abs=1e-9) and point.status == "reached"
    assert point.change["frequency"] / 0.05 == pytest.approx(change[0], abs=1e-4)
    assert point.slope < 1e-12 and point.residual < 1e-12
    assert float(point.scene.amplitude) == pytest.approx(
        fold(float(point.scene.frequency), float(point.scene.damping)), abs=1e-12
    )


def test_the_kinds_come_in_order_and_their_directions_are_units(near):
    assert [one.kind for one in near.points] == ["SB", "SN"] and near.distance == near.points[0].distance
    for one in near.points:
        assert sum(each**2 for each in one.direction.values()) == pytest.approx(1.0)
        offset = {name: one.change[name] / unit for name, unit in FREE.items()}
        assert offset == pytest.approx({name: one.distance * each for name, each in one.direction.items()})
    lines = near.table().splitlines()
    assert lines[0].split() == ["kind", "distance", *FREE, "status"] and lines[1].startswith("SB    9.1")


def test_a_bound_holds_the_nearest_point(orbit):
    free = {"amplitude": 0.1, "frequency": 0.05}
    loose = jv.margin(orbit, free, kinds="SN").points[0]
    low = jv.margin(orbit, free, {"frequency": (2.0, 2.2)}, kinds="SN").points[0]
    assert float(loose.scene.frequency) > 2.25 and low.at_bound == ("frequency",)
    assert float(low.scene.frequency) == 2.2
    assert float(low.scene.amplitude) == pytest.approx(fold(2.2, GAMMA), abs=1e-12)


def test_a_motion_without_impacts_ends_where_it_touches_a_wall():
    scene = jv.make_scene(2.0, OMEGA, GAMMA, R, (-1.5, 1.0))
    orbit = jv.find_orbit(scene, jv.State(-0.58, 0.05))
    near = jv.margin(orbit, {"amplitude": 0.1, "right.position": 0.05})
    (point,) = near.points
    gain = 1.0 / float(closed.grazing(GAMMA, OMEGA, 1.0))
    # the line A gain = x in units of each
    normal = np.array([0.1 * gain, -0.05])
    assert point.kind == "GR" and point.sides == (1,)
    assert point.distance == pytest.approx((1.0 - 2.0 * gain) / np.linalg.norm(normal), abs=1e-12)
    assert list(point.direction.values()) == pytest.approx(normal / np.linalg.norm(normal), abs=1e-12)


def test_a_period_doubling_that_ends_on_a_grazing_has_its_nearest_point_there():
    """P101 near the resonant grazing, where the free flow of a drive period leaves a speed no trace: sin = 0."""
    amplitude, frequency, place = 3.02, 1.93, 0.79
    scene = jv.make_scene(amplitude, frequency, 0.032, 0.79, (None, place))
    near = jv.margin(jv.find_orbit(scene, jv.State(-9.66, 9.05)), {"damping": 0.1, "right.position": 0.2})
    (point,) = (one for one in near.points if one.kind == "PD")
    damping = np.sqrt(1.0 - (0.5 * frequency) ** 2)
    wall = amplitude / np.hypot(1.0 - frequency**2, 2.0 * damping * frequency)
    assert point.edge == "an impact without speed" and point.status == "reached"
    assert float(point.scene.damping) == pytest.approx(damping, abs=1e-12)
    assert float(point.scene.right.position) == pytest.approx(wall, abs=1e-12)
    assert point.distance == pytest.approx(np.hypot((damping - 0.032) / 0.1, (wall - place) / 0.2), abs=1e-11)
    assert "ends there in an impact without speed" in near.table()


def test_an_end_of_a_boundary_keeps_to_the_bounds():
    """The same with the amplitude free: the end is a line, wall = c amplitude, and the bound cuts it off."""
    amplitude, frequency, place = 3.02, 1.93, 0.79
    orbit = jv.find_orbit(jv.make_scene(amplitude, frequency, 0.032, 0.79, (None, place)), jv.State(-9.66, 9.05))
    free = {"damping": 0.1, "right.position": 0.2, "amplitude": 0.5}
    damping = np.sqrt(1.0 - (0.5 * frequency) ** 2)
    slope = 1.0 / np.hypot(1.0 - frequency**2, 2.0 * damping * frequency)
    best = (place * slope / 0.2**2 + amplitude / 0.5**2) / (slope**2 / 0.2**2 + 1.0 / 0.5**2)
    limit = 0.5 * (best + amplitude)
    within = (limit, 4.0) if best < amplitude else (2.0, limit)
    for bounds, there in (({}, best), ({"amplitude": within}, limit)):
        (point,) = (one for one in jv.margin(orbit, free, bounds).points if one.kind == "PD")
        assert point.edge == "an impact without speed"
        assert float(point.scene.amplitude) == pytest.approx(there, abs=1e-9)
        assert float(point.scene.damping) == pytest.approx(damping, abs=1e-11)
        assert float(point.scene.right.position) == pytest.approx(slope * there, abs=1e-11)
        assert point.at_bound == (("amplitude",) if bounds else ())


@pytest.mark.parametrize(
    "amplitude, frequency, times",
    [
        (0.7233604331, 1.1749217932, (2.2598981, 4.9738107, 11.1848721)),
        (0.7432175560, 1.1773081508, (2.6730035, 5.1108067, 11.0407840)),
    ],
)
def test_the_tip_of_a_cusp_is_nearest_from_beside_it(amplitude, frequency, times):
    """P212, from either side of the cusp that test_locus.py holds against 40 digits."""
    scene = jv.make_scene(amplitude, frequency, 0.02, 0.9, (-1.5, 1.0))
    found = jv.solve_orbits(scene, (np.array(times), np.array([0.73, 0.95, 1.52])), ("", "LRR"))
    orbit = jv.find_orbit(scene, jv.State(float(found.state.x), float(found.state.v)), 2, settle=0)
    unit = 0.01
    (point,) = (one for one in jv.margin(orbit, {"amplitude": unit, "frequency": unit}).points if one.kind == "SN")
    tip = 0.732811723456128, 1.180086394958394
    assert point.edge == "a cusp" and point.status == "reached"
    assert [float(point.scene.amplitude), float(point.scene.frequency)] == pytest.approx(tip, abs=1e-11)
    assert point.distance == pytest.approx(np.hypot(tip[0] - amplitude, tip[1] - frequency) / unit, abs=1e-9)


@pytest.fixture(scope="module")
def fold_point(orbit):
    return jv.follow(orbit, "amplitude", (0.0, 3.0)).points("SN")[0]


def test_a_fold_is_moved_by_the_least_change(fold_point):
    free = {"damping": 0.05, "frequency": 0.1}
    placed = jv.place(fold_point, "amplitude", 0.6, free)
    frequency, damping = float(placed.scene.frequency), float(placed.scene.damping)
    assert placed.met and fold(frequency, damping) == pytest.approx(0.6, abs=1e-13) and placed.slope < 1e-12
    step = 1e-6
    normal = [
        0.05 * (fold(frequency, damping + step) - fold(frequency, damping - step)),
        0.1 * (fold(frequency + step, damping) - fold(frequency - step, damping)),
    ]
    change = [placed.change["damping"] / 0.05, placed.change["frequency"] / 0.1]
    assert abs(normal[0] * change[1] - normal[1] * change[0]) < 1e-8 * np.linalg.norm(normal)


def test_a_bound_takes_part_and_what_cannot_be_is_told(fold_point):
    free = {"damping": 0.05, "frequency": 0.1}
    placed = jv.place(fold_point, "amplitude", 0.6, free, {"damping": (0.0, 0.06)})
    assert placed.met and placed.at_bound == ("damping",) and float(placed.scene.damping) == pytest.approx(0.06)
    assert placed.values[0] == pytest.approx(0.6, abs=1e-12)
    stopped = jv.place(fold_point, "amplitude", 2.0, {"damping": 0.05}, {"damping": (0.0, 0.06)})
    assert not stopped.met and "damping is at a bound" in stopped.why
    assert stopped.values[0] == pytest.approx(fold(OMEGA, float(stopped.scene.damping)), abs=1e-12)


@pytest.mark.parametrize(
    "free, bounds, told",
    [
        ({}, None, "free: must be {name: unit}"),
        ({"amplitude": 0.0}, None, "free.amplitude: must be a positive number"),
        ({"mass": 1.0}, None, "mass"),
        ({"amplitude": 1.0}, {"damping": (0.0, 1.0)}, "bounds.damping: must belong to a free parameter"),
        (
            {"amplitude": 1.0},
            {"amplitude": (3.0, 4.0)},
            "bounds.amplitude: must be .* contain the value of the scene, 2",
        ),
    ],
)
def test_bad_arguments(orbit, free, bounds, told):
    with pytest.raises(jv.ArgumentError, match=told):
        jv.margin(orbit, free, bounds)


@pytest.mark.parametrize(
    "target, free, told",
    [
        (0.6, {"amplitude": 1.0}, "free.amplitude: must not be a parameter that is placed"),
        (np.nan, {"damping": 1.0}, "target: must be a finite number"),
        ([0.6, 0.7], {"damping": 1.0}, "target: must be a finite number for each of 1"),
    ],
)
def test_bad_targets(fold_point, target, free, told):
    with pytest.raises(jv.ArgumentError, match=told):
        jv.place(fold_point, "amplitude", target, free)
