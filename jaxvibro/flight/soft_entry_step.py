"""The first step within a stiff wall: most of a half-swing, the same time after every entry that is fast enough.

From y = 0 at the speed u, under a push p on y, y(t) = u G(t) + int G(t - s) p(s) ds, where G is what a unit of speed
does to y: exp(-gamma2 t) sin(d t) / d, d^2 = 1 + k2 - gamma2^2. While p >= -P, y >= u G - P int G; and as G' / G falls,
int G / G rises up to pi / d. So u > P int G / G at the step's end certifies that the mass is still within.
"""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Float

from ..compiled.compiler_hints import choose
from . import drive, flow
from .wall_motion import remainder_bounds

STEP_SHARE = 0.9  # of the half-swing: the way out is then nearer than the longest step
MAX_DAMPING_SHARE = 0.5  # times the stiffness: damping^2 below which there is such a step
N_DOUBLINGS = 3  # of a step of the flow, in which time / d and 2 gamma2 count: SHARE pi sqrt(2) sqrt(2) < 8 of them
SAFETY_MARGIN = 1.01


class EntryStep(NamedTuple):
    """A step of a given time: ratio, int G / G at its end, inf where there is no such step; push_change: of the push
    within it, a bound; free_flow, forced_flow, drive_rotation: `flow.doubled`'s; wall_flow: as forced, under the wall's
    own motion, None where it stands still; term_flows: as forced, under the drive's further terms."""

    time: Float[jax.Array, "..."]
    speed_per_push: Float[jax.Array, "..."]
    push_change: Float[jax.Array, "..."]
    free_flow: flow.FreeFlow
    forced_flow: flow.ForcedFlow
    drive_rotation: tuple[Float[jax.Array, "..."], Float[jax.Array, "..."]]
    wall_flow: flow.ForcedFlow | None
    term_flows: tuple[flow.ForcedFlow, ...] = ()


def entry_step(wall, amplitude, frequency, series, wall_series, stiffness, term_pairs=()):
    """The `EntryStep` into a soft wall's `Lane`; series, wall_series: of the flow within it, stiffness: 1 + k2;
    term_pairs: (the drive's further `Term`, the series under it)."""
    damping, wall_frequency = wall.damping, frequency * float(wall.harmonic)
    drive_terms = [term for term, _ in term_pairs]
    max_frequency = jnp.maximum(frequency, wall_frequency)
    max_frequency = (
        jnp.maximum(max_frequency, frequency * float(drive.highest_harmonic(drive_terms)))
        if drive_terms
        else max_frequency
    )
    underdamped = (damping * damping < MAX_DAMPING_SHARE * stiffness) & (max_frequency < jnp.sqrt(stiffness))
    time = STEP_SHARE * math.pi / jnp.sqrt(choose(underdamped, stiffness - damping * damping, stiffness))
    free_flow, forced_flow, drive_rotation = flow.fixed_doubling_responses(
        series, frequency, damping, time, stiffness, N_DOUBLINGS
    )
    wall_flow = (
        None
        if wall_series is None
        else flow.fixed_doubling_responses(wall_series, wall_frequency, damping, time, stiffness, N_DOUBLINGS)[1]
    )
    speed_per_push = SAFETY_MARGIN * (1.0 - free_flow[0]) / (stiffness * free_flow[1])
    speed_per_push = choose(underdamped, speed_per_push, jnp.full_like(speed_per_push, jnp.inf))
    push_change = remainder_bounds(wall, amplitude, frequency, damping, 1, drive_terms)[0] * time
    term_flows = [
        flow.fixed_doubling_responses(
            wall_frequency, drive.angular_rate(term, frequency), damping, time, stiffness, N_DOUBLINGS
        )[1]
        for term, wall_frequency in term_pairs
    ]
    return EntryStep(
        time, speed_per_push, push_change, free_flow, forced_flow, drive_rotation, wall_flow, tuple(term_flows)
    )


def is_certified(entry, speed, push):
    """Whether the step is certain after an entry at this speed and this push into the wall."""
    outward_push = entry.push_change - push
    return speed > entry.speed_per_push * choose(outward_push > 0, outward_push, 0.0)
