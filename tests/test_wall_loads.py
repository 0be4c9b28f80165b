"""Loads on walls: closed forms, the same under equal forces, batches, units, branches and sweeps.

`tests/properties/test_flight.py` compares them with the energy that the mass loses.
"""

import numpy as np
import pytest

import jaxvibro as jv
from jaxvibro.maps.wall_loads import integrate_contacts

START = jv.State(0.3, 0.6)
GAMMA = 0.05


def soft_scene():
    walls = jv.Wall(-1.0, stiffness=30.0, damping=0.4), jv.Wall(0.8, stiffness=900.0, damping=2.0)
    return jv.make_scene(2.5, 1.7, GAMMA, 0.7, walls)


def linear(depth, rate, p):
    """The push of a spring and a damper, of a wall that stands still."""
    return p["k"] * depth + 2.0 * p["c"] * rate


def test_loads_under_a_force_are_those_of_the_equal_spring():
    """On a soft wall that moves, whose damping adds to that of a force alone, and on one with a contact law."""
    left = [jv.Wall(-0.5, None, 40.0, damping, jv.Motion(0.05, 0.3, 2)) for damping in (0.3 + GAMMA, 0.3)]
    right = jv.Wall(0.6, None, 30.0, 0.2 + GAMMA), jv.Wall(0.6, law=jv.Push(linear, {"k": 30.0, "c": 0.2}))
    force = jv.Force("duffing", {"cubic": 0.0, "damping": GAMMA})
    spring = jv.make_scene(1.5, 1.3, GAMMA, walls=(left[0], right[0]))
    own = jv.make_scene(1.5, 1.3, walls=(left[1], right[1]), force=force)
    expected, computed = (jv.wall_loads(scene, jv.State(0.3, 0.8, 0.4), 2) for scene in (spring, own))
    assert int(computed["status"]) == int(expected["status"]) == 0 and float(expected["largest_speed"].min()) > 0
    for name in ("largest_speed", "largest_force", "work_rate"):
        np.testing.assert_allclose(computed[name], expected[name], rtol=1e-9, atol=1e-12)


def test_a_ball_on_a_soft_ground_beside_a_force_in_closed_form():
    """No drive: it falls from 0 with -3 under x'' = -x onto a wall at -2, k 100 and gamma2 2.5."""
    wall = jv.Wall(-2.0, stiffness=100.0, damping=2.5)
    force = jv.Force("duffing", {"cubic": 0.0, "damping": 0.0})
    found = jv.wall_loads(jv.make_scene(0.0, 4.0, walls=(wall, None), force=force), jv.State(0.0, -3.0))
    speed = 5.0**0.5  # 3^2 - 2^2
    assert float(found["largest_speed"][0]) == pytest.approx(speed, rel=1e-12)
    # within it y'' + 5 y' + 101 y = -2 of the depth y, from y = 0 with y' = speed, until y = 0
    rest, root = -2.0 / 101.0, (101.0 - 2.5**2) ** 0.5
    t = np.linspace(0.0, 1.2 * np.pi / root, 2_000_001)
    sine = (speed - 2.5 * rest) / root
    y = rest + np.exp(-2.5 * t) * (-rest * np.cos(root * t) + sine * np.sin(root * t))
    w = np.exp(-2.5 * t) * (
        (2.5 * rest + root * sine) * np.cos(root * t) + (root * rest - 2.5 * sine) * np.sin(root * t)
    )
    end = np.flatnonzero(y[1:] < 0)[0] + 2
    push = (100.0 * y + 5.0 * w)[:end]
    assert float(found["largest_force"][0]) == pytest.approx(push.max(), rel=1e-9)
    work = np.trapezoid(push * w[:end], t[:end]) / (2.0 * np.pi / 4.0)
    assert float(found["work_rate"][0]) == pytest.approx(work, rel=1e-5)


def test_lanes_are_single_runs_and_units_are_attributes():
    scene, x = soft_scene(), np.array([[0.3, -0.5, 0.9], [0.0, 0.1, -1.05]])  # two of them begin within a wall
    many = jv.wall_loads(scene, jv.State(x, 0.6), 2)
    assert many["largest_force"].dims == ("lane_0", "lane_1", "wall") and many["wall"].values.tolist() == [
        "left",
        "right",
    ]
    for place in np.ndindex(x.shape):
        one = jv.wall_loads(scene, jv.State(x[place], 0.6), 2)
        for name in one:
            np.testing.assert_allclose(one[name], many[name][place], rtol=1e-10)
    rig = jv.scene_from_physical(0.5, None, 3e4, 30.0, None, 0.7, gap=0.5e-3, damping_ratio=0.05, frequency_hz=60.0)
    own = jv.wall_loads(rig, START)
    physical = jv.to_physical(own)
    assert physical["work_rate"].attrs["units"] == "W" and physical["largest_force"].attrs["units"] == "N"
    watts = 3e4 * 0.5e-3**2 * np.sqrt(6e4)
    np.testing.assert_allclose(physical["work_rate"], watts * own["work_rate"], rtol=1e-14)


