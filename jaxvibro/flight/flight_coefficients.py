"""Compute the coefficients of the flight from a scene, once per scene."""

import math
from enum import Enum
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Float

from ..compiled.lane_arithmetic import choose
from ..scene import check
from ..scene.force import Force
from ..scene.force_operations import ops_without_series
from ..scene.typical_scales import fast_part_amplitude
from . import flow, further_drive_terms
from .event_certificates import N_TERMS, min_squarable_length, taylor_weights
from .jaxpr_series import is_series_of_root
from .motion_in_soft_wall import SoftWallFlow, soft_wall_flow
from .wall_motion import WallCoefficients, max_wall_distance, wall_coefficients, wall_derivative_bounds

WALL_SIGNS = (-1, 1)
TWO_PI_LOW = 2.4492935982947064e-16  # 2 pi less its double-precision value


class ContactLaw(Enum):
    """Kind of the contact phases inside soft walls.

    Attributes
    ----------
    RIGID : ContactLaw
        No contact phases, because all walls are rigid.
    LINEAR : ContactLaw
        Spring and damper of the wall in addition to those of the oscillator.
    FORCE_LAW : ContactLaw
        Contact phases under a user-defined force or wall law.
    """

    RIGID = "none"
    LINEAR = "spring"
    FORCE_LAW = "pushed"


class FlowCoefficients(NamedTuple):
    """Coefficients of the oscillator, its drive and its walls, with bounds for the longest step.

    Each number is a scalar or an array with one value per lane.

    Attributes
    ----------
    amplitude : array
        Drive amplitude A.
    frequency : array
        Drive frequency omega.
    damping : array
        Damping ratio gamma. Zero under a user-defined force.
    walls : tuple of WallCoefficients
        Existing walls, left wall first.
    period : array
        Drive period 2 pi / omega.
    period_low_part : array
        Low part of `period`: the exact period less its rounded value.
    in_phase_amplitude : array
        Amplitude of the in-phase part of the motion, see `flight_state`. Zero under a user-defined force.
    series : FlowSeries or None
        Taylor series of the flow. None under a user-defined force.
    max_step : array
        Longest step, in units of t.
    inverse_max_step : array
        Reciprocal of `max_step`.
    taylor_weights : tuple of array
        Weights max_step^k / k! of the derivatives in a Taylor polynomial.
    length_scale : array
        Length scale of the scene, used to measure rounding: the sum of the largest distances of the walls from the
        origin and of the drive amplitudes, or `event_certificates.min_squarable_length` if this sum is 0.
    jet_bound : array or None
        Constant part of the bound on ``|x^(8)|`` over a step. None under a user-defined force.
    jet_bound_slope : array or None
        Factor of ``|x^(6)| + |x^(7)|`` at the start of a step in the bound on ``|x^(8)|``. None under a user-defined
        force.
    force_remainder_bounds : tuple of array
        Bound on the derivative of order `event_certificates.N_TERMS` of the contact force, for each wall, see
        `wall_motion.wall_derivative_bounds`. Empty under a user-defined force.
    wall_remainder_bounds : tuple of array
        Bound on the derivative of order `event_certificates.N_TERMS` of the position, for each wall, see
        `wall_motion.wall_derivative_bounds`.
    force_rate_bounds : tuple of array
        Bound on the time derivative of the contact force, for each wall. Empty under a user-defined force.
    min_wall_gap : array
        Lower bound on the distance between the walls; infinite if there are fewer than two.
    soft_flows : tuple
        For each wall the `motion_in_soft_wall.SoftWallFlow` inside a soft wall, or the `WallCoefficients` of a soft
        wall under a user-defined force. None for a rigid wall.
    stiffness : array or None
        Stiffness of the oscillator. None stands for 1. Set per lane by `motion_in_soft_wall.lane_coefficients`.
    root_stiffness : array or None
        Square root of `stiffness`. None stands for 1.
    user_force : Force or None
        User-defined force.
    drive_terms : tuple of DriveTerm
        Terms of the drive in addition to A cos(omega t).
    """

    amplitude: Float[jax.Array, "..."]
    frequency: Float[jax.Array, "..."]
    damping: Float[jax.Array, "..."]
    walls: tuple[WallCoefficients, ...]
    period: Float[jax.Array, "..."]
    period_low_part: Float[jax.Array, "..."]
    in_phase_amplitude: Float[jax.Array, "..."]
    series: flow.FlowSeries
    max_step: Float[jax.Array, "..."]
    inverse_max_step: Float[jax.Array, "..."]
    taylor_weights: tuple[Float[jax.Array, "..."], ...]
    length_scale: Float[jax.Array, "..."]
    jet_bound: Float[jax.Array, "..."]
    jet_bound_slope: Float[jax.Array, "..."]
    force_remainder_bounds: tuple[Float[jax.Array, "..."], ...]
    wall_remainder_bounds: tuple[Float[jax.Array, "..."], ...]
    force_rate_bounds: tuple[Float[jax.Array, "..."], ...]
    min_wall_gap: Float[jax.Array, "..."]
    soft_flows: tuple[SoftWallFlow | WallCoefficients | None, ...] = ()
    stiffness: Float[jax.Array, "..."] | None = None
    root_stiffness: Float[jax.Array, "..."] | None = None
    user_force: Force | None = None
    drive_terms: tuple[further_drive_terms.DriveTerm, ...] = ()

    @property
    def contact_law(self) -> ContactLaw:
        """Kind of the contact phases inside soft walls."""
        if all(soft_flow is None for soft_flow in self.soft_flows):
            return ContactLaw.RIGID
        return ContactLaw.LINEAR if self.user_force is None else ContactLaw.FORCE_LAW


