"""Scale the coefficients of a scene for the fast path, whose unit of time is the longest step."""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Float

from . import flow
from .event import N_TERMS
from .wall_motion import WallCoefficients, wall_extent

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
    short_series : FlowSeries
        Economised series of the flow, see `flow.economise_series`.
    walls : tuple of WallCoefficients
        Walls of the `coefficients.FlowCoefficients`.
    wall_terms : tuple
        For each wall the Taylor coefficients of its oscillation without the factors cos and sin; None if it is fixed.
    wall_remainders : tuple of array
        Contribution of each wall's oscillation to the remainder.
    drive_remainder : array
        Contribution of the drive to the remainder.
    sixth_term_weight : array
        Weight of the sixth Taylor term in the remainder.
    wall_gap : array
        Distance between fixed walls.
    length_scale : array
        Sum of the wall distances and the drive amplitude.
    period : array
        Drive period.
    step_limit : array
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
    short_series: flow.FlowSeries
    walls: tuple[WallCoefficients, ...]
    wall_terms: tuple[tuple[Float[jax.Array, "..."], ...] | None, ...]
    wall_remainders: tuple[Float[jax.Array, "..."], ...]
    drive_remainder: Float[jax.Array, "..."]
    sixth_term_weight: Float[jax.Array, "..."]
    wall_gap: Float[jax.Array, "..."]
    length_scale: Float[jax.Array, "..."]
    period: Float[jax.Array, "..."]
    step_limit: Float[jax.Array, "..."]
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
        Largest length since the start of the period, to which rounding errors are relative.
    """

    x: Float[jax.Array, "*lanes"]
    v: Float[jax.Array, "*lanes"]
    cosine: Float[jax.Array, "*lanes"]
    sine: Float[jax.Array, "*lanes"]
    time_remaining: Float[jax.Array, "*lanes"]
    largest_length: Float[jax.Array, "*lanes"]


def scale_coefficients(coeffs):
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
    wall_terms = tuple(_wall_terms(wall, frequency) for wall in coeffs.walls)
    zero = jnp.zeros_like(max_step)
    wall_gap = coeffs.walls[-1].position - coeffs.walls[0].position
    return FastCoefficients(
        amplitude=amplitude,
        frequency=frequency,
        drag=2.0 * damping,
        stiffness=stiffness,
        series=series,
        short_series=flow.economise_series(series),
        walls=coeffs.walls,
        wall_terms=wall_terms,
        wall_remainders=tuple(zero if terms is None else abs(terms[N_TERMS]) for terms in wall_terms),
        drive_remainder=abs(amplitude) * frequency ** (N_TERMS - 1) / math.factorial(N_TERMS),
        sixth_term_weight=max_step / N_TERMS,
        wall_gap=wall_gap,
        length_scale=sum((wall_extent(wall) for wall in coeffs.walls), abs(coeffs.amplitude)),
        period=period,
        step_limit=jnp.minimum(32.0 + 2.0 * period, MAX_STEPS),
        max_step=max_step,
        inverse_max_step=coeffs.inverse_max_step,
    )


def _wall_terms(wall, frequency):
    """Return the Taylor coefficients of a wall's oscillation without the factors cos and sin, None for a fixed wall."""
    if wall.amplitude is None:
        return None
    wall_rate = frequency * float(wall.harmonic)
    return tuple(wall.amplitude * wall_rate**k / math.factorial(k) for k in range(N_TERMS + 1))
