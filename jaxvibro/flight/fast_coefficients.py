"""Scale the coefficients of a scene for the fast path, whose unit of time is the longest step."""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Float

from . import flow
from .event_certificates import N_TERMS
from .wall_motion import WallCoefficients, max_wall_distance

GIVEN_UP = -1.0  # remaining time of a lane that the fast path gives up
MAX_STEPS = 256.0  # per period; rounding errors then stay below `fast_event.DOUBT_MARGIN` (docs/numbers.md)


class FastCoefficients(NamedTuple):
    """Coefficients of the fast path for x'' = amplitude cos(frequency t) - stiffness x - drag x'.

    The unit of time is the longest step. Each number is a scalar or an array with one value per lane.

    Attributes
    ----------
    amplitude : array
        Drive amplitude.
    frequency : array
        Drive frequency.
    drag : array
        Damping coefficient 2 gamma.
    stiffness : array
        Stiffness of the oscillator.
    series : FlowSeries
        Series of the flow.
    economised_series : FlowSeries
        Economised series of the flow, see `flow.economise_series`.
    walls : tuple of WallCoefficients
        Walls of the `flight_coefficients.FlowCoefficients`.
    wall_taylor_factors : tuple
        For each wall the Taylor coefficients of its oscillation without the factors cos and sin; None for a fixed wall.
    wall_remainder_bounds : tuple of array
        Contribution of each wall's oscillation to the remainder.
    drive_remainder_bound : array
        Contribution of the drive to the remainder.
    sixth_term_weight : array
        Weight of the sixth Taylor term in the remainder.
    wall_gap : array
        Distance between the mean positions of the walls. 0 for one wall.
    length_scale : array
        Sum of the largest distances of the walls from the origin and the drive amplitude.
    period : array
        Drive period.
    max_steps : array
        Largest number of steps in one period.
    max_step : array
        Longest step, in units of t.
    inverse_max_step : array
        Reciprocal of `max_step`.
    """

    amplitude: Float[jax.Array, "..."]
    frequency: Float[jax.Array, "..."]
    drag: Float[jax.Array, "..."]
    stiffness: Float[jax.Array, "..."]
    series: flow.FlowSeries
    economised_series: flow.FlowSeries
    walls: tuple[WallCoefficients, ...]
    wall_taylor_factors: tuple[tuple[Float[jax.Array, "..."], ...] | None, ...]
    wall_remainder_bounds: tuple[Float[jax.Array, "..."], ...]
    drive_remainder_bound: Float[jax.Array, "..."]
    sixth_term_weight: Float[jax.Array, "..."]
    wall_gap: Float[jax.Array, "..."]
    length_scale: Float[jax.Array, "..."]
    period: Float[jax.Array, "..."]
    max_steps: Float[jax.Array, "..."]
    max_step: Float[jax.Array, "..."]
    inverse_max_step: Float[jax.Array, "..."]

    @property
    def has_fixed_walls(self) -> bool:
        """True if no wall moves."""
        return all(wall.amplitude is None for wall in self.walls)


class LaneStates(NamedTuple):
    """States of lanes within their period.

    Attributes
    ----------
    x : array
        Position.
    v : array
        Velocity, in lengths per longest step.
    cosine : array
        Cosine of the drive angle.
    sine : array
        Sine of the drive angle.
    time_remaining : array
        Remaining time of the period, in longest steps. `GIVEN_UP` for a lane that the fast path gives up.
    largest_length : array
        Largest value of `length_scale` + abs x + abs v since the start of the period. Rounding errors are relative to
        this length.
    """

    x: Float[jax.Array, "*lanes"]
    v: Float[jax.Array, "*lanes"]
    cosine: Float[jax.Array, "*lanes"]
    sine: Float[jax.Array, "*lanes"]
    time_remaining: Float[jax.Array, "*lanes"]
    largest_length: Float[jax.Array, "*lanes"]


def make_fast_coefficients(coeffs):
    """Scale the coefficients of a scene with rigid walls for the fast path.

    Parameters
    ----------
    coeffs : FlowCoefficients
        Coefficients of the scene.

    Returns
    -------
    FastCoefficients
        Coefficients in units of the longest step.
    """
    max_step = coeffs.max_step
    frequency, damping, stiffness = coeffs.frequency * max_step, coeffs.damping * max_step, max_step * max_step
    amplitude, period = coeffs.amplitude * stiffness, coeffs.period * coeffs.inverse_max_step
    series = flow.flow_series(frequency, damping, stiffness)
    wall_taylor_factors = tuple(_wall_taylor_factors(wall, frequency) for wall in coeffs.walls)
    zero = jnp.zeros_like(max_step)
    wall_gap = coeffs.walls[-1].position - coeffs.walls[0].position
    return FastCoefficients(
        amplitude=amplitude,
        frequency=frequency,
        drag=2.0 * damping,
        stiffness=stiffness,
        series=series,
        economised_series=flow.economise_series(series),
        walls=coeffs.walls,
        wall_taylor_factors=wall_taylor_factors,
        wall_remainder_bounds=tuple(
            zero if taylor_factors is None else abs(taylor_factors[N_TERMS]) for taylor_factors in wall_taylor_factors
        ),
        drive_remainder_bound=abs(amplitude) * frequency ** (N_TERMS - 1) / math.factorial(N_TERMS),
        sixth_term_weight=max_step / N_TERMS,
        wall_gap=wall_gap,
        length_scale=sum((max_wall_distance(wall) for wall in coeffs.walls), abs(coeffs.amplitude)),
        period=period,
        max_steps=jnp.minimum(32.0 + 2.0 * period, MAX_STEPS),
        max_step=max_step,
        inverse_max_step=coeffs.inverse_max_step,
    )


def _wall_taylor_factors(wall, frequency):
    """Return the Taylor coefficients of a wall's oscillation without the factors cos and sin, None for a fixed wall."""
    if wall.amplitude is None:
        return None
    wall_frequency = frequency * float(wall.harmonic)
    return tuple(wall.amplitude * wall_frequency**k / math.factorial(k) for k in range(N_TERMS + 1))