def make_flow_coefficients(scene):
    """Compute the coefficients of the flight from a scene.

    Parameters
    ----------
    scene : Scene
        Scene with parameters that are scalars or lanes.

    Returns
    -------
    FlowCoefficients
        Coefficients in the floating-point type of the scene.

    Raises
    ------
    SceneError
        If the law of a soft wall has no Taylor series, or is not a power series in the root of the depth.

    See Also
    --------
    check_validity : Check the rules for a scene inside traced code.
    """
    if scene.force is not None:
        return _user_force_coefficients(scene)
    dtype = scene.dtype
    amplitude, frequency, damping = (
        jnp.asarray(parameter, dtype) for parameter in (scene.amplitude, scene.frequency, scene.damping)
    )
    walls, drive_terms = _wall_coefficients(scene), further_drive_terms.drive_terms(scene, frequency, damping)
    max_angular_rate = flow.max_angular_rate(frequency, damping)
    for wall in walls:
        max_angular_rate = jnp.maximum(
            max_angular_rate, frequency * (wall.harmonic if wall.amplitude is not None else 1.0)
        )
    if drive_terms:
        max_angular_rate = jnp.maximum(
            max_angular_rate, frequency * float(further_drive_terms.highest_harmonic(drive_terms))
        )
    max_step = flow.MAX_SCALED_STEP / max_angular_rate
    # energy of x^(6): abs x^(6), abs x^(7) <= abs x^(6)(0) + abs x^(7)(0) + A omega^6 t; damping lowers it
    force_deriv_bound, jet_bound_slope = (
        further_drive_terms.drive_derivative_bound(drive_terms, amplitude, frequency, 6),
        jnp.sqrt(1.0 + 4.0 * damping * damping),
    )
    period = 2.0 * jnp.pi / frequency
    remainder_bounds_by_wall = [
        wall_derivative_bounds(wall, amplitude, frequency, damping, N_TERMS, drive_terms) for wall in walls
    ]
    return FlowCoefficients(
        amplitude=amplitude,
        frequency=frequency,
        damping=damping,
        walls=walls,
        period=period,
        period_low_part=_two_pi_less_product(frequency, period) / frequency,
        in_phase_amplitude=fast_part_amplitude(frequency, damping, amplitude),
        series=flow.flow_series(frequency, damping),
        max_step=max_step,
        inverse_max_step=max_angular_rate / flow.MAX_SCALED_STEP,
        taylor_weights=taylor_weights(max_step),
        length_scale=_length_scale(
            walls, further_drive_terms.drive_derivative_bound(drive_terms, amplitude, frequency, 0)
        ),
        jet_bound=force_deriv_bound * (1.0 + jet_bound_slope * max_step),
        jet_bound_slope=jet_bound_slope,
        force_remainder_bounds=tuple(
            contact_remainder_bound for contact_remainder_bound, _ in remainder_bounds_by_wall
        ),
        wall_remainder_bounds=tuple(wall_remainder_bound for _, wall_remainder_bound in remainder_bounds_by_wall),
        force_rate_bounds=tuple(
            wall_derivative_bounds(wall, amplitude, frequency, damping, 1, drive_terms)[0] for wall in walls
        ),
        min_wall_gap=_min_wall_gap(walls, amplitude),
        soft_flows=tuple(soft_wall_flow(wall, amplitude, frequency, drive_terms) for wall in walls),
        drive_terms=drive_terms,
    )


