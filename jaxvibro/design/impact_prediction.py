"""Compute the impacts that follow an impact, forward or backward in time, and the clearances of flights.

The impacts are the events of certified flights, as in `strobe`. Backward in time the flights are those of the inverse
map (`strobe_inverse`). The time of an impact on a soft wall is the time of entry.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax

from continuation.hostcall import FAST_COMPILE, persistent_jit

from ..contact.kinds import contact_of_wall, flow_coefficients, flow_of_scene, make_flow_coefficients
from ..contact.wall_at_contact import wall_derivatives
from ..flight.flight_step import certified_step
from ..flight.integration_loop import loop_limits
from ..flight.motion_in_soft_wall import is_inside_soft_wall, is_soft_side, restitution_of
from ..flight.path_start import start_path
from ..maps.strobe_inverse import reversed_coefficients
from ..orbits import flight_clearance
from ..orbits.contact_maps import evaluate_contact_map
from ..scene import check
from ..scene.scene import SIDES, replace_unchecked
from ..scene.state import Contact, State, Status
from .shape_padding import pad_to_power_of_two


class Impact(NamedTuple):
    """Impact of the mass on a wall.

    Attributes
    ----------
    side : float
        Side of the wall, -1 left, 1 right.
    time : float
        Time of the impact.
    speed : float
        Speed before the impact, relative to the wall.
    """

    side: float
    time: float
    speed: float


def next_impacts(scene, start_phase, impact, end_time, max_impacts, time_direction=1):
    """Return the impacts that follow an impact, forward or backward in time.

    Parameters
    ----------
    scene : Scene
        Single scene with spring and damper.
    start_phase : float
        Phase of the drive at time 0.
    impact : Impact
        The impact.
    end_time : float
        Time of the latest impact, or of the earliest impact backward in time.
    max_impacts : int
        Largest number of impacts.
    time_direction : {1, -1}, optional
        1 forward, -1 backward in time.

    Returns
    -------
    list of Impact
        The impacts, up to an onset of sticking. Backward in time the list ends at an impact on a wall with restitution
        0, whose speed does not follow from the motion after it. It is empty if the damping between the walls or inside
        a soft wall is critical or larger.
    """
    inelastic_sides = [side for side in scene.walls if time_direction < 0 and scene.bounce(side) == 0]
    if SIDES[int(impact.side > 0)] in inelastic_sides or (time_direction < 0 and not _is_reversible(scene)):
        return []
    n_rows = len(pad_to_power_of_two(np.zeros(max_impacts)))
    rows = _simulate_impacts(
        replace_unchecked(scene, {f"{side}.restitution": 1.0 for side in inelastic_sides}),
        start_phase + float(scene.frequency) * impact.time,
        impact.side,
        impact.speed,
        (end_time - impact.time) * time_direction,
        max_impacts,
        n_rows,
        time_direction,
    )
    impacts: list[Impact] = []
    for side, elapsed_time, speed in np.asarray(rows).tolist():
        if not side:
            break
        impacts.append(Impact(side, impact.time + time_direction * elapsed_time, speed))
        if SIDES[int(side > 0)] in inelastic_sides:
            break
    return impacts


def _is_reversible(scene):
    """Return True if the motion between the walls and inside soft walls can be reversed in time."""
    try:
        flow_of_scene(scene).require_reversible(scene)
        for side in scene.soft_sides:
            contact_of_wall(scene, side).require_reversible(scene, side)
    except check.ArgumentError:
        return False
    return True


@persistent_jit(static_argnums=(6, 7), compiler_options=FAST_COMPILE, numpy_first=True)
def _simulate_impacts(scene, phase, side, speed, duration, max_impacts, n_rows, time_direction):
    """Return rows (side, elapsed time, speed) of the impacts after an impact at a phase; empty rows have the side 0."""
    is_forward = time_direction > 0
    coeffs, phase = (
        make_flow_coefficients(scene) if is_forward else reversed_coefficients(scene),
        time_direction * phase,
    )
    wall_position, wall_velocity = wall_derivatives(coeffs, side, jnp.cos(phase), jnp.sin(phase), 1)
    # The state after the impact, and backward in time the state before the impact with time reversed.
    restitution = restitution_of(coeffs, side) if is_forward else jnp.ones_like(wall_position)
    contact = jnp.where(restitution < 0, Contact.WITHIN, Contact.LANDED)
    state = State(wall_position, wall_velocity - restitution * side * speed, phase, side * contact)
    path, status = start_path(coeffs, state, lambda coeffs: (True, True))  # the fit has checked the scene
    path = path._replace(time_remaining=jnp.where(status == Status.OK, duration, 0.0))
    max_steps = loop_limits(coeffs, 1).max_steps * (1.0 + duration / coeffs.period)

    def is_running(carry):
        path, _, n_impacts, n_steps = carry
        is_sticking = abs(path.contact) == Contact.STUCK
        return (path.time_remaining > 0) & ~is_sticking & (n_impacts < max_impacts) & (n_steps < max_steps)

    def advance_path(carry):
        path, rows, n_impacts, n_steps = carry
        step = certified_step(coeffs, path)
        # Backward in time the entry into a soft wall is the exit of the reversed motion.
        is_entry = ~is_soft_side(coeffs, step.side) | (is_inside_soft_wall(path.contact) != is_forward)
        is_impact = (step.side != 0) & is_entry
        approach_speed = step.event_outcome.approach_speed
        row = (
            step.side,
            duration - step.path.time_remaining,
            approach_speed if is_forward else restitution_of(coeffs, step.side) * approach_speed,
        )
        rows = rows.at[jnp.where(is_impact, n_impacts, n_rows)].set(jnp.stack(row), mode="drop")
        return step.path, rows, n_impacts + is_impact, n_steps + 1.0

    initial_carry = path, jnp.zeros((n_rows, 3), scene.dtype), jnp.int32(0), 0.0 * max_steps
    return lax.while_loop(is_running, advance_path, initial_carry)[1]


def min_clearances(scene, start_phase, nodes):
    """Return arrays (clearance, side, time) of the smallest clearance of each flight between impacts.

    A negative clearance is a penetration. The clearance is inf without a turning point during the flight, and -inf if
    the contact phase before the flight does not end. `start_phase` is the phase of the drive at time 0.
    """
    padded_results = _min_clearances(scene, start_phase, *map(pad_to_power_of_two, nodes))
    return tuple(np.asarray(padded_result)[: len(nodes.sides) - 1] for padded_result in padded_results)


@persistent_jit(compiler_options=FAST_COMPILE, numpy_first=True)
def _min_clearances(scene, start_phase, sides, times, speeds):
    """Compute the arrays of `min_clearances` for padded nodes."""
    coeffs = flow_coefficients(scene)
    phases = start_phase + coeffs.frequency * times
    contact_map = evaluate_contact_map(coeffs, sides, jnp.cos(phases), jnp.sin(phases), speeds)
    start_times = times if contact_map.contact_time is None else times + contact_map.contact_time
    flight_times = jnp.where(jnp.isfinite(start_times), jnp.maximum(jnp.roll(times, -1) - start_times, 0.0), 0.0)
    flights = flight_clearance.Flight(flight_times, *contact_map.state, *contact_map.phasor)
    clearances, turning_times = flight_clearance.turning_clearances(
        coeffs, flights, flight_clearance.sample_count(coeffs, flights)
    )
    flight_indices, wall_indices = jnp.arange(len(sides)), jnp.argmin(clearances, axis=1)
    return (
        jnp.where(jnp.isfinite(start_times), clearances[flight_indices, wall_indices], -jnp.inf),
        jnp.array([float(wall.sign) for wall in coeffs.walls])[wall_indices],
        start_times + turning_times[flight_indices, wall_indices],
    )
