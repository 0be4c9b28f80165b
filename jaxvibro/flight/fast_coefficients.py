"""What lean steps count with: a scene's numbers and the lanes of a batch, with time in longest steps."""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Float

from . import flow
from .event import N_TERMS
from .wall_motion import WallCoefficients, wall_extent

GIVEN_UP = -1.0  # of the time that is left to a lane
MAX_STEPS = 256.0  # of a period: so few that roundings cannot add up to `lean_event.MARGIN` (docs/numbers.md)


class FastCoefficients(NamedTuple):
    """What lean steps need of a scene, in longest steps of time; each number a scalar or one for each lane.

    Of x'' = force cos - stiffness x - drag x': these, and the drive's frequency; series: of its flow, short_series:
    that `flow.shortened`; walls: the frame's; wall_terms: for each, its swing's Taylor coefficients but for cos and
    sin, None where it stands still; wall_remainders: what the swings add to the remainder; drive_remainder: what the
    drive adds, sixth_term_weight: the sixth derivative's share in it; wall_gap: between still walls; length_scale: the
    walls' distances and the drive's amplitude together; step_limit: of one period, the most; max_step: the longest step
    (t)."""

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
        """Whether all walls stand still."""
        return all(wall.amplitude is None for wall in self.walls)


class LaneStates(NamedTuple):
    """Where lanes are in their period: x and v, the drive's cosine and sine, the time left, GIVEN_UP of a lane that
    is; largest_length: the largest length so far."""

    x: Float[jax.Array, "*lanes"]
    v: Float[jax.Array, "*lanes"]
    cosine: Float[jax.Array, "*lanes"]
    sine: Float[jax.Array, "*lanes"]
    time_remaining: Float[jax.Array, "*lanes"]
    largest_length: Float[jax.Array, "*lanes"]


def scale_coefficients(coeffs):
    """The `FastCoefficients` of a frame with rigid walls."""
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
    if wall.amplitude is None:
        return None
    wall_rate = frequency * float(wall.harmonic)
    return tuple(wall.amplitude * wall_rate**k / math.factorial(k) for k in range(N_TERMS + 1))
