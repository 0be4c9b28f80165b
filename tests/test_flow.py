"""Free flight against ball arithmetic."""

import jax
import numpy as np
import pytest

import jaxvibro as jv
from jaxvibro.contact.kinds import make_flow_coefficients
from jaxvibro.flight.fast_coefficients import make_fast_coefficients
from jaxvibro.flight.fast_motion import drive_forces, propagate_free_flight
from jaxvibro.flight.flow import fly, step_propagator
from tests.reference import ball


def test_flow_keeps_its_bound():
    """Errors are below 1e-13 (1 + t)^2 (abs x + abs v + A), at resonance and critical damping too."""
    count, rng = 400, np.random.default_rng(3)

    def near_one(number):
        return 1.0 + rng.choice([-1, 0, 1], number) * 10.0 ** -rng.integers(1, 16, number)

    gamma, omega = rng.uniform(0, 5, count), np.exp(rng.uniform(np.log(0.05), np.log(20), count))
    gamma[::7], gamma[1::7], omega[::5] = 0.0, near_one(len(gamma[1::7])), near_one(len(omega[::5]))
    amplitude, time, phase = rng.uniform(0, 10, count), rng.uniform(0, 10, count), rng.uniform(0, 2 * np.pi, count)
    x, v = rng.normal(0, 2, (2, count))
    scene = jv.make_scene(amplitude, omega, gamma, 1.0, (None, None))
    ends = map(np.asarray, fly(scene, jv.State(x, v, phase), time))
    rows = zip(gamma, omega, amplitude, phase, x, v, time, strict=True)
    true = np.array([[float(each) for each in ball.flow(*map(float, row))] for row in rows]).T
    bound = 1e-13 * (1 + time) ** 2 * (abs(x) + abs(v) + amplitude)
    for end, exact in zip(ends, true, strict=True):
        assert np.all(abs(end - exact) < bound)


@pytest.mark.parametrize("damping", [0.0, 1.0])
def test_flow_has_derivatives_where_textbook_forms_have_none(damping):
    def end(damping, frequency):
        return fly(jv.make_scene(1.5, frequency, damping, 1.0, (None, None)), jv.State(0.3, -0.2), 2.0)[0]

    slopes = jax.jacfwd(end, argnums=(0, 1))(damping, 1.0)
    step = 1e-5
    at = [float(ball.flow(damping + k * step, 1.0, 1.5, 0.0, 0.3, -0.2, 2.0)[0]) for k in (0, 1, 2)]
    by_damping = (-3 * at[0] + 4 * at[1] - at[2]) / (2 * step)
    low, high = (float(ball.flow(damping, 1.0 + k * step, 1.5, 0.0, 0.3, -0.2, 2.0)[0]) for k in (-1, 1))
    assert np.allclose(slopes, (by_damping, (high - low) / (2 * step)), rtol=0, atol=1e-8)


def test_roundings_of_the_fast_path_are_within_their_bound():
    count, rng = 300, np.random.default_rng(4)
    damping, omega = rng.choice([0.0, 0.05, 0.5, 1.0, 5.0], count), rng.choice([0.05, 0.5, 1.0, 2.1, 20.0], count)
    amplitude, phase, (x, v) = rng.uniform(0, 10, count), rng.uniform(0, 6.3, count), rng.normal(0, 2, (2, count))
    numbers = make_fast_coefficients(make_flow_coefficients(jv.make_scene(amplitude, omega, damping, 1.0, (-1.0, 1.0))))
    reach, part = np.asarray(numbers.max_step), rng.choice([0.01, 0.3, 0.7, 1.0], count)
    gains = step_propagator(numbers.economised_series, numbers.frequency, part)
    forces = drive_forces(numbers, np.cos(phase), np.sin(phase))
    ends = map(np.asarray, propagate_free_flight(numbers, x, v * reach, forces, gains))
    rows = zip(damping, omega, amplitude, phase, x, v, reach * part, strict=True)
    true = np.array([[float(each) for each in ball.flow(*map(float, row))] for row in rows]).T * [np.ones(count), reach]
    largest = abs(x) + abs(v) * reach + amplitude
    for end, exact in zip(ends, true, strict=True):
        assert (abs(end - exact) / largest).max() < 8 * 2.0**-53
