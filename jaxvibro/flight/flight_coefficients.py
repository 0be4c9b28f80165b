"""Define the coefficients of the flight, and compute those that do not depend on the kind of flow."""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Float

from ..compiled.lane_arithmetic import choose
from ..scene.force import Force
from . import further_drive_terms
from .event_certificates import min_squarable_length
from .flow import FlowSeries
from .motion_in_soft_wall import SoftWallFlow
from .protocols import Contact, Flow, Kinds
from .wall_motion import WallCoefficients, max_wall_distance, wall_coefficients

TWO_PI_LOW = 2.4492935982947064e-16  # 2 pi less its double-precision value


class FlowCoefficients(NamedTuple):
    """Coefficients of the oscillator, its drive and its walls, with bounds for the longest step.

    Each number is a scalar or an array with one value per lane.

    Attributes
    ----------
    kinds : Kinds
        Flow and contacts of the scene, without arrays.
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
    series : FlowSeries or None
        Taylor series of the flow. None under a user-defined force.
    """

    kinds: Kinds
    amplitude: Float[jax.Array, "..."]
    frequency: Float[jax.Array, "..."]
    damping: Float[jax.Array, "..."]
    walls: tuple[WallCoefficients, ...]
    period: Float[jax.Array, "..."]
    period_low_part: Float[jax.Array, "..."]
    in_phase_amplitude: Float[jax.Array, "..."]
    max_step: Float[jax.Array, "..."]
    inverse_max_step: Float[jax.Array, "..."]
    taylor_weights: tuple[Float[jax.Array, "..."], ...]
    length_scale: Float[jax.Array, "..."]
    wall_remainder_bounds: tuple[Float[jax.Array, "..."], ...]
    min_wall_gap: Float[jax.Array, "..."]
    soft_flows: tuple[SoftWallFlow | WallCoefficients | None, ...] = ()
    drive_terms: tuple[further_drive_terms.DriveTerm, ...] = ()
    series: FlowSeries | None = None
    jet_bound: Float[jax.Array, "..."] | None = None
    jet_bound_slope: Float[jax.Array, "..."] | None = None
    force_remainder_bounds: tuple[Float[jax.Array, "..."], ...] = ()
    force_rate_bounds: tuple[Float[jax.Array, "..."], ...] = ()
    stiffness: Float[jax.Array, "..."] | None = None
    root_stiffness: Float[jax.Array, "..."] | None = None
    user_force: Force | None = None

    @property
    def flow(self) -> Flow:
        """Flow between the walls."""
        return self.kinds.flow

    @property
    def contact(self) -> Contact:
        """Contact of the scene."""
        return self.kinds.contact


def common_fields(scene, kinds, damping=None):
    """Return the fields of `FlowCoefficients` that do not depend on the flow.

    Parameters
    ----------
    scene : Scene
        Scene with parameters that are scalars or lanes.
    kinds : Kinds
        Flow and contacts of the scene.
    damping : array, optional
        Damping ratio of a linear flow, for which the series of the drive terms are computed. None computes no series.

    Returns
    -------
    dict
        Fields by name.
    """
    amplitude, frequency = (jnp.asarray(parameter, scene.dtype) for parameter in (scene.amplitude, scene.frequency))
    walls = tuple(
        wall_coefficients(scene, side, contact) for side, contact in zip(scene.walls, kinds.wall_contacts, strict=True)
    )
    drive_terms = further_drive_terms.drive_terms(scene, frequency, damping)
    is_any_soft_wall_moving = any(wall.restitution is None and wall.amplitude is not None for wall in walls)
    period = 2.0 * jnp.pi / frequency
    return {
        "kinds": kinds,
        "amplitude": amplitude,
        "frequency": frequency,
        "walls": walls,
        "drive_terms": drive_terms,
        "period": period,
        "period_low_part": _two_pi_less_product(frequency, period) / frequency,
        "length_scale": _length_scale(
            walls, further_drive_terms.drive_derivative_bound(drive_terms, amplitude, frequency, 0)
        ),
        "min_wall_gap": _min_wall_gap(walls, amplitude),
        "soft_flows": tuple(
            contact.wall_flow(wall, amplitude, frequency, drive_terms, is_any_soft_wall_moving)
            for wall, contact in zip(walls, kinds.wall_contacts, strict=True)
        ),
    }


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
    for wall, contact in zip(coeffs.walls, coeffs.kinds.wall_contacts, strict=True):
        is_valid &= contact.is_valid_wall(wall)
    if len(coeffs.walls) == 2:
        left_wall, right_wall = coeffs.walls
        is_valid &= left_wall.position < right_wall.position
    return is_valid, is_finite
