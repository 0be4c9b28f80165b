"""Free flight against ball arithmetic."""

import jax
import numpy as np
import pytest

import jaxvibro as jv
from jaxvibro.flight.flow import fly
from tests.proof import flow_errors
from tests.reference import ball


def test_flow_keeps_its_bound():
    assert flow_errors(400, seed=3).max() < 1


def test_flow_at_resonance_without_damping():
    # x'' + x = A cos t from rest: x = A t sin(t) / 2
    scene = jv.make_scene(2.0, 1.0, 0.0, 1.0, (None, None))
    x, v = fly(scene, jv.State(0.0, 0.0), 7.0)
    assert abs(x - 7.0 * np.sin(7.0)) < 1e-14
    assert abs(v - np.sin(7.0) - 7.0 * np.cos(7.0)) < 1e-14


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
