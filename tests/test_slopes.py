"""Derivatives of the map in special cases, and its monodromy matrix."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

import jaxvibro as jv
from jaxvibro.flight.flow import fly


@pytest.fixture(scope="module")
def scene():
    return jv.make_scene(2.0, 2.1, 0.05, 0.7, (-1.0, 1.0))


def end_of(scene):
    return lambda z: jnp.stack([(end := jv.strobe(scene, jv.State(z[0], z[1]))[0]).x, end.v])


def difference(function, at, step=1e-6):
    return (function(at + step) - function(at - step)) / (2 * step)


def test_forward_and_reverse_agree_with_the_product(scene):
    z = jnp.array([0.9, -1.1])
    product = jv.monodromy(scene, jv.State(*z))
    assert np.allclose(jax.jacfwd(end_of(scene))(z), product, rtol=0, atol=1e-13)
    assert np.allclose(jax.jacrev(end_of(scene))(z), product, rtol=0, atol=1e-13)


def test_second_and_third_derivatives(scene):
    z, along = jnp.array([0.9, -1.1]), jnp.array([0.6, 0.8])
    second = jax.hessian(end_of(scene))(z)
    assert np.allclose(second, np.swapaxes(second, 1, 2), rtol=0, atol=1e-12)
    first = jax.jit(jax.jacfwd(end_of(scene)))
    assert np.allclose(second @ along, difference(lambda s: first(z + s * along), 0.0, 1e-5), rtol=0, atol=1e-8)
    third = jax.jacfwd(jax.hessian(end_of(scene)))(z)
    curved = jax.jit(jax.hessian(end_of(scene)))
    assert np.allclose(third @ along, difference(lambda s: curved(z + s * along), 0.0, 1e-5), rtol=0, atol=1e-7)


def test_times_and_speeds_of_impacts_have_derivatives(scene):
    def told(v):
        impacts = jv.strobe(scene, jv.State(0.9, v), slots=4)[1]
        return jnp.where(impacts.side != 0, impacts.time, 0.0), impacts.speed, impacts.least_speed

    expected = [difference(lambda v, k=k: told(v)[k], -1.1) for k in range(3)]
    for slopes in (jax.jacfwd(told)(-1.1), jax.jacrev(told)(-1.1)):
        for slope, by_difference in zip(slopes, expected, strict=True):
            assert np.all(np.isfinite(slope))
            assert np.allclose(slope, by_difference, rtol=0, atol=1e-8)


def test_a_release_goes_with_the_drive():
    """At rest on the right wall until A cos(phase) = 1, then free: as `fly` from that phase on."""

    def released(amplitude):
        scene = jv.make_scene(amplitude, 2.0, 0.1, 0.7, (None, 1.0))
        end, _ = jv.strobe(scene, jv.State(1.0, 0.0, -0.3), slots=4)
        return end.x, end.v

    def flown(amplitude):
        scene, phase = jv.make_scene(amplitude, 2.0, 0.1, 0.7, (None, 1.0)), jnp.arccos(1.0 / amplitude)
        return fly(scene, jv.State(1.0, 0.0, phase), (2.0 * jnp.pi - 0.3 - phase) / 2.0)

    assert np.allclose(jax.jacfwd(released)(3.0), jax.jacfwd(flown)(3.0), rtol=0, atol=1e-12)


def test_no_end_no_derivative_and_a_status(scene):
    def ends(x):
        end, impacts = jv.strobe(scene, jv.State(x, -1.1), slots=32)
        return end.x, impacts.status

    slope, status = jax.vmap(jax.jacfwd(ends, has_aux=True))(jnp.array([0.9, 2.0]))
    assert np.array_equal(status, [0, 3])
    assert np.isfinite(slope[0]) and np.isnan(slope[1])


def test_a_loop_that_starts_from_a_constant_of_the_strobe_s(scene):
    # XLA's emitter aborts the process where a kernel and a loop share a constant
    def ends(x):
        impacts = jv.strobe(scene, jv.State(x, -1.1))[1]
        return lax.scan(lambda total, side: (total + side, None), jnp.zeros(()), impacts.side)[0]

    assert jax.jit(ends)(0.9) == -1.0  # one impact, on the left wall


def test_the_contact_is_a_constant(scene):
    def end(contact):
        return jv.strobe(scene, jv.State(-1.0, 1.0, 0.0, contact))[0].x

    assert jax.grad(end)(-1.0) == 0
    assert jax.grad(jax.grad(end))(-1.0) == 0


def test_two_periods_have_the_product_of_their_matrices(scene):
    state = jv.State(0.9, -1.1)
    later = jv.strobe(scene, state)[0]
    both = jv.monodromy(scene, later) @ jv.monodromy(scene, state)
    assert np.allclose(jv.monodromy(scene, state, periods=2), both, rtol=0, atol=1e-12)


def test_the_matrix_of_a_free_oscillator():
    free = jv.monodromy(jv.make_scene(1.0, 2.0, 0.0, 1.0, (None, None)), jv.State(0.3, 0.1))
    assert np.allclose(free, [[-1.0, 0.0], [0.0, -1.0]], rtol=0, atol=1e-14)


def test_the_matrix_is_zero_after_sticking_and_nan_without_an_end_or_slots(scene):
    inelastic = jv.make_scene(3.0, 2.0, 0.1, 0.0, (None, 1.0))
    assert np.array_equal(jv.monodromy(inelastic, jv.State(0.0, 1.0, -1.5)), np.zeros((2, 2)))
    chatter = jv.make_scene(0.3, 0.5, 0.1, 0.6, (None, -1.0))
    assert np.array_equal(jv.monodromy(chatter, jv.State(-1.2, 0.3)), np.zeros((2, 2)))
    matrices = jv.monodromy(scene, jv.State(jnp.array([0.9, 2.0]), -1.1))
    assert np.array_equal(np.isfinite(matrices).all((1, 2)), [True, False])
    state = jv.State(0.0, 3.0)  # two impacts
    assert np.all(np.isnan(jv.monodromy(scene, state, slots=1)))
    assert np.allclose(jv.monodromy(scene, state, slots=2), jv.monodromy(scene, state), rtol=0, atol=1e-15)


def test_the_matrix_cannot_be_differentiated_and_refuses_invalid_arguments(scene):
    with pytest.raises(TypeError, match=r"differentiate jax\.jacfwd of strobe"):
        jax.jacfwd(lambda x: jv.monodromy(scene, jv.State(x, 0.0)))(0.5)
    with pytest.raises(jv.ArgumentError, match=r"^periods: must be a whole number"):
        jv.monodromy(scene, jv.State(0.0, 0.0), periods=0)
    with pytest.raises(jv.ArgumentError, match=r"^state: must be a State; got 0\.5$"):
        jv.monodromy(scene, 0.5)