def _user_force_coefficients(scene):
    """Return the `FlowCoefficients` of a scene with a user-defined force."""
    user_force, dtype = scene.force, scene.dtype
    for side, wall in scene.walls.items():
        if wall.law is not None:
            _require_law_series(f"{side}.law", wall.law, dtype)
    amplitude, frequency = (jnp.asarray(value, dtype) for value in (scene.amplitude, scene.frequency))
    walls, drive_terms = _wall_coefficients(scene), further_drive_terms.drive_terms(scene, frequency, None)
    max_harmonic = max((wall.harmonic for wall in walls if wall.amplitude is not None), default=1)
    max_harmonic = max(max_harmonic, further_drive_terms.highest_harmonic(drive_terms))
    period, zero = 2.0 * jnp.pi / frequency, jnp.zeros_like(frequency)
    max_step = flow.MAX_SCALED_STEP / (frequency * max_harmonic)
    return FlowCoefficients(
        amplitude=amplitude,
        frequency=frequency,
        damping=zero,
        walls=walls,
        period=period,
        period_low_part=_two_pi_less_product(frequency, period) / frequency,
        in_phase_amplitude=zero,
        series=None,
        max_step=max_step,
        inverse_max_step=1.0 / max_step,
        taylor_weights=taylor_weights(max_step),
        length_scale=_length_scale(
            walls, further_drive_terms.drive_derivative_bound(drive_terms, amplitude, frequency, 0)
        ),
        jet_bound=None,
        jet_bound_slope=None,
        force_remainder_bounds=(),
        wall_remainder_bounds=tuple(wall_derivative_bounds(wall, zero, frequency, zero, N_TERMS)[1] for wall in walls),
        force_rate_bounds=(),
        min_wall_gap=_min_wall_gap(walls, amplitude),
        soft_flows=tuple(None if wall.restitution is not None else wall for wall in walls),
        user_force=jax.tree.map(lambda param: jnp.asarray(param, dtype), user_force),
        drive_terms=drive_terms,
    )


def _require_law_series(parameter_name, wall_law, dtype):
    """Raise an error if a wall law is not a power series in the root of the depth."""
    trace_signature = wall_law.function, tuple(wall_law.numbers), np.dtype(dtype)
    unknown_operations = ops_without_series(*trace_signature, 2)
    if unknown_operations:
        error_message = (
            f"must use operations with a known Taylor series; none is known of {', '.join(unknown_operations)}"
        )
        raise check.SceneError(parameter_name, error_message, wall_law.function)
    if not is_series_of_root(*trace_signature):
        raise check.SceneError(parameter_name, "must be a power series in the root of the depth", wall_law.function)


