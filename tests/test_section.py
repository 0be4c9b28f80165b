"""The maps from impact to impact on a wall, held against orbits and their multipliers."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxvibro as jv


@pytest.fixture(scope="module")
def scene():
    return jv.make_scene(4.65, 2.1, 0.05, 0.7, (-1.0, 1.0))


@pytest.mark.parametrize("side", ["left", "right"])
def test_an_orbit_comes_back_and_its_multipliers_are_those_of_the_map(scene, side):
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


def test_no_return_is_told(scene):
    done = jv.return_map(scene.replace(amplitude=0.0), "left", np.array([0.0, 1.0]), 0.2)
    assert not np.any(done.found) and np.all(np.isnan(done.time))


def test_a_wall_that_is_not_there_is_refused():
    with pytest.raises(jv.ArgumentError, match=r"^side: must be a wall of the scene"):
        jv.return_map(jv.make_scene(1.0, 2.0, 0.1, 0.5, (None, 1.0)), "left", 0.0, 1.0)
