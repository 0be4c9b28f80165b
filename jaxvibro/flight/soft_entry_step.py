"""Take the first step inside a stiff wall: most of a half-oscillation, of one duration for every fast entry.

From y = 0 with the speed u and under a force p on y, y(t) = u G(t) + int G(t - s) p(s) ds. G is the response of y to a
unit speed: exp(-gamma2 t) sin(d t) / d with d^2 = 1 + k2 - gamma2^2. While p >= -P, y >= u G - P int G. As G' / G
decreases, int G / G increases up to pi / d. Hence u > P int G / G at the end of the step certifies that the mass is
still inside.
"""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Float

from ..compiled.compiler_hints import choose
from . import drive, flow
from .wall_motion import remainder_bounds

STEP_SHARE = 0.9  # fraction of the half-oscillation; the exit is then closer than the longest step
MAX_DAMPING_SHARE = 0.5  # largest ratio damping^2 / stiffness for which such a step exists
N_DOUBLINGS = 3  # doublings of a flow step with the rates d and 2 gamma2; STEP_SHARE pi sqrt(2) sqrt(2) < 2^3
SAFETY_MARGIN = 1.01  # factor on the speed that certifies a step


class EntryStep(NamedTuple):
    """First step after an entry, of a fixed duration.

    Attributes
    ----------
    time : array
        Duration.
    speed_per_push : array
        Ratio int G / G at its end. Infinite if no such step exists.
    push_change : array
        Bound on the change of the force within the step.
    free_flow : tuple of array
        Matrix of the free flow, see `flow.doubling_responses`.
    forced_flow : tuple
        Motion under the first drive term.
    drive_rotation : tuple of array
        Cosine less 1 and sine of the drive angle over the step.
    wall_flow : tuple or None
        Motion under the motion of the wall. None for a fixed wall.
    term_flows : tuple
        Motion under each further drive term.
    """

    time: Float[jax.Array, "..."]
    speed_per_push: Float[jax.Array, "..."]
    push_change: Float[jax.Array, "..."]
    free_flow: flow.FreeFlow
    forced_flow: flow.ForcedFlow
    drive_rotation: tuple[Float[jax.Array, "..."], Float[jax.Array, "..."]]
    wall_flow: flow.ForcedFlow | None
    term_flows: tuple[flow.ForcedFlow, ...] = ()


def entry_step(wall, amplitude, frequency, series, wall_series, stiffness, term_pairs=()):
    """Return the `EntryStep` into a soft wall.

    `series` and `wall_series` belong to the flow inside it, whose stiffness is 1 + k2. `term_pairs` holds each further
    drive term and the series under it.
    """
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
    """Return True if the step is certain after an entry with this speed under this force into the wall."""
    outward_push = entry.push_change - push
    return speed > entry.speed_per_push * choose(outward_push > 0, outward_push, 0.0)
