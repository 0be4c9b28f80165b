"""The first step within a stiff wall: what it does, and that the mass is still within at its end, by closed forms."""

import cmath
import math

import jax.numpy as jnp
import numpy as np
import pytest

import jaxvibro as jv
from jaxvibro.flight.flight_coefficients import make_flow_coefficients
from jaxvibro.flight.soft_wall_first_step import SAFETY_MARGIN, STEP_SHARE, is_first_step_certified

OMEGA = 2.1
WALLS = [(10.0, 0.0), (1e2, 0.1), (1e4, 11.3), (1e7, 2000.0), (1e10, 0.1)]


def plunge_of(stiffness, damping, motion=None):
    """The step into the right wall of a scene."""
    wall = jv.Wall(0.8, stiffness=stiffness, damping=damping, motion=motion)
    scene = jv.make_scene(amplitude=1.5, frequency=OMEGA, damping=0.05, restitution=0.7, walls=(None, wall))
    return make_flow_coefficients(scene).soft_flows[0].first_step


def free(stiffness, damping, time):
    """(y, y') after a start at y = 0 with a speed of 1."""
    turn = math.sqrt(1.0 + stiffness - damping * damping)
    decay, sine, cosine = np.exp(-damping * time), np.sin(turn * time), np.cos(turn * time)
    return decay * sine / turn, decay * (cosine - damping * sine / turn)


def under(stiffness, damping, time, push):
    """y after a start from rest under a constant push."""
    y, v = free(stiffness, damping, time)
    return push * (1.0 - v - 2.0 * damping * y) / (1.0 + stiffness)


def driven(stiffness, damping, time, rate):
    """(y, y') after a start from rest under the force exp(i rate t)."""
    answer = 1.0 / (1.0 + stiffness - rate * rate + 2j * damping * rate)
    y, v = free(stiffness, damping, time)
    wave = answer * cmath.exp(1j * rate * time)
    speed = 1j * rate * answer
    back = answer * (v + 2.0 * damping * y) + speed * y
    back_speed = -answer * (1.0 + stiffness) * y + speed * v
    return wave - back, 1j * rate * wave - back_speed


@pytest.mark.parametrize(("stiffness", "damping"), WALLS)
def test_the_step_is_the_flow_over_most_of_a_half_swing(stiffness, damping):
    step = plunge_of(stiffness, damping, jv.Motion(0.1, 0.3, harmonic=1))
    root = math.sqrt(1.0 + stiffness)
    time = STEP_SHARE * math.pi / math.sqrt(1.0 + stiffness - damping * damping)
    assert float(step.time) == pytest.approx(time, rel=1e-14)
    y, v = free(stiffness, damping, time)
    given = np.array(step.free_flow) * [1.0, root, 1.0]
    np.testing.assert_allclose(given, [v + 2.0 * damping * y, root * y, v], rtol=0, atol=1e-14)
    y, v = driven(stiffness, damping, time, OMEGA)
    for forced in (step.forced_flow, step.wall_motion_response):
        (in_phase, speed), (quadrature, quadrature_speed) = forced
        assert abs(in_phase + 1j * quadrature - y) < 1e-14 * abs(y)
        assert abs(speed + 1j * quadrature_speed - v) < 1e-14 / root
    versed, sined = -2.0 * math.sin(0.5 * OMEGA * time) ** 2, math.sin(OMEGA * time)
    np.testing.assert_allclose(step.drive_rotation, [versed, sined], rtol=1e-14)


@pytest.mark.parametrize(("stiffness", "damping"), WALLS)
def test_an_entry_that_is_just_fast_enough_just_stays_within(stiffness, damping):
    step = plunge_of(stiffness, damping)._replace(force_change_bound=jnp.zeros(()))
    time, push = np.linspace(0.0, 1.0, 401)[1:] * float(step.time), -0.7
    slowest = -float(step.speed_per_force) * push
    assert bool(is_first_step_certified(step, 1.0001 * slowest, push))
    assert not bool(is_first_step_certified(step, 0.9999 * slowest, push))
    y = slowest * free(stiffness, damping, time)[0] + under(stiffness, damping, time, push)
    assert np.all(y > 0)
    least = slowest / SAFETY_MARGIN * free(stiffness, damping, time)[0] + under(stiffness, damping, time, push)
    assert abs(least[-1]) < 1e-12 * least.max()


def test_a_push_may_change_within_the_step():
    step = plunge_of(1e4, 11.3)
    assert float(step.force_change_bound) == pytest.approx(1.5 * OMEGA * float(step.time), rel=1e-14)
    change = float(step.force_change_bound)
    assert bool(is_first_step_certified(step, 1e-12, 1.0001 * change))
    slowest = float(step.speed_per_force) * change
    assert bool(is_first_step_certified(step, 1.0001 * slowest, 0.0))
    assert not bool(is_first_step_certified(step, 0.9999 * slowest, 0.0))


@pytest.mark.parametrize(("stiffness", "damping"), [(3.0, 0.1), (1e4, 80.0), (1e4, 500.0)])
def test_no_step_where_the_drive_is_fast_or_the_damping_strong(stiffness, damping):
    step = plunge_of(stiffness, damping)
    assert np.isinf(float(step.speed_per_force)) and not bool(is_first_step_certified(step, 1e6, 1e6))
