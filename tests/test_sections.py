"""Trajectories for pictures, sections of a motion, and the maps from impact to impact."""

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import pytest

import jaxvibro as jv

SCENE = {"amplitude": 2.0, "frequency": 2.1, "damping": 0.05, "restitution": 0.7, "walls": (-1.0, 1.0)}
MOVING = {"walls": (jv.Wall(-1.2, 0.6), jv.Wall(1.0, None, motion=jv.Motion(0.1, 0.5)))}


def test_an_orbit_leaves_one_point_on_each_section():
    scene = jv.make_scene(**SCENE)
    found = jv.sections(scene, jv.State(0.9, -1.1), periods=10)
    orbit = jv.find_orbit(scene, jv.State(0.9, -1.1))
    assert found["x"].values == pytest.approx(np.full(10, orbit.state.x), abs=1e-9)
    assert found["v"].values == pytest.approx(np.full(10, orbit.state.v), abs=1e-9)
    for name, side in (("left", -1), ("right", 1)):
        here = np.asarray(orbit.impacts.side) == side
        late, speed = (np.asarray(each)[here] for each in (orbit.impacts.time, orbit.impacts.speed))
        assert found[f"{name}_phase"].values == pytest.approx(np.full(10, 2.1 * late), abs=1e-8)
        assert found[f"{name}_velocity"].values == pytest.approx(np.full(10, -0.7 * side * speed), abs=1e-8)


def test_the_maps_lead_from_each_point_to_the_next():
    scene = jv.make_scene(**SCENE | MOVING | {"amplitude": 5.4})
    found = jv.sections(scene, jv.State(0.5, -1.1), phase=2.0, periods=30, settle=50)
    end, _ = jv.strobe(scene, jv.State(found["x"].values[:-1], found["v"].values[:-1], 2.0))
    assert found["x"].values[1:] == pytest.approx(np.asarray(end.x), abs=1e-9)
    for name in ("left", "right"):
        phase, velocity = (found[f"{name}_{key}"].values for key in ("phase", "velocity"))
        assert len(phase) > 20
        after = jv.return_map(scene, name, phase[:-1], velocity[:-1], periods=4)
        assert np.asarray(after.found).all()
        turn = np.angle(np.exp(1j * (phase[1:] - np.asarray(after.phase))))
        assert abs(turn).max() < 1e-7
        assert velocity[1:] == pytest.approx(np.asarray(after.velocity), abs=1e-7)


def test_a_missing_wall_has_no_points():
    found = jv.sections(jv.make_scene(**SCENE | {"walls": (None, 1.0)}), jv.State(0.0, 0.0), periods=3)
    assert found.sizes["left_impact"] == 0 and found.sizes["period"] == 3


def test_pictures():
    found = jv.sections(jv.make_scene(**SCENE), jv.State(0.9, -1.1), periods=5)
    for which, line in (("sigma", found["x"]), ("left", found["left_phase"] / np.pi)):
        ax = jv.plot.section(found, which)
        assert ax.lines[0].get_xdata() == pytest.approx(line.values)
        assert ax.get_xlabel() and ax.get_ylabel()
    with pytest.raises(jv.ArgumentError, match="which"):
        jv.plot.section(found, "top")
    plt.close("all")


@pytest.mark.parametrize(
    ("key", "given"), [("periods", {"periods": 0}), ("settle", {"settle": -1}), ("phase", {"phase": np.nan})]
)
def test_bad_arguments_are_refused(key, given):
    with pytest.raises(jv.ArgumentError) as error:
        jv.sections(jv.make_scene(**SCENE), jv.State(0.9, -1.1), **given)
    assert error.value.key == key


