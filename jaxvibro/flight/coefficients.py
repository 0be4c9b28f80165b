"""Compute the coefficients of the flight from a scene, once per scene."""

import math
from enum import Enum
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Float

from ..compiled.compiler_hints import choose
from ..scene import check
from ..scene.force import Force
from ..scene.force_trace import ops_without_series
from ..scene.typical_scales import fast_part_amplitude
from . import drive, flow
from .event import N_TERMS, smallest_length, taylor_weights
from .soft_contact import SoftWallFlow, soft_wall_flow
from .traced_force import is_series_of_root
from .wall_motion import WallCoefficients, remainder_bounds, wall_coefficients, wall_extent

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
    period_low : array
        Low part of `period`: the exact period less its rounded value.
    swift_amplitude : array
        Amplitude of the swift part of the motion, see `flight_state`. Zero under a user-defined force.
    series : FlowSeries or None
        Taylor series of the flow. None under a user-defined force.
    max_step : array
        Longest step, in units of t.
    inverse_max_step : array
        Reciprocal of `max_step`.
    taylor_weights : tuple of array
        Weights max_step^k / k! of the derivatives in a Taylor polynomial.
    length_scale : array
        Length scale of the scene, used to measure rounding: the sum of the wall distances and the drive amplitudes, or
        `event.smallest_length` if all of these are 0.
    jet_bound : array or None
        Constant part of the bound on ``|x^(8)|`` over a step. None under a user-defined force.
    jet_bound_slope : array or None
        Factor of ``|x^(6)| + |x^(7)|`` at the start of a step in that bound. None under a user-defined force.
    force_remainders : tuple of array
        Bound on the remainder of the contact force, for each wall, see `wall_motion.remainder_bounds`.
    wall_remainders : tuple of array
        Bound on the remainder of the position, for each wall, see `wall_motion.remainder_bounds`.
    force_rate_bounds : tuple of array
        Bound on the rate of the contact force, for each wall.
    min_wall_gap : array
        Lower bound on the distance between the walls; infinite if there are fewer than two.
    soft_flows : tuple
        For each wall the `soft_contact.SoftWallFlow` inside it, under a user-defined force its `WallCoefficients`
        (`force_law_flow`), and None if it is rigid.
    stiffness : array or None
        Stiffness of the oscillator. None stands for 1. Set per lane by `soft_contact.lane_coefficients`.
    root_stiffness : array or None
        Square root of `stiffness`. None stands for 1.
    force_law : Force or None
        User-defined force.
    drive_terms : tuple of DriveTerm
        Terms of the drive in addition to A cos(omega t).
    """

    amplitude: Float[jax.Array, "..."]
    frequency: Float[jax.Array, "..."]
    damping: Float[jax.Array, "..."]
    walls: tuple[WallCoefficients, ...]
    period: Float[jax.Array, "..."]
    period_low: Float[jax.Array, "..."]
    swift_amplitude: Float[jax.Array, "..."]
    series: flow.FlowSeries
    max_step: Float[jax.Array, "..."]
    inverse_max_step: Float[jax.Array, "..."]
    taylor_weights: tuple[Float[jax.Array, "..."], ...]
    length_scale: Float[jax.Array, "..."]
    jet_bound: Float[jax.Array, "..."]
    jet_bound_slope: Float[jax.Array, "..."]
    force_remainders: tuple[Float[jax.Array, "..."], ...]
    wall_remainders: tuple[Float[jax.Array, "..."], ...]
    force_rate_bounds: tuple[Float[jax.Array, "..."], ...]
    min_wall_gap: Float[jax.Array, "..."]
    soft_flows: tuple[SoftWallFlow | WallCoefficients | None, ...] = ()
    stiffness: Float[jax.Array, "..."] | None = None
    root_stiffness: Float[jax.Array, "..."] | None = None
    force_law: Force | None = None
    drive_terms: tuple[drive.DriveTerm, ...] = ()

    @property
    def contact_law(self) -> ContactLaw:
        """Kind of the contact phases inside soft walls."""
        if all(soft_flow is None for soft_flow in self.soft_flows):
            return ContactLaw.RIGID
        return ContactLaw.LINEAR if self.force_law is None else ContactLaw.FORCE_LAW


def compute_coefficients(scene):
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
        return _force_law_coefficients(scene)
    dtype = scene.dtype
    amplitude, frequency, damping = (
        jnp.asarray(value, dtype) for value in (scene.amplitude, scene.frequency, scene.damping)
    )
    walls, drive_terms = _wall_coefficients(scene), drive.drive_terms(scene, frequency, damping)
    max_rate = flow.max_rate(frequency, damping)
    for wall in walls:
        max_rate = jnp.maximum(max_rate, frequency * (wall.harmonic if wall.amplitude is not None else 1.0))
    if drive_terms:
        max_rate = jnp.maximum(max_rate, frequency * float(drive.highest_harmonic(drive_terms)))
    max_step = flow.MAX_SCALED_STEP / max_rate
    # energy of x^(6): abs x^(6), abs x^(7) <= abs x^(6)(0) + abs x^(7)(0) + A omega^6 t; damping lowers it
    force_bound, jet_bound_slope = (
        drive.total_derivative_bound(drive_terms, amplitude, frequency, 6),
        jnp.sqrt(1.0 + 4.0 * damping * damping),
    )
    period = 2.0 * jnp.pi / frequency
    wall_bounds = [remainder_bounds(wall, amplitude, frequency, damping, N_TERMS, drive_terms) for wall in walls]
    return FlowCoefficients(
        amplitude=amplitude,
        frequency=frequency,
        damping=damping,
        walls=walls,
        period=period,
        period_low=_period_remainder(frequency, period) / frequency,
        swift_amplitude=fast_part_amplitude(frequency, damping, amplitude),
        series=flow.flow_series(frequency, damping),
        max_step=max_step,
        inverse_max_step=max_rate / flow.MAX_SCALED_STEP,
        taylor_weights=taylor_weights(max_step),
        length_scale=_length_scale(walls, drive.total_derivative_bound(drive_terms, amplitude, frequency, 0)),
        jet_bound=force_bound * (1.0 + jet_bound_slope * max_step),
        jet_bound_slope=jet_bound_slope,
        force_remainders=tuple(force_remainder for force_remainder, _ in wall_bounds),
        wall_remainders=tuple(wall_remainder for _, wall_remainder in wall_bounds),
        force_rate_bounds=tuple(
            remainder_bounds(wall, amplitude, frequency, damping, 1, drive_terms)[0] for wall in walls
        ),
        min_wall_gap=_min_wall_gap(walls, amplitude),
        soft_flows=tuple(soft_wall_flow(wall, amplitude, frequency, drive_terms) for wall in walls),
        drive_terms=drive_terms,
    )


def _force_law_coefficients(scene):
    """Return the `FlowCoefficients` of a scene with a user-defined force."""
    force_law, dtype = scene.force, scene.dtype
    for side, wall in scene.walls.items():
        if wall.law is not None:
            _require_series(f"{side}.law", wall.law, dtype)
    amplitude, frequency = (jnp.asarray(value, dtype) for value in (scene.amplitude, scene.frequency))
    walls, drive_terms = _wall_coefficients(scene), drive.drive_terms(scene, frequency, None)
    max_harmonic = max((wall.harmonic for wall in walls if wall.amplitude is not None), default=1)
    max_harmonic = max(max_harmonic, drive.highest_harmonic(drive_terms))
    period, zero = 2.0 * jnp.pi / frequency, jnp.zeros_like(frequency)
    max_step = flow.MAX_SCALED_STEP / (frequency * max_harmonic)
    return FlowCoefficients(
        amplitude=amplitude,
        frequency=frequency,
        damping=zero,
        walls=walls,
        period=period,
        period_low=_period_remainder(frequency, period) / frequency,
        swift_amplitude=zero,
        series=None,
        max_step=max_step,
        inverse_max_step=1.0 / max_step,
        taylor_weights=taylor_weights(max_step),
        length_scale=_length_scale(walls, drive.total_derivative_bound(drive_terms, amplitude, frequency, 0)),
        jet_bound=None,
        jet_bound_slope=None,
        force_remainders=(),
        wall_remainders=tuple(remainder_bounds(wall, zero, frequency, zero, N_TERMS)[1] for wall in walls),
        force_rate_bounds=(),
        min_wall_gap=_min_wall_gap(walls, amplitude),
        soft_flows=tuple(None if wall.restitution is not None else wall for wall in walls),
        force_law=jax.tree.map(lambda param: jnp.asarray(param, dtype), force_law),
        drive_terms=drive_terms,
    )


def _require_series(key, contact_law, dtype):
    """Raise an error if a wall law is not a power series in the root of the depth."""
    signature = contact_law.function, tuple(contact_law.numbers), np.dtype(dtype)
    unknown_operations = ops_without_series(*signature, 2)
    if unknown_operations:
        message = f"must use operations with a known Taylor series; none is known of {', '.join(unknown_operations)}"
        raise check.SceneError(key, message, contact_law.function)
    if not is_series_of_root(*signature):
        raise check.SceneError(key, "must be a power series in the root of the depth", contact_law.function)


def _wall_coefficients(scene):
    """Return the coefficients of the existing walls, left wall first."""
    signed_walls = zip(WALL_SIGNS, (scene.left, scene.right), strict=True)
    return tuple(wall_coefficients(wall, scene, side, scene.dtype) for side, wall in signed_walls if wall is not None)


def _length_scale(walls, amplitude):
    """Return the length scale of a scene; `smallest_length` if it has neither drive nor distance of a wall from 0."""
    length = sum((wall_extent(wall) for wall in walls), amplitude)
    return choose(length > 0, length, lax.full_like(length, smallest_length(length.dtype)))


def _min_wall_gap(walls, amplitude):
    """Return a lower bound on the distance between the walls."""
    if len(walls) < 2:
        return jnp.full_like(amplitude, jnp.inf)
    left_wall, right_wall = walls
    return (right_wall.position - left_wall.position) - sum(
        abs(wall.amplitude) for wall in walls if wall.amplitude is not None
    )


def _period_remainder(frequency, period):
    """Return 2 pi less the exact product frequency * period (Dekker), with 2 pi beyond double precision."""
    product = frequency * period
    product_error = dekker_product_error(frequency, period, product)
    two_pi = jnp.asarray(2.0 * jnp.pi, period.dtype)
    two_pi_low = TWO_PI_LOW if period.dtype == jnp.float64 else 2.0 * math.pi - float(np.float32(2.0 * math.pi))
    return (two_pi - product) - product_error + two_pi_low


def dekker_product_error(a, b, product):
    """Compute the rounding error of a product (Dekker).

    Parameters
    ----------
    a : array
        First factor.
    b : array
        Second factor.
    product : array
        Rounded product.

    Returns
    -------
    array
        Exact product less the rounded one.
    """
    (a_upper, a_lower), (b_upper, b_lower) = _split_digits(a), _split_digits(b)
    return ((a_upper * b_upper - product) + a_upper * b_lower + a_lower * b_upper) + a_lower * b_lower


def _split_digits(a):
    """Split a number into the sum of two numbers with half of its digits each (Veltkamp)."""
    scaled = a * (2.0 ** ((jnp.finfo(a.dtype).nmant + 2) // 2) + 1.0)
    upper_half = scaled - (scaled - a)
    return upper_half, a - upper_half


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
        True where all parameters are finite.
    """
    term_values = [(term.amplitude, term.cosine) for term in coeffs.drive_terms]
    values = jax.tree.leaves((coeffs.amplitude, coeffs.frequency, coeffs.damping, coeffs.walls, term_values))
    finite = jnp.isfinite(coeffs.amplitude)
    for value in values:
        finite &= jnp.isfinite(value)
    valid = (coeffs.frequency > 0) & (coeffs.damping >= 0)
    for wall in coeffs.walls:
        if wall.law is not None:
            continue
        if wall.stiffness is None:
            valid &= (wall.restitution >= 0) & (wall.restitution <= 1)
        else:
            valid &= (wall.stiffness > 0) & (wall.damping >= 0)
    if len(coeffs.walls) == 2:
        left_wall, right_wall = coeffs.walls
        valid &= left_wall.position < right_wall.position
    return valid, finite


# for code that is traced repeatedly for few lanes: traced once per process and kind of scene
flow_coefficients = jax.jit(compute_coefficients)