def _wall_coefficients(scene):
    """Return the coefficients of the existing walls, left wall first."""
    signed_walls = zip(WALL_SIGNS, (scene.left, scene.right), strict=True)
    return tuple(wall_coefficients(wall, scene, side, scene.dtype) for side, wall in signed_walls if wall is not None)


def _length_scale(walls, drive_amplitude):
    """Return the length scale of a scene, `min_squarable_length` if there is no drive and all walls are at 0."""
    length_sum = sum((max_wall_distance(wall) for wall in walls), drive_amplitude)
    return choose(length_sum > 0, length_sum, lax.full_like(length_sum, min_squarable_length(length_sum.dtype)))


def _min_wall_gap(walls, drive_amplitude):
    """Return a lower bound on the distance between the walls."""
    if len(walls) < 2:
        return jnp.full_like(drive_amplitude, jnp.inf)
    left_wall, right_wall = walls
    return (right_wall.position - left_wall.position) - sum(
        abs(wall.amplitude) for wall in walls if wall.amplitude is not None
    )


def _two_pi_less_product(frequency, period):
    """Return 2 pi, beyond double precision, less the exact product frequency * period (Dekker)."""
    rounded_product = frequency * period
    product_error = dekker_product_error(frequency, period, rounded_product)
    two_pi = jnp.asarray(2.0 * jnp.pi, period.dtype)
    two_pi_low_part = TWO_PI_LOW if period.dtype == jnp.float64 else 2.0 * math.pi - float(np.float32(2.0 * math.pi))
    return (two_pi - rounded_product) - product_error + two_pi_low_part


def dekker_product_error(first_factor, second_factor, rounded_product):
    """Compute the rounding error of a product (Dekker).

    Parameters
    ----------
    first_factor : array
        First factor.
    second_factor : array
        Second factor.
    rounded_product : array
        Rounded product.

    Returns
    -------
    array
        Exact product less the rounded one.
    """
    (first_upper, first_lower), (second_upper, second_lower) = _split_digits(first_factor), _split_digits(second_factor)
    return (
        (first_upper * second_upper - rounded_product) + first_upper * second_lower + first_lower * second_upper
    ) + first_lower * second_lower


def _split_digits(number):
    """Split a number into the sum of two numbers with half of its digits each (Veltkamp)."""
    scaled_number = number * (2.0 ** ((jnp.finfo(number.dtype).nmant + 2) // 2) + 1.0)
    upper_half = scaled_number - (scaled_number - number)
    return upper_half, number - upper_half


def check_validity(coeffs):
    """Check for each lane that the scene satisfies the rules of `make_scene`.

    Parameters
    ----------
    coeffs : FlowCoefficients
        Coefficients of the scene.

    Returns
    -------
    valid : array of bool
        True where the scene satisfies the rules.
    finite : array of bool
        True where all parameters, except those of a user-defined force, are finite.
    """
    term_parameters = [(drive_term.amplitude, drive_term.cosine) for drive_term in coeffs.drive_terms]
    parameters = jax.tree.leaves((coeffs.amplitude, coeffs.frequency, coeffs.damping, coeffs.walls, term_parameters))
    is_finite = jnp.isfinite(coeffs.amplitude)
    for parameter in parameters:
        is_finite &= jnp.isfinite(parameter)
    is_valid = (coeffs.frequency > 0) & (coeffs.damping >= 0)
    for wall in coeffs.walls:
        if wall.law is not None:
            continue
        if wall.stiffness is None:
            is_valid &= (wall.restitution >= 0) & (wall.restitution <= 1)
        else:
            is_valid &= (wall.stiffness > 0) & (wall.damping >= 0)
    if len(coeffs.walls) == 2:
        left_wall, right_wall = coeffs.walls
        is_valid &= left_wall.position < right_wall.position
    return is_valid, is_finite


# for code that is traced repeatedly for few lanes: traced once per process and kind of scene
flow_coefficients = jax.jit(make_flow_coefficients)
