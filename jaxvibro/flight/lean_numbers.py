"""What lean steps count with: a scene's numbers and the lanes of a batch, with time in longest steps."""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Float

from . import flow
from .event import TERMS
from .wall import Lane, extent

GIVEN_UP = -1.0  # of the time that is left to a lane
MOST_TURNS = 256.0  # of a period: so few that roundings cannot add up to `lean_event.MARGIN` (docs/numbers.md)


class Numbers(NamedTuple):
    """What lean steps need of a scene, in longest steps of time; each number a scalar or one for each lane.

    Of x'' = force cos - stiffness x - drag x': these, and the drive's frequency; series: of its flow, flight: that
    `flow.shortened`; walls: the frame's; swings: for each, its swing's Taylor coefficients but for cos and sin, None
    where it stands still; sway: what the swings add to the remainder; forcing: what the drive adds, inertia: the sixth
    derivative's share in it; gap: between still walls; size: the walls' distances and the drive's amplitude together;
    turns: of one period, the most; reach: the longest step (t).
    """

    force: Float[jax.Array, "..."]
    frequency: Float[jax.Array, "..."]
    drag: Float[jax.Array, "..."]
    stiffness: Float[jax.Array, "..."]
    series: flow.Series
    flight: flow.Series
    walls: tuple[Lane, ...]
    swings: tuple[tuple[Float[jax.Array, "..."], ...] | None, ...]
    sway: tuple[Float[jax.Array, "..."], ...]
    forcing: Float[jax.Array, "..."]
    inertia: Float[jax.Array, "..."]
    gap: Float[jax.Array, "..."]
    size: Float[jax.Array, "..."]
    period: Float[jax.Array, "..."]
    turns: Float[jax.Array, "..."]
    reach: Float[jax.Array, "..."]
    pace: Float[jax.Array, "..."]

    @property
    def still(self) -> bool:
        """Whether all walls stand still."""
        return all(wall.swing is None for wall in self.walls)


class Lanes(NamedTuple):
    """Where lanes are in their period: x and v, the drive's cosine and sine, the time left, GIVEN_UP of a lane that
    is; largest: the largest length so far."""

    x: Float[jax.Array, "*lanes"]
    v: Float[jax.Array, "*lanes"]
    cosine: Float[jax.Array, "*lanes"]
    sine: Float[jax.Array, "*lanes"]
    left: Float[jax.Array, "*lanes"]
    largest: Float[jax.Array, "*lanes"]


def numbers(frame):
    """The `Numbers` of a frame with rigid walls."""
    reach = frame.reach
    frequency, damping, stiffness = frame.frequency * reach, frame.damping * reach, reach * reach
    force, period = frame.force * stiffness, frame.period * frame.pace
    series = flow.series(frequency, damping, stiffness)
    swings = tuple(_swings(wall, frequency) for wall in frame.walls)
    none = jnp.zeros_like(reach)
    gap = frame.walls[-1].position - frame.walls[0].position
    return Numbers(
        force=force,
        frequency=frequency,
        drag=2.0 * damping,
        stiffness=stiffness,
        series=series,
        flight=flow.shortened(series),
        walls=frame.walls,
        swings=swings,
        sway=tuple(none if swing is None else abs(swing[TERMS]) for swing in swings),
        forcing=abs(force) * frequency ** (TERMS - 1) / math.factorial(TERMS),
        inertia=reach / TERMS,
        gap=gap,
        size=sum((extent(wall) for wall in frame.walls), abs(frame.force)),
        period=period,
        turns=jnp.minimum(32.0 + 2.0 * period, MOST_TURNS),
        reach=reach,
        pace=frame.pace,
    )


def _swings(wall, frequency):
    if wall.swing is None:
        return None
    rate = frequency * float(wall.harmonic)
    return tuple(wall.swing * rate**k / math.factorial(k) for k in range(TERMS + 1))