def test_loads_along_a_branch_are_those_of_its_data():
    orbit = jv.find_orbit(jv.make_scene(4.65, 2.1, 0.05, 0.7, (-1.0, 1.0)), jv.State(0.9, -1.1))
    branch = jv.follow(orbit, "amplitude", (4.0, 5.0))
    told = branch.to_frame()
    states = jv.State(branch.data["x"].values[:, 0], branch.data["v"].values[:, 0])
    found = jv.wall_loads(branch.scene.replace(amplitude=branch.values), states)
    sure = np.abs(branch.multipliers).max(axis=1) < 50.0
    np.testing.assert_allclose(found["work_rate"].sum("wall")[sure], told["work_rate"][sure], rtol=1e-8)
    np.testing.assert_allclose(found["largest_speed"].max("wall")[sure], told["largest_speed"][sure], rtol=1e-8)


def test_a_mass_that_comes_to_rest_leaves_all_its_energy():
    """Without a drive between still walls: what is lost is the energy at the start, less that of the pressed spring."""
    scene = jv.make_scene(0.0, 1.0, 0.0, 0.4, (0.5, None))
    found = jv.wall_loads(scene, jv.State(1.5, 0.0), 3)
    span = 6 * np.pi
    assert float(found["work_rate"].sum()) * span == pytest.approx(0.5 * (1.5**2 - 0.5**2), rel=1e-9)


@pytest.mark.parametrize("rounding", [0.0, 1e-9])
def test_the_work_of_a_force_that_decays_oscillates_or_is_not_smooth(rounding):
    """Closed forms over the time 3: a decay, a rise and decay, a power, a step, an oscillation; also with noise."""
    rates = np.array([1.0, 30.0, 1e3, 3e5])
    noise = np.random.default_rng(3)

    def compute(force, speed):
        def forces_in_panels(rows, times):
            values = force(rates[rows][:, None], times) * (1.0 + rounding * noise.uniform(-0.5, 0.5, times.shape))
            return values, speed(rates[rows][:, None], times), rounding * abs(values).max(axis=1)

        return integrate_contacts(forces_in_panels, np.full(4, 3.0))

    def one(a, t):
        return 1.0 + 0.0 * a * t

    def decay(a, t):
        return np.exp(-a * t)

    for force, speed, largest, work, error in (
        (decay, decay, 1.0, -0.5 * np.expm1(-6.0 * rates) / rates, 0.0),
        (
            lambda a, t: a * t * decay(a, t),
            one,
            np.exp(-1.0),
            (1.0 - (1.0 + 3.0 * rates) * decay(rates, 3.0)) / rates,
            0,
        ),
        (lambda a, t: t**1.5, one, 3.0**1.5, 3.0**2.5 / 2.5, 0.0),
        (lambda a, t: 1.0 * (a * t < 1.0), one, 1.0, 1.0 / rates, 2e-6),
    ):
        found = compute(force, speed)
        np.testing.assert_allclose(found[0], largest, rtol=1e-8)
        np.testing.assert_allclose(found[1], work, rtol=1e-8, atol=error)
    rates = rates[[0, 1, 2, 2]]
    found = compute(lambda a, t: np.sin(a * t), lambda a, t: np.cos(a * t))
    np.testing.assert_allclose(found[0][1:], 1.0, rtol=1e-8)
    np.testing.assert_allclose(found[1], np.sin(3.0 * rates) ** 2 / 2.0 / rates, rtol=0, atol=1e-9)


def test_contact_phases_in_which_the_force_varies_fast_are_divided():
    """Without drive and damping, what a mass loses that settles on a soft wall is the work."""
    stiffness, ratio = np.array([[1e4], [1e8]]), np.array([0.2, 0.3, 1.0, 4.0])
    damping = ratio * np.sqrt(stiffness)
    scene = jv.make_scene(0.0, 0.8, 0.0, walls=(jv.Wall(0.5, None, stiffness, damping), None))
    start = jv.State(np.where(ratio > 0.5, 0.7, 0.5), -np.sqrt(ratio))
    found = jv.wall_loads(scene, start)
    at_rest = 0.5 * stiffness / (stiffness + 1.0)
    lost = 0.5 * (np.asarray(start.x) ** 2 + np.asarray(start.v) ** 2 - at_rest**2)
    np.testing.assert_allclose(found["work_rate"].values[..., 0] * 2.0 * np.pi / 0.8, lost, rtol=1e-9)
    largest, speed = (found[name].values[..., 0] for name in ("largest_force", "largest_speed"))
    np.testing.assert_allclose(largest[:, 2:], (2.0 * damping * speed)[:, 2:], rtol=1e-9)  # it falls from the entry on


def test_invalid_arguments_are_refused():
    with pytest.raises(jv.ArgumentError, match="periods: must be"):
        jv.wall_loads(soft_scene(), START, 0)
    assert jv.wall_loads(jv.make_scene(1.0, 1.0, 0.1, 0.5, (None, None)), START)["status"] == 0


def test_loads_of_a_sweep_keep_its_dimensions():
    scene = jv.make_scene(2.0, 2.1, 0.05, 0.7, (-1.0, 1.0))
    swept = jv.sweep(scene, "amplitude", [1.5, 2.5, 3.5], jv.State(0.9, -1.1), settle=20, keep=2)
    found = jv.wall_loads(scene, swept)
    assert found["work_rate"].dims == (*swept["x"].dims, "wall") and found["amplitude"].equals(swept["amplitude"])
    states = jv.State(swept["x"].values, swept["v"].values)
    own = jv.wall_loads(scene.replace(amplitude=swept["amplitude"].values[:, None]), states)
    assert np.array_equal(found["largest_speed"].values, own["largest_speed"].values)
    with pytest.raises(jv.ArgumentError, match="state: must be a State, or a Dataset of sweep"):
        jv.wall_loads(scene, found)
