"""A contact of one file: inside the wall the depth obeys d'' = -c, whatever moves the mass outside.

The wall has a `Buffer` of a number c. `test_kinds` registers the contact for this class of laws.
"""

from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

import jaxvibro as jv
from jaxvibro.contact import force_law, phase_ends, phase_maps
from jaxvibro.contact.end_time_and_contact import exits_wall_before_end
from jaxvibro.contact.force_law import initial_waiting_steps, path_of_stepping_lanes  # noqa: F401
from jaxvibro.contact.initial_contact import initial_relative_state as initial_phase
from jaxvibro.contact.phase_ends import ContactResult, side_of_contact
from jaxvibro.contact.phase_maps import ContactExit, max_contact_step, max_oscillation_rate  # noqa: F401
from jaxvibro.contact.rigid import (  # noqa: F401
    advance_motion,
    frame_force,
    is_linear,
    max_step,
    prepare_step,
    rates,
    target_wall,
)
from jaxvibro.contact.wall_at_contact import wall_derivatives
from jaxvibro.flight import flow, taylor_polynomials
from jaxvibro.flight.flight_state import reduce_time_remaining
from jaxvibro.flight.motion_in_soft_wall import is_inside_soft_wall as inside_mask
from jaxvibro.flight.motion_in_soft_wall import is_soft_side
from jaxvibro.flight.path_start import start_at_soft_wall as start_at_wall  # noqa: F401
from jaxvibro.flight.taylor_polynomials import ExpansionPoint
from jaxvibro.flight.wall_motion import select_by_side
from jaxvibro.scene.state import Contact

CODE_AFTER_IMPACT: int = Contact.WITHIN


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Buffer(jv.Push):
    """A wall that decelerates the mass by c; of a `Push`, the function is not evaluated."""


def no_function(depth, depth_rate, numbers):
    return 0.0 * depth * numbers["c"]


# a wall
def wall_fields(scene, side, as_array):
    return {"restitution": None, "law": jax.tree.map(as_array, getattr(scene, side).law)}


def is_valid_wall(wall):
    return wall.law.numbers["c"] > 0


def require_reversible(scene, side):
    pass


def reverse_wall(wall):
    return wall


wall_flow = force_law.wall_flow


def reverse_wall_flow(coeffs, wall, wall_flow):
    return wall


def wall_force(scene, side, depth, depth_rate, v):
    return np.full(np.shape(depth), np.nan)


def grazing_exponent(wall):
    return 0.5


def _deceleration(coeffs, side):
    """Return c of the wall on a side; 1 for a rigid wall."""
    values = [1.0 if wall.law is None else wall.law.numbers["c"] for wall in coeffs.walls]
    return select_by_side(side, coeffs.walls, values) + 0.0 * side


def _time_to_exit(c, depth, rate):
    """Return the time to the exit, with derivatives also where the mass has just entered."""
    return (rate + jnp.sqrt(rate * rate + 2.0 * c * depth)) / c


def _motion(c, depth, rate, time):
    return depth + time * (rate - 0.5 * c * time), rate - c * time


def _phase_end(c, depth, rate, available_time, exits):
    """Return the `ContactResult` of phases that exit where `exits` is true."""
    time = _time_to_exit(c, depth, rate)
    end_depth, end_rate = _motion(c, depth, rate, available_time)
    return ContactResult(
        exits,
        jnp.where(exits, time, available_time),
        jnp.where(exits, 0.0, end_depth),
        jnp.where(exits, rate - c * time, end_rate),
    )


def _start(coeffs, contact_code, displacement, velocity):
    """Return (mask of the lanes inside, side, c, depth, rate); lanes outside get placeholders."""
    is_inside, side = inside_mask(contact_code), side_of_contact(contact_code)
    depth, rate = jnp.where(is_inside, side * displacement, 0.0), jnp.where(is_inside, side * velocity, 1.0)
    return is_inside, side, _deceleration(coeffs, side), depth, rate


# a step
def advance_waiting_lanes(coeffs, path, n_waiting_steps, is_any_lane_due, is_loop_idle):
    is_inside, side, c, depth, rate = _start(coeffs, path.contact, path.x, path.v)
    exits = _time_to_exit(c, depth, rate) <= path.time_remaining
    end = _phase_end(c, depth, rate, path.time_remaining, exits)
    phasor = flow.rotate_phasor_by_angle(path.cosine, path.sine, coeffs.frequency * end.duration)
    new_path = phase_ends.path_after_contact(coeffs, path, side, exits, end.depth, end.depth_rate, *phasor)
    time_remaining, low_part = reduce_time_remaining(path, end.duration)
    new_path = new_path._replace(
        time_remaining=jnp.where(exits, time_remaining, 0.0), time_remaining_low_part=jnp.where(exits, low_part, 0.0)
    )
    is_due = is_inside & (path.time_remaining > 0)
    return jax.tree.map(partial(jnp.where, is_due), new_path, path), 0.0 * n_waiting_steps


# replay, matrix and duration
def contact_duration(
    coeffs, contact_code, relative_displacement, relative_velocity, drive_cosine, drive_sine, max_duration
):
    _, _, c, depth, rate = _start(coeffs, contact_code, relative_displacement, relative_velocity)
    return jnp.minimum(_time_to_exit(c, depth, rate), max_duration)


