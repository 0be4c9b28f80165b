"""Many orbits at once: against `find_orbit`, `monodromy`, and differences of orbits found anew."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxvibro as jv

OK, _, VIRTUAL, NONE = jv.SolutionStatus


@pytest.fixture(scope="module")
def orbit():
    """Between unlike walls, one of which moves; the section is at a phase of its own."""
    right = jv.Wall(0.8, 0.6, motion=jv.Motion(0.1, 0.4, 2))
    scene = jv.make_scene(3.5, 1.9, 0.1, 0.75, (-1.2, right))
    return jv.find_orbit(scene, jv.State(0.3, -1.1, 0.7))


def test_they_are_the_orbits_that_are_found_alone(orbit):
    amplitudes = np.linspace(3.2, 3.52, 5)
    scenes = orbit.scene.replace(amplitude=amplitudes)
    found = jv.solve_orbits(scenes, orbit.state, orbit.itinerary)
    assert (found.status == OK).all() and found.times.shape == (5, orbit.impacts.count)
    for k, amplitude in enumerate(amplitudes):
        one = jv.find_orbit(orbit.scene.replace(amplitude=amplitude), orbit.state, orbit.periods, settle=0)
        assert abs(found.state.x[k] - one.state.x) + abs(found.state.v[k] - one.state.v) < 1e-12
        assert np.asarray(found.times[k]) == pytest.approx(one.impacts.time, abs=1e-12)
        assert np.asarray(found.multipliers[k]) == pytest.approx(one.multipliers, abs=1e-12)
    matrix = jv.monodromy(scenes, found.state, orbit.periods)
    assert np.asarray(found.multipliers).prod(-1).real == pytest.approx(np.linalg.det(matrix), abs=1e-13)


def test_derivatives_are_those_of_the_root(orbit):
    def size(scene):
        found = jv.solve_orbits(scene, orbit.state, orbit.itinerary)
        return abs(found.multipliers[0]) + found.state.x * found.speeds[0]

    gradient = jax.jit(jax.grad(size))(orbit.scene)
    for name in ("frequency", "damping", "right.position", "right.motion.phase", "right.restitution"):
        at = float(orbit.scene.parameter(name))
        ends = [size(orbit.scene.replace(**{name: at + step})) for step in (1e-4, -1e-4, 2e-4, -2e-4)]
        slope = (8.0 * (ends[0] - ends[1]) - (ends[2] - ends[3])) / 12e-4
        assert float(gradient.parameter(name)) == pytest.approx(float(slope), abs=3e-10), name


def test_without_impacts_it_is_the_linear_response():
    scene = jv.make_scene(np.linspace(1.0, 5.0, 9), 2.1, 0.05, 0.7, (-1.0, 1.0))
    found = jv.solve_orbits(scene, jv.State(0.0, 0.0), ("",))
    response = np.asarray(scene.amplitude) / (1.0 - 2.1**2 + 2j * 0.05 * 2.1)
    assert np.asarray(found.state.x) == pytest.approx(np.real(response), abs=1e-13)
    assert (np.asarray(found.status) == np.where(abs(response) < 1.0, OK, VIRTUAL)).all()
    slope = jax.grad(lambda a: jv.solve_orbits(scene.replace(amplitude=a), jv.State(0.0, 0.0), ("",)).state.x.sum())
    assert np.asarray(slope(scene.amplitude)) == pytest.approx(np.full(9, response.real[0]))


def test_statuses(orbit):
    scene, times, speeds = orbit.scene, orbit.impacts.time, orbit.impacts.speed
    behind = jv.solve_orbits(scene.replace(**{"right.position": np.array([0.8, 3.0])}), orbit.state, orbit.itinerary)
    assert behind.status[0] == OK and behind.status[1] == NONE
    assert np.isnan(behind.state.x[1]) and np.isnan(behind.multipliers[1]).all()
    other = jv.solve_orbits(scene, jv.State(0.0, 0.0), ("",))
    assert other.status == VIRTUAL and np.isfinite(other.state.x)
    vmapped = jax.vmap(lambda a: jv.solve_orbits(scene.replace(amplitude=a), orbit.state, orbit.itinerary).status)
    assert list(vmapped(jnp.array([3.4, 3.5]))) == [OK, OK]
    assert jv.solve_orbits(scene, (times + orbit.state.phase / 1.9, speeds), orbit.itinerary).status == OK


def test_impacts_may_be_counted_from_any_of_them():
    scene, start = jv.make_scene(2.0, 2.1, 0.05, 0.7, (-1.0, 1.0)), jv.State(0.9, -1.1)
    state = jv.find_orbit(scene, start).state
    one, other = (jv.solve_orbits(scene, state, (word,)) for word in ("LR", "RL"))
    assert one.status == other.status == OK and abs(one.state.x - other.state.x) < 1e-13
    assert np.sort(one.times % (2 * np.pi / 2.1)) == pytest.approx(np.sort(other.times % (2 * np.pi / 2.1)), abs=1e-12)
    assert abs(one.times[0] - other.times[1]) > 1e-3 or abs(one.times[1] - other.times[0]) > 1e-3
    assert jv.solve_orbits(scene, state, ("LL",)).status == NONE


@pytest.mark.parametrize(
    "given, told",
    [
        (((np.zeros(3), np.zeros(3)), ("RL",)), r"guesses.times: must have an entry for each of the .*2 impacts"),
        ((0.5, ("RL",)), "guesses: must be a State"),
        ((jv.State(0.0, 0.0), "RL"), "itinerary: must be a list of strings"),
        ((jv.State(0.0, 0.0), ("RL",), 2), "periods: must be the number of words, 1"),
        ((jv.State(np.zeros(3), np.zeros(2)), ("RL",)), "state.v"),
    ],
)
def test_bad_arguments(given, told):
    scene = jv.make_scene(2.0, 2.1, 0.05, 0.7, (-1.0, 1.0))
    with pytest.raises(jv.ArgumentError, match=told):
        jv.solve_orbits(scene, *given)