@pytest.mark.parametrize("side", ["left", "right"])
def test_an_orbit_comes_back_and_its_multipliers_are_those_of_the_map(side):
    scene = jv.make_scene(**SCENE | {"amplitude": 4.65})
    orbit = jv.find_orbit(scene, jv.State(0.9, -1.1))
    sign = -1 if side == "left" else 1
    k = int(np.flatnonzero(orbit.impacts.side == sign)[0])
    start = jnp.array([2.1 * orbit.impacts.time[k], -0.7 * sign * orbit.impacts.speed[k]])

    def back(at):
        done = jv.return_map(scene, side, at[0], at[1])
        return jnp.stack([done.phase, done.velocity]), done

    slopes, done = jax.jit(jax.jacfwd(lambda at: back(at)[0])), jax.jit(lambda at: back(at)[1])(start)
    assert np.allclose(back(start)[0], [np.mod(start[0], 2 * np.pi), start[1]], rtol=0, atol=1e-13)
    assert (bool(done.found), int(done.between), int(done.status)) == (True, 1, 0)
    assert abs(done.time - 2 * np.pi / 2.1) < 1e-13
    found = sorted(np.linalg.eigvals(slopes(start)), key=lambda each: -each.imag)
    assert np.allclose(found, orbit.multipliers, rtol=0, atol=1e-12)


def test_no_return():
    scene = jv.make_scene(**SCENE | {"amplitude": 0.0})
    done = jv.return_map(scene, "left", np.array([0.0, 1.0]), 0.2)
    assert not np.any(done.found) and np.all(np.isnan(done.time))


def test_a_wall_that_is_not_there_is_refused():
    with pytest.raises(jv.ArgumentError, match=r"^side: must be a wall of the scene"):
        jv.return_map(jv.make_scene(1.0, 2.0, 0.1, 0.5, (None, 1.0)), "left", 0.0, 1.0)


@pytest.fixture(scope="module")
def moving():
    wall = jv.Wall(1.0, 0.6, motion=jv.Motion(0.1, 0.3, 2))
    return jv.make_scene(2.0, 2.1, 0.05, 0.7, (-1.2, wall))


def test_trajectory_ends_where_the_strobe_does(moving):
    path = jv.simulate(moving, jv.State(0.5, -1.1, 0.4), periods=3, samples=50)
    end, impacts = jv.strobe(moving, jv.State(0.5, -1.1, 0.4), periods=3, slots=32)
    hits = int(impacts.count)
    assert abs(path.x.values[-1] - float(end.x)) < 1e-12
    assert abs(path.v.values[-1] - float(end.v)) < 1e-12
    assert np.allclose(path.impact_time, impacts.time[:hits], rtol=0, atol=1e-12)
    assert np.array_equal(path.side, impacts.side[:hits])
    assert np.allclose(path.speed, impacts.speed[:hits], rtol=0, atol=1e-12)
    assert hits > 2


def test_samples_are_even_and_between_the_walls(moving):
    path = jv.simulate(moving, jv.State(0.5, -1.1, 0.4), periods=3, samples=50)
    assert np.allclose(np.diff(path.time), 2 * np.pi / 2.1 / 50, rtol=1e-12)
    right = 1.0 + 0.1 * np.cos(2 * path.phase + 0.3)
    assert np.all(path.x >= -1.2 - 1e-12)
    assert np.all(path.x <= right + 1e-12)
    hit = path.side == 1
    at = 1.0 + 0.1 * np.cos(2 * (0.4 + 2.1 * path.impact_time[hit]) + 0.3)
    assert np.allclose(path.position[hit], at, rtol=0, atol=1e-14)


def test_a_batch_and_a_start_beyond_a_wall_are_refused(moving):
    with pytest.raises(jv.ArgumentError, match=r"^state: must be a single state"):
        jv.simulate(moving, jv.State(jnp.zeros(2), 0.0), periods=3, samples=50)
    with pytest.raises(jv.ArgumentError, match=r"^state\.x: must lie between the walls at its phase; got 7\.0"):
        jv.simulate(moving, jv.State(7.0, 0.0, 0.4), periods=3, samples=50)
