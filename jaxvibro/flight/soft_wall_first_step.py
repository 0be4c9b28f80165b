"""Take the first step inside a stiff wall, which covers most of a half-oscillation.

All fast entries share one duration of this step. A mass that enters with the speed u, and is subject to a force p on
the displacement y past the wall, moves like y(t) = u G(t) + int G(t - s) p(s) ds. G is the response of y to a unit
speed: exp(-gamma2 t) sin(d t) / d with d^2 = 1 + k2 - gamma2^2. While p >= -P, y >= u G - P int G. Because G' / G
decreases, the ratio (int G) / G increases up to the time pi / d. Hence u > P (int G) / G at the end of the step
certifies that the mass is still inside.
"""

import math
from functools import reduce
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Float

from ..compiled.lane_arithmetic import choose
from . import flow
from .wall_motion import wall_derivative_bounds

STEP_SHARE = 0.9  # fraction of the half-oscillation; the exit is then closer than the longest step
MAX_DAMPING_SHARE = 0.5  # largest ratio damping^2 / stiffness for which such a step exists
N_DOUBLINGS = 3  # doublings of a flow step with the rates d and 2 gamma2; STEP_SHARE pi sqrt(2) sqrt(2) < 2^3
SAFETY_MARGIN = 1.01  # factor on the speed that certifies a step


class FirstStepInWall(NamedTuple):
    """First step after an entry, of a fixed duration.

    Attributes
    ----------
    time : array
        Duration.
    speed_per_force : array
        Ratio (int G) / G at the end of the step, with a safety margin. Infinite if the wall has no such step.
    force_change_bound : array
        Bound on the change of the force on y within the step.
    free_flow : tuple of array
        Matrix of the free flow, see `flow.doubling_responses`.
    forced_flow : tuple
        Motion under the first drive term.
    drive_rotation : tuple of array
        Cosine less 1 and sine of the drive angle over the step.
    harmonic_flows : tuple
        Motion under each of the `motion_in_soft_wall.harmonic_forces`.
    """

    time: Float[jax.Array, "..."]
    speed_per_force: Float[jax.Array, "..."]
    force_change_bound: Float[jax.Array, "..."]
    free_flow: flow.FreeFlow
    forced_flow: flow.ForcedFlow
    drive_rotation: tuple[Float[jax.Array, "..."], Float[jax.Array, "..."]]
    harmonic_flows: tuple[flow.ForcedFlow, ...]


def make_first_step_in_wall(wall, amplitude, frequency, drive_terms, total_stiffness, series, series_and_rates):
    """Return the `FirstStepInWall` of a soft wall.

    `series` belongs to the flow inside the wall, whose stiffness is 1 + k2. `series_and_rates` is a list of
    (series of the flow, angular rate) for each of the `motion_in_soft_wall.harmonic_forces`."""
    damping = wall.damping
    max_frequency = reduce(jnp.maximum, (rate for _, rate in series_and_rates), frequency)
    is_underdamped = (damping * damping < MAX_DAMPING_SHARE * total_stiffness) & (
        max_frequency < jnp.sqrt(total_stiffness)
    )
    time = STEP_SHARE * math.pi / jnp.sqrt(choose(is_underdamped, total_stiffness - damping * damping, total_stiffness))
    (free_flow, forced_flow, drive_rotation), *harmonic_responses = (
        flow.fixed_doubling_responses(flow_series, rate, damping, time, total_stiffness, N_DOUBLINGS)
        for flow_series, rate in ((series, frequency), *series_and_rates)
    )
    speed_per_force = SAFETY_MARGIN * (1.0 - free_flow[0]) / (total_stiffness * free_flow[1])
    speed_per_force = choose(is_underdamped, speed_per_force, jnp.full_like(speed_per_force, jnp.inf))
    force_change_bound = wall_derivative_bounds(wall, amplitude, frequency, damping, 1, drive_terms)[0] * time
    harmonic_flows = tuple(harmonic_flow for _, harmonic_flow, _ in harmonic_responses)
    return FirstStepInWall(
        time, speed_per_force, force_change_bound, free_flow, forced_flow, drive_rotation, harmonic_flows
    )


def is_first_step_certified(first_step, entry_speed, inward_force):
    """Return True if the first step certainly ends inside the wall, given speed of entry and force into the wall."""
    outward_force = first_step.force_change_bound - inward_force
    return entry_speed > first_step.speed_per_force * choose(outward_force > 0, outward_force, 0.0)
