"""What a flight needs of a scene, worked out once."""

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
TWO_PI_LOW = 2.4492935982947064e-16  # 2 pi less its double


class ContactLaw(Enum):
    """What stays within soft walls are: none, where all walls are rigid; of a spring and a damper on top of the
    oscillator's; or pushed back beside a force of the user's own."""

    RIGID = "none"
    LINEAR = "spring"
    FORCE_LAW = "pushed"


class FlowCoefficients(NamedTuple):
    """The oscillator, its drive, its walls, and bounds for the longest step; each number a scalar or one for each lane.

    force A, frequency omega, damping gamma; drive_terms: of the drive, beside A cos(omega t); walls: those that exist,
    left first; period 2 pi / omega and its low part; swift_amplitude: see `path`; series: of the flow; max_step: the
    longest step (t), inverse_max_step: 1 / max_step, taylor_weights: reach^k / k!; length_scale: a length of the scene,
    the walls' distances and the drive's amplitudes together, to measure rounding by, `smallest_length` where these are
    all 0; jet_bound, jet_bound_slope: abs x^(8) is at most curb + slope (abs x^(6) + abs x^(7)) over a step, these at
    its start; force_remainders, wall_remainders: see `wall.tail`, for each wall; rushes: bounds on the change of the
    press on each; min_wall_gap: the walls are never nearer to each other; soft_flows: the `soft_contact.SoftFlow`
    within each wall, under a force of the user's own its `WallCoefficients` (`pushed_flow`), None for rigid ones.

    stiffness and its root are 1, and None, but where they are what a lane feels (`soft_contact.felt`). force_law: a
    force of the user's own; then damping and swift are 0, and what bounds the linear flow is None."""

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
        """What its stays within soft walls are: asked for here alone."""
        if all(soft_flow is None for soft_flow in self.soft_flows):
            return ContactLaw.RIGID
        return ContactLaw.LINEAR if self.force_law is None else ContactLaw.FORCE_LAW


def compute_coefficients(scene):
    """The `FlowCoefficients` of a scene."""
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
    # energy of x^(6): abs x^(6), abs x^(7) <= abs x^(6)(0) + abs x^(7)(0) + A omega^6 t, damping only helps
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
    """The `FlowCoefficients` of a scene with a force of the user's own."""
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
    """Refuse the law of a wall that is no power series in the root of the depth."""
    signature = contact_law.function, tuple(contact_law.numbers), np.dtype(dtype)
    unknown_operations = ops_without_series(*signature, 2)
    if unknown_operations:
        message = f"has operations of which no Taylor series is known ({', '.join(unknown_operations)})"
        raise check.SceneError(key, message, contact_law.function)
    if not is_series_of_root(*signature):
        raise check.SceneError(key, "must be a power series in the root of the depth", contact_law.function)


def _wall_coefficients(scene):
    signed_walls = zip(WALL_SIGNS, (scene.left, scene.right), strict=True)
    return tuple(wall_coefficients(wall, scene, side, scene.dtype) for side, wall in signed_walls if wall is not None)


def _length_scale(walls, amplitude):
    """The length scale of a scene, never 0: `smallest_length` where all walls are at 0 and there is no drive."""
    length = sum((wall_extent(wall) for wall in walls), amplitude)
    return choose(length > 0, length, lax.full_like(length, smallest_length(length.dtype)))


def _min_wall_gap(walls, amplitude):
    if len(walls) < 2:
        return jnp.full_like(amplitude, jnp.inf)
    left_wall, right_wall = walls
    return (right_wall.position - left_wall.position) - sum(
        abs(wall.amplitude) for wall in walls if wall.amplitude is not None
    )


def _period_remainder(frequency, period):
    """2 pi - frequency period, the product taken exactly (Dekker) and 2 pi beyond its double."""
    product = frequency * period
    product_error = dekker_product_error(frequency, period, product)
    two_pi = jnp.asarray(2.0 * jnp.pi, period.dtype)
    two_pi_low = TWO_PI_LOW if period.dtype == jnp.float64 else 2.0 * math.pi - float(np.float32(2.0 * math.pi))
    return (two_pi - product) - product_error + two_pi_low


def dekker_product_error(a, b, product):
    """a b less the product rounded (Dekker)."""
    (a_upper, a_lower), (b_upper, b_lower) = _split_digits(a), _split_digits(b)
    return ((a_upper * b_upper - product) + a_upper * b_lower + a_lower * b_upper) + a_lower * b_lower


def _split_digits(a):
    """a as the sum of two numbers of half its digits (Veltkamp)."""
    scaled = a * (2.0 ** ((jnp.finfo(a.dtype).nmant + 2) // 2) + 1.0)
    upper_half = scaled - (scaled - a)
    return upper_half, a - upper_half


def check_validity(coeffs):
    """Whether the scene of each lane keeps the rules that `make_scene` checks: (valid, finite)."""
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


flow_coefficients = jax.jit(
    compute_coefficients
)  # of what is traced time and again for few lanes: once a process for scenes of a kind
