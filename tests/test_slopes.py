"""Derivatives of the map in special cases, and its monodromy matrix."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

import jaxvibro as jv


@pytest.fixture(scope="module")
def scene():
    return jv.make_scene(2.0, 2.1, 0.05, 0.7, (-1.0, 1.0))


def difference(function, at, step=1e-6):
    return (function(at + step) - function(at - step)) / (2 * step)


def test_third_derivatives(scene):
    def end(z):
        last = jv.strobe(scene, jv.State(z[0], z[1]))[0]
        return jnp.stack([last.x, last.v])

    z, along, second = jnp.array([0.9, -1.1]), jnp.array([0.6, 0.8]), jax.jit(jax.hessian(end))
    assert np.allclose(second(z), np.swapaxes(second(z), 1, 2), rtol=0, atol=1e-12)
    third = jax.jacfwd(second)(z) @ along
    assert np.allclose(third, difference(lambda s: second(z + s * along), 0.0, 1e-5), rtol=0, atol=1e-7)


@pytest.mark.parametrize("wall", [jv.Wall(1.0), jv.Wall(1.0, stiffness=50.0, damping=0.3)], ids=["rigid", "soft"])
def test_second_derivatives_of_a_batch(wall):
    scene, x = jv.make_scene(2.0, 2.1, 0.05, 0.7, (None, wall)), jnp.array([0.9, 0.5, -0.3])

    def end(step):
        return jv.strobe(scene, jv.State(x + step, 1.1))[0].x

    first = jax.jit(jax.jacfwd(end))
    assert np.allclose(jax.jacfwd(first)(0.0), difference(first, 0.0, 1e-5), rtol=1e-6, atol=1e-6)


def test_times_and_speeds_of_impacts_have_derivatives(scene):
    def recorded(v):
        impacts = jv.strobe(scene, jv.State(0.9, v), slots=4)[1]
        return jnp.where(impacts.side != 0, impacts.time, 0.0), impacts.speed, impacts.least_speed

    expected = [difference(lambda v, k=k: recorded(v)[k], -1.1) for k in range(3)]
    for slopes in (jax.jacfwd(recorded)(-1.1), jax.jacrev(recorded)(-1.1)):
        for slope, by_difference in zip(slopes, expected, strict=True):
            assert np.allclose(slope, by_difference, rtol=0, atol=1e-8)


def test_a_release_goes_with_the_drive():
    """At rest on the right wall until A cos(phase) = 1, then free, as without a wall from that phase on."""

    def released(amplitude):
        scene = jv.make_scene(amplitude, 2.0, 0.1, 0.7, (None, 1.0))
        end, _ = jv.strobe(scene, jv.State(1.0, 0.0, -0.3), slots=4)
        return end.x, end.v

    def flown(amplitude):
        scene, phase = jv.make_scene(amplitude, 2.0, 0.1, 0.7, (None, None)), jnp.arccos(1.0 / amplitude)
        end, _ = jv.sample(scene, jv.State(1.0, 0.0, phase), jnp.array([(2.0 * jnp.pi - 0.3 - phase) / 2.0]))
        return end.x[0], end.v[0]

    assert np.allclose(jax.jacfwd(released)(3.0), jax.jacfwd(flown)(3.0), rtol=0, atol=1e-12)


def test_contact_and_clearance_are_constants_and_without_an_end_there_is_no_derivative(scene):
    def end(contact):
        return jv.strobe(scene, jv.State(-1.0, 1.0, 0.0, contact))[0].x

    def clearance(v):
        return jv.strobe(scene, jv.State(0.5, v), clearance=True)[1].least_clearance

    assert jax.grad(end)(-1.0) == 0 and jax.grad(jax.grad(end))(-1.0) == 0
    assert clearance(0.3) > 0 and jax.grad(clearance)(0.3) == 0

    def ends(x):
        last, impacts = jv.strobe(scene, jv.State(x, -1.1), slots=32)
        return last.x, impacts.status

    slope, status = jax.vmap(jax.jacfwd(ends, has_aux=True))(jnp.array([0.9, 2.0]))
    assert np.array_equal(status, [0, 3]) and np.array_equal(np.isnan(slope), [False, True])


def test_a_loop_that_starts_from_a_constant_of_the_strobe_s(scene):
    # XLA's emitter aborts the process where a kernel and a loop share a constant
    def ends(x):
        impacts = jv.strobe(scene, jv.State(x, -1.1))[1]
        return lax.scan(lambda total, side: (total + side, None), jnp.zeros(()), impacts.side)[0]

    assert jax.jit(ends)(0.9) == -1.0  # one impact, on the left wall


def test_matrices_of_two_periods_of_free_motion_and_after_sticking(scene):
    state, free = jv.State(0.9, -1.1), jv.make_scene(1.0, 2.0, 0.0, 1.0, (None, None))
    both = jv.monodromy(scene, jv.strobe(scene, state)[0]) @ jv.monodromy(scene, state)
    assert np.allclose(jv.monodromy(scene, state, periods=2), both, rtol=0, atol=1e-12)
    assert np.allclose(jv.monodromy(free, state), -np.eye(2), rtol=0, atol=1e-14)
    inelastic = jv.make_scene(3.0, 2.0, 0.1, 0.0, (None, 1.0))
    assert np.array_equal(jv.monodromy(inelastic, jv.State(0.0, 1.0, -1.5)), np.zeros((2, 2)))
    chatter = jv.make_scene(0.3, 0.5, 0.1, 0.6, (None, -1.0))
    assert np.array_equal(jv.monodromy(chatter, jv.State(-1.2, 0.3)), np.zeros((2, 2)))


def test_a_matrix_is_nan_without_an_end_or_slots_and_has_no_derivative(scene):
    matrices = jv.monodromy(scene, jv.State(jnp.array([0.9, 2.0]), -1.1))
    assert np.array_equal(np.isfinite(matrices).all((1, 2)), [True, False])
    state = jv.State(0.0, 3.0)  # two impacts
    assert np.all(np.isnan(jv.monodromy(scene, state, slots=1)))
    assert np.allclose(jv.monodromy(scene, state, slots=2), jv.monodromy(scene, state), rtol=0, atol=1e-15)
    with pytest.raises(TypeError, match=r"differentiate jax\.jacfwd of strobe"):
        jax.jacfwd(lambda x: jv.monodromy(scene, jv.State(x, 0.0)))(0.5)
