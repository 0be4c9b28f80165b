"""Trajectories for pictures: they are the strobe's own orbits, sampled."""

import jax.numpy as jnp
import numpy as np
import pytest

import jaxvibro as jv


@pytest.fixture(scope="module")
def scene():
    wall = jv.Wall(1.0, 0.6, motion=jv.Motion(0.1, 0.3, 2))
    return jv.make_scene(2.0, 2.1, 0.05, 0.7, (-1.2, wall))


def test_trajectory_ends_where_the_strobe_does(scene):
    path = jv.simulate(scene, jv.State(0.5, -1.1, 0.4), periods=3, samples=50)
    end, impacts = jv.strobe(scene, jv.State(0.5, -1.1, 0.4), periods=3, slots=32)
    hits = int(impacts.count)
    assert abs(path.x.values[-1] - float(end.x)) < 1e-12
    assert abs(path.v.values[-1] - float(end.v)) < 1e-12
    assert np.allclose(path.impact_time, impacts.time[:hits], rtol=0, atol=1e-12)
    assert np.array_equal(path.side, impacts.side[:hits])
    assert np.allclose(path.speed, impacts.speed[:hits], rtol=0, atol=1e-12)
    assert hits > 2


def test_samples_are_even_and_between_the_walls(scene):
    path = jv.simulate(scene, jv.State(0.5, -1.1, 0.4), periods=3, samples=50)
    assert np.allclose(np.diff(path.time), 2 * np.pi / 2.1 / 50, rtol=1e-12)
    right = 1.0 + 0.1 * np.cos(2 * path.phase + 0.3)
    assert np.all(path.x >= -1.2 - 1e-12)
    assert np.all(path.x <= right + 1e-12)
    hit = path.side == 1
    at = 1.0 + 0.1 * np.cos(2 * (0.4 + 2.1 * path.impact_time[hit]) + 0.3)
    assert np.allclose(path.position[hit], at, rtol=0, atol=1e-14)


def test_a_batch_and_a_start_beyond_a_wall_are_refused(scene):
    with pytest.raises(jv.ArgumentError, match=r"^state: must be a single state"):
        jv.simulate(scene, jv.State(jnp.zeros(2), 0.0), periods=3, samples=50)
    with pytest.raises(jv.ArgumentError, match=r"^state\.x: must lie between the walls at its phase; got 7\.0"):
        jv.simulate(scene, jv.State(7.0, 0.0, 0.4), periods=3, samples=50)