def replay_initial_contact(coeffs, current_state, start_contact_code, path_end, order):
    code, displacement, velocity = initial_phase(coeffs, current_state, start_contact_code, order)
    is_inside, _, c, depth, rate = _start(coeffs, code, displacement, velocity)
    is_at_entry = is_inside & (lax.stop_gradient(depth) <= 0)
    delay = jnp.where(is_at_entry, -depth / rate, 0.0)
    return current_state, (code, jnp.where(is_at_entry, 0.0, depth), rate - c * delay, delay)


def replay_wall_entry(coeffs, current_state, side, entry_delay, path_end, order):
    is_entry = is_soft_side(coeffs, side)
    wall_side = jnp.where(is_entry, side, float(coeffs.walls[0].sign))
    rate = phase_ends.entry_rate(coeffs, current_state, wall_side, entry_delay, order)
    code, zero = jnp.where(is_entry, side * Contact.ENTERED, 0.0), 0.0 * rate
    return current_state, (code, zero, jnp.where(is_entry, rate, 1.0), jnp.where(is_entry, entry_delay, 0.0))


def complete_pending_contact(coeffs, current_state, pending_contact, path_end, order):
    code, depth, rate, delay = pending_contact
    is_inside, side = inside_mask(code), side_of_contact(code)
    c, time_remaining = _deceleration(coeffs, side), path_end.time - current_state.time
    duration = lax.stop_gradient(jnp.minimum(_time_to_exit(c, depth, rate), time_remaining))
    exits = exits_wall_before_end(coeffs, path_end, current_state, code, duration)
    end = _phase_end(c, depth, rate, time_remaining - delay, exits)
    point = phase_ends.point_after_contact(coeffs, current_state, side, end, delay, time_remaining, order)
    return ExpansionPoint(*(jnp.where(is_inside, *pair) for pair in zip(point, current_state, strict=True)))


def state_after_delay(coeffs, current_state, contact_code, free_flight_state, delay, order):
    is_inside, side = inside_mask(contact_code), side_of_contact(contact_code)
    wall_derivs = taylor_polynomials.wall_derivatives(coeffs, current_state, side, order)
    (position, velocity), (later_position, later_velocity) = (
        taylor_polynomials.wall_state(wall_derivs, time, order) for time in (0.0 * delay, delay)
    )
    depth, rate = side * (current_state.x - position), side * (current_state.v - velocity)
    depth, rate = _motion(_deceleration(coeffs, side), depth, rate, delay)
    inner_state = later_position + side * depth, later_velocity + side * rate
    return tuple(jnp.where(is_inside, *pair) for pair in zip(inner_state, free_flight_state, strict=True))


def _effect(coeffs, relative_state, is_entry_from_outside, path_end, current_state):
    is_inside, side, c, depth, rate = _start(coeffs, *relative_state)
    is_at_entry = is_inside & (lax.abs(relative_state[0]) == Contact.ENTERED)
    time_remaining = jnp.where(is_inside, path_end.time - current_state.time, 0.0)
    duration = jnp.minimum(_time_to_exit(c, depth, rate), time_remaining)
    exits = exits_wall_before_end(coeffs, path_end, current_state, relative_state[0], duration)
    phasor = current_state.cosine, current_state.sine
    acceleration = phase_ends.force_free_acceleration(coeffs, side, rate, *phasor)
    acceleration = jnp.where(is_entry_from_outside, acceleration, -c)

    def end_after_perturbation(depth_change, rate_change):
        delay = jnp.where(is_at_entry, -depth_change / rate, 0.0)
        new_depth = jnp.where(is_at_entry, 0.0, depth + depth_change)
        end = _phase_end(c, new_depth, rate + rate_change + acceleration * delay, time_remaining - delay, exits)
        return delay + end.duration, end.depth, end.depth_rate

    return phase_ends.effect_of_phase(coeffs, side, exits, end_after_perturbation, *phasor)


propagate_contact_phase = partial(phase_ends.propagate_contact_phase, _effect)


# equations of orbits
def _exit(coeffs, is_soft, side, cosine, sine, speed):
    side = jnp.where(is_soft, side, float(coeffs.walls[0].sign))
    c, zero = _deceleration(coeffs, side), 0.0 * speed
    phasor = flow.rotate_phasor_by_angle(cosine, sine, coeffs.frequency * 2.0 * speed / c)
    return ContactExit(2.0 * speed / c, -speed, *phasor, (1.0 + zero, 2.0 / c + zero, zero, zero - 1.0))


complete_contact_map = partial(phase_maps.complete_contact_map, partial(phase_maps.exit_map, _exit))
saltation = partial(phase_maps.saltation, phase_maps.contact_matrix)


def state_in_contact(coeffs, contact_map, sides, row_indices, elapsed_time, free_state):
    is_inside = contact_map.is_soft[row_indices] & (elapsed_time < contact_map.contact_time[row_indices])
    side, time = sides[row_indices], jnp.where(is_inside, elapsed_time, 0.0)
    rate = side * contact_map.approach_velocity[row_indices]
    depth, rate = _motion(_deceleration(coeffs, jnp.where(is_inside, side, 1.0)), 0.0, rate, time)
    angle = coeffs.frequency * time
    phasor = flow.rotate_phasor_by_angle(contact_map.cosine[row_indices], contact_map.sine[row_indices], angle)
    position, velocity, _ = wall_derivatives(coeffs, side, *phasor)
    inner_state = position + side * depth, velocity + side * rate
    return tuple(jnp.where(is_inside, *pair) for pair in zip(inner_state, free_state, strict=True))
