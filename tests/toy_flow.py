"""A flow of one file: a mass under a constant force and the drive, x'' = g + A cos(theta), without spring and damper.

The scene has a `ConstantForce` of a number. `test_kinds` registers the flow for this class of forces.
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp

import jaxvibro as jv
from jaxvibro.flight import flow
from jaxvibro.flight.event_certificates import N_TERMS, taylor_weights
from jaxvibro.flight.flight_coefficients import FlowCoefficients, common_fields
from jaxvibro.flight.flight_state import SlowMotion, add_to_slow_motion, state_of_slow_motion
from jaxvibro.flight.flow_defaults import (  # noqa: F401
    acceleration_and_jerk,
    flight_map,
    fly_with_matrix,
    jet_at_point,
    matrix_state,
    propagate_with_matrix,
    state_before_delay,
)
from jaxvibro.flight.force_flow import has_unique_free_response, steady_amplitude  # noqa: F401
from jaxvibro.flight.further_drive_terms import harmonic_derivatives
from jaxvibro.flight.linear_flow import areas_may_grow, prepare_lookahead  # noqa: F401
from jaxvibro.flight.wall_motion import subtract_optional, wall_derivative_bounds, wall_jet


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class ConstantForce(jv.Force):
    """A constant force: of a `Force`, the function is evaluated at 0 alone."""


def _gravity(coeffs):
    return coeffs.user_force.function(0.0, 0.0, 0.0, coeffs.user_force.numbers)


def make_coefficients(scene, kinds):
    fields = common_fields(scene, kinds)
    frequency, walls = fields["frequency"], fields["walls"]
    zero, max_step = 0.0 * frequency, flow.MAX_SCALED_STEP / frequency
    bounds = [
        wall_derivative_bounds(wall, zero, frequency, zero, order)[1]
        for wall in walls
        for order in (N_TERMS, N_TERMS + 2)
    ]
    return FlowCoefficients(
        **fields,
        damping=zero,
        in_phase_amplitude=zero,
        max_step=max_step,
        inverse_max_step=1.0 / max_step,
        taylor_weights=taylor_weights(max_step),
        wall_remainder_bounds=tuple(bounds[::2]),
        force_remainder_bounds=tuple(abs(fields["amplitude"]) * frequency**N_TERMS + bound for bound in bounds[1::2]),
        user_force=jax.tree.map(lambda number: jnp.asarray(number, scene.dtype), scene.force),
    )


def rates(scene):
    return [float(scene.frequency)]


def loses_energy(scene):
    return False


def require_reversible(scene):
    pass


def reverse_time(coeffs):
    return coeffs


def forces_and_remainder(lookahead):
    pass


def motion_derivatives(coeffs, path, lookahead, frame_force):
    return jet(coeffs, path.x, path.v, path.cosine, path.sine, N_TERMS)


def contact_forces_ahead(coeffs, path, forces_and_remainder):
    forces = [contact_force(coeffs, wall, path.cosine, path.sine, N_TERMS - 1) for wall in coeffs.walls]
    return list(zip(forces, coeffs.force_remainder_bounds, strict=True))


def remainder_bound(
    coeffs,
    derivatives,
    forces_and_remainder,
    is_sticking,
    contact_remainder_bound,
    wall_remainder_bound,
    taylor_weights,
):
    bound = abs(coeffs.amplitude) * coeffs.frequency ** (N_TERMS - 2)
    return (jnp.where(is_sticking, contact_remainder_bound, bound) + wall_remainder_bound) * taylor_weights[N_TERMS]


def advance_motion(coeffs, motion, time, lookahead):
    return propagate_motion(coeffs, motion, time)


def propagate_motion(coeffs, motion, time):
    _, _, v = state_of_slow_motion(coeffs, motion)
    dx, dv, *phasor = fly(coeffs, 0.0, v, motion.cosine, motion.sine, time)
    return SlowMotion(*add_to_slow_motion(motion, dx, dv - v), *phasor)


def jet(coeffs, x, v, cosine, sine, order, frame_force=()):
    forces = harmonic_derivatives(coeffs.amplitude * cosine, coeffs.amplitude * sine, coeffs.frequency, order)
    return [x, v, _gravity(coeffs) + forces[0], *forces[1:]][: order + 1]


def contact_force(coeffs, wall, cosine, sine, order):
    wall_accelerations = wall_jet(wall, coeffs.frequency, cosine, sine, order + 2)[2:]
    forces = jet(coeffs, 0.0 * cosine, 0.0 * cosine, cosine, sine, order + 2)[2:]
    return [subtract_optional(*pair) for pair in zip(forces, wall_accelerations, strict=True)]


def chatter_bounds(coeffs, side, acceleration, approach_speed, cosine, sine):
    return abs(coeffs.amplitude) * coeffs.frequency + 0.0 * cosine, 0.0 * cosine, 1.0


def sampling_time_scale(coeffs, flights):
    return coeffs.max_step


def fly(coeffs, x, v, cosine, sine, time):
    end, gain = flow.rotate_phasor_by_angle(cosine, sine, coeffs.frequency * time), coeffs.amplitude / coeffs.frequency
    gravity = _gravity(coeffs)
    return (
        x + time * (v - gain * sine + 0.5 * gravity * time) + gain / coeffs.frequency * (cosine - end[0]),
        v + gravity * time + gain * (end[1] - sine),
        *end,
    )
