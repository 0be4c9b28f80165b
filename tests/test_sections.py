"""Trajectories for pictures, sections of a motion, and the maps from impact to impact."""

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import pytest

import jaxvibro as jv

SCENE = {"amplitude": 2.0, "frequency": 2.1, "damping": 0.05, "restitution": 0.7, "walls": (-1.0, 1.0)}
MOVING = {"walls": (jv.Wall(-1.2, 0.6), jv.Wall(1.0, None, motion=jv.Motion(0.1, 0.5)))}


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


def test_sections_of_an_orbit_and_their_pictures():
    scene = jv.make_scene(**SCENE)
    found = jv.sections(scene, jv.State(0.9, -1.1), periods=5)
    orbit = jv.find_orbit(scene, jv.State(0.9, -1.1))
    assert found["x"].values == pytest.approx(np.full(5, orbit.state.x), abs=1e-9)
    for name, side in (("left", -1), ("right", 1)):
        hit = np.asarray(orbit.impacts.side) == side
        assert found[f"{name}_phase"].values == pytest.approx(np.full(5, 2.1 * orbit.impacts.time[hit]), abs=1e-8)
    for which, line in (("sigma", found["x"]), ("left", found["left_phase"] / np.pi)):
        ax = jv.plot.section(found, which)
        assert ax.lines[0].get_xdata() == pytest.approx(line.values)
        assert ax.get_xlabel() and ax.get_ylabel()
    with pytest.raises(jv.ArgumentError, match="which"):
        jv.plot.section(found, "top")
    plt.close("all")
    missing = jv.sections(jv.make_scene(**SCENE | {"walls": (None, 1.0)}), jv.State(0.0, 0.0), periods=3)
    assert missing.sizes["left_impact"] == 0 and missing.sizes["period"] == 3


def test_an_orbit_comes_back_and_its_multipliers_are_those_of_the_map():
    scene = jv.make_scene(**SCENE | {"amplitude": 4.65})
    orbit = jv.find_orbit(scene, jv.State(0.9, -1.1))
    k = int(np.flatnonzero(orbit.impacts.side == 1)[0])
    start = jnp.array([2.1 * orbit.impacts.time[k], -0.7 * orbit.impacts.speed[k]])

    def back(at):
        end = jv.return_map(scene, "right", at[0], at[1])
        return jnp.stack([end.phase, end.velocity]), end

    slopes, end = jax.jit(jax.jacfwd(back, has_aux=True))(start)
    assert np.allclose([end.phase, end.velocity], [np.mod(start[0], 2 * np.pi), start[1]], rtol=0, atol=1e-13)
    assert (bool(end.found), int(end.between), int(end.status)) == (True, 1, 0)
    assert abs(end.time - 2 * np.pi / 2.1) < 1e-13
    found = sorted(np.linalg.eigvals(slopes), key=lambda each: -each.imag)
    assert np.allclose(found, orbit.multipliers, rtol=0, atol=1e-12)
    none = jv.return_map(scene.replace(amplitude=0.0), "right", np.array([0.0, 1.0]), -0.2)
    assert not np.any(none.found) and np.all(np.isnan(none.time))


def test_a_trajectory_is_even_in_time_stays_between_the_walls_and_ends_where_the_strobe_does():
    wall = jv.Wall(1.0, 0.6, motion=jv.Motion(0.1, 0.3, 2))
    scene, start = jv.make_scene(2.0, 2.1, 0.05, 0.7, (-1.2, wall)), jv.State(0.5, -1.1, 0.4)
    path = jv.simulate(scene, start, periods=3, samples=50)
    end, impacts = jv.strobe(scene, start, periods=3, slots=32)
    hits = int(impacts.count)
    assert hits > 2 and np.array_equal(path.side, impacts.side[:hits])
    for computed, expected in (
        ((path.x.values[-1], path.v.values[-1]), (end.x, end.v)),
        (path.impact_time, impacts.time[:hits]),
        (path.speed, impacts.speed[:hits]),
        (np.diff(path.time), np.full(150, 2 * np.pi / 2.1 / 50)),
    ):
        assert np.allclose(computed, expected, rtol=0, atol=1e-12)
    right = 1.0 + 0.1 * np.cos(2 * path.phase + 0.3)
    assert np.all((path.x >= -1.2 - 1e-12) & (path.x <= right + 1e-12))
    hit = path.side == 1
    at = 1.0 + 0.1 * np.cos(2 * (0.4 + 2.1 * path.impact_time[hit]) + 0.3)
    assert np.allclose(path.position[hit], at, rtol=0, atol=1e-14)
