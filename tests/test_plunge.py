"""The first step within a stiff wall: what it does, and that the mass is still within at its end, by mpmath."""

import math

import jax.numpy as jnp
import mpmath
import numpy as np
import pytest

import jaxvibro as jv
from jaxvibro.contact.kinds import make_flow_coefficients
from jaxvibro.flight.soft_wall_first_step import SAFETY_MARGIN, STEP_SHARE, is_first_step_certified

OMEGA = 2.1
WALLS = [(10.0, 0.0), (1e2, 0.1), (1e4, 11.3), (1e7, 2000.0), (1e10, 0.1)]


def first_step(stiffness, damping, motion=None):
    """Return the step into the right wall of a scene."""
    wall = jv.Wall(0.8, stiffness=stiffness, damping=damping, motion=motion)
    scene = jv.make_scene(amplitude=1.5, frequency=OMEGA, damping=0.05, restitution=0.7, walls=(None, wall))
    return make_flow_coefficients(scene).soft_flows[0].first_step


def flow(stiffness, damping, time, rate=0.0):
    """Return the matrix by which (y, y', cos, sin of rate t) is multiplied in a time, under a force cos(rate t)."""
    with mpmath.workdps(30):
        rates = [[0, 1, 0, 0], [-1 - stiffness, -2 * damping, 1, 0], [0, 0, 0, -rate], [0, 0, rate, 0]]
        return np.array(mpmath.expm(mpmath.matrix(rates) * mpmath.mpf(time)).tolist(), float)


@pytest.mark.parametrize(("stiffness", "damping"), WALLS)
def test_the_step_is_the_flow_over_most_of_a_half_swing(stiffness, damping):
    step = first_step(stiffness, damping, jv.Motion(0.1, 0.3, harmonic=1))
    root = math.sqrt(1.0 + stiffness)
    time = STEP_SHARE * math.pi / math.sqrt(1.0 + stiffness - damping * damping)
    assert float(step.time) == pytest.approx(time, rel=1e-14)
    matrix = flow(stiffness, damping, float(step.time), OMEGA)
    given, expected = np.array(step.free_flow) * [1.0, root, 1.0], matrix[[0, 0, 1], [0, 1, 1]] * [1.0, root, 1.0]
    np.testing.assert_allclose(given, expected, rtol=0, atol=1e-14)
    true = matrix[:2, 2:].T * [[1.0], [-1.0]]
    sizes = np.hypot(*true)
    for forced in (step.forced_flow, *step.harmonic_flows):
        assert np.all(np.hypot(*(np.array(forced) - true)) < 1e-14 * np.maximum(sizes, [0.0, 1.0 / root]))
    versed, sined = -2.0 * math.sin(0.5 * OMEGA * time) ** 2, math.sin(OMEGA * time)
    np.testing.assert_allclose(step.drive_rotation, [versed, sined], rtol=1e-14)


@pytest.mark.parametrize(("stiffness", "damping"), WALLS)
def test_an_entry_that_is_just_fast_enough_just_stays_within(stiffness, damping):
    step = first_step(stiffness, damping)._replace(force_change_bound=jnp.zeros(()))
    push, times = -0.7, np.linspace(0.0, 1.0, 41)[1:] * float(step.time)
    slowest = -float(step.speed_per_force) * push
    assert bool(is_first_step_certified(step, 1.0001 * slowest, push))
    assert not bool(is_first_step_certified(step, 0.9999 * slowest, push))
    by_speed, by_force = np.array([flow(stiffness, damping, time)[0, [1, 2]] for time in times]).T
    assert np.all(slowest * by_speed + push * by_force > 0)
    least = slowest / SAFETY_MARGIN * by_speed + push * by_force
    assert abs(least[-1]) < 1e-12 * least.max()


def test_a_push_may_change_within_the_step():
    step = first_step(1e4, 11.3)
    assert float(step.force_change_bound) == pytest.approx(1.5 * OMEGA * float(step.time), rel=1e-14)
    change = float(step.force_change_bound)
    assert bool(is_first_step_certified(step, 1e-12, 1.0001 * change))
    slowest = float(step.speed_per_force) * change
    assert bool(is_first_step_certified(step, 1.0001 * slowest, 0.0))
    assert not bool(is_first_step_certified(step, 0.9999 * slowest, 0.0))


@pytest.mark.parametrize(("stiffness", "damping"), [(3.0, 0.1), (1e4, 80.0), (1e4, 500.0)])
def test_no_step_where_the_drive_is_fast_or_the_damping_strong(stiffness, damping):
    step = first_step(stiffness, damping)
    assert np.isinf(float(step.speed_per_force)) and not bool(is_first_step_certified(step, 1e6, 1e6))
