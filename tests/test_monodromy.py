"""The product of P and Q against ball arithmetic, against forward derivatives of the strobe, and where it is known."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxvibro as jv
from tests.lanes import one_by_one
from tests.proof import monodromy_errors, product

PERIOD = 2 * np.pi / 2.1


@pytest.fixture(scope="module")
def scene():
    return jv.make_scene(2.0, 2.1, 0.05, 0.7, (-1.0, 1.0))


def test_random_scenes_against_ball_arithmetic():
    errors = monodromy_errors(40, 7_000, {(0, 0), (1, 2)}, partial(one_by_one, product))
    assert np.all(errors < 1e-12)


def test_it_is_the_derivative_of_the_strobe(scene):
    state = jv.State(0.9, -1.1)
    slopes = jax.jacfwd(lambda x, v: tuple((end := jv.strobe(scene, jv.State(x, v))[0], (end.x, end.v))[1]), (0, 1))
    assert np.allclose(jv.monodromy(scene, state), np.array(slopes(state.x, state.v)), rtol=0, atol=1e-12)


def test_its_determinant_is_what_impacts_and_damping_leave(scene):
    rng = np.random.default_rng(2)
    many = scene.replace(amplitude=rng.uniform(0, 5, 50))
    state = jv.State(rng.uniform(-1, 1, 50), rng.uniform(-2, 2, 50))
    impacts = jv.strobe(many, state)[1]
    ends = np.asarray(impacts.least_speed) > 1e-2
    found = np.linalg.det(jv.monodromy(many, state))[ends]
    assert np.allclose(found, (0.49**impacts.count * np.exp(-0.1 * PERIOD))[ends], rtol=1e-9)


def test_two_periods_are_a_product(scene):
    state = jv.State(0.9, -1.1)
    later = jv.strobe(scene, state)[0]
    both = jv.monodromy(scene, later) @ jv.monodromy(scene, state)
    assert np.allclose(jv.monodromy(scene, state, periods=2), both, rtol=0, atol=1e-12)


def test_a_free_oscillator_is_damped_alone():
    free = jv.monodromy(jv.make_scene(1.0, 2.0, 0.0, 1.0, (None, None)), jv.State(0.3, 0.1))
    assert np.allclose(free, [[-1.0, 0.0], [0.0, -1.0]], rtol=0, atol=1e-14)


def test_a_mass_that_has_rested_forgets_its_start():
    plastic = jv.make_scene(3.0, 2.0, 0.1, 0.0, (None, 1.0))
    assert np.array_equal(jv.monodromy(plastic, jv.State(0.0, 1.0, -1.5)), np.zeros((2, 2)))
    chatter = jv.make_scene(0.3, 0.5, 0.1, 0.6, (None, -1.0))
    assert np.array_equal(jv.monodromy(chatter, jv.State(-1.2, 0.3)), np.zeros((2, 2)))


def test_no_end_no_derivative(scene):
    found = jv.monodromy(scene, jv.State(jnp.array([0.9, 2.0]), -1.1))
    assert np.all(np.isfinite(found[0]))
    assert np.all(np.isnan(found[1]))


def test_slots_that_do_not_hold_all_impacts_give_nan(scene):
    state = jv.State(0.0, 3.0)  # two impacts
    assert np.all(np.isnan(jv.monodromy(scene, state, slots=1)))
    assert np.allclose(jv.monodromy(scene, state, slots=2), jv.monodromy(scene, state), rtol=0, atol=1e-15)


def test_it_is_not_to_be_differentiated(scene):
    with pytest.raises(TypeError, match=r"differentiate jax\.jacfwd of strobe"):
        jax.jacfwd(lambda x: jv.monodromy(scene, jv.State(x, 0.0)))(0.5)


def test_periods_are_refused_by_name(scene):
    with pytest.raises(jv.ArgumentError, match=r"^periods: must be a whole number"):
        jv.monodromy(scene, jv.State(0.0, 0.0), periods=0)
