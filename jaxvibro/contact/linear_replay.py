"""Replay of a contact phase within a soft wall with a spring and a damper, for derivatives (`impact_replay`).

The duration of a long contact phase is computed and is constant under differentiation. Taylor polynomials shift the end
of the phase by a delay that is 0 and has derivatives. The duration of a short contact phase has derivatives
(`contact_duration.solve_contact_end`).
"""

from jax import lax

from ..compiled.lane_arithmetic import choose
from ..flight import flow, motion_in_soft_wall, taylor_polynomials
from ..flight.motion_in_soft_wall import is_inside_soft_wall
from ..flight.taylor_polynomials import ExpansionPoint
from ..scene.state import Contact
from . import initial_contact
from .contact_duration import MEMORY_STEPS, linear_contact_duration, solve_contact_end
from .end_time_and_contact import exits_wall_before_end


def replay_initial_contact(coeffs, current_state, start_contact_code, path_end, order):
    """Return (state at the exit or at the end of the path, None) of lanes that start within a soft wall."""
    contact_code, relative_displacement, relative_velocity = initial_contact.initial_relative_state(
        coeffs, current_state, start_contact_code, order
    )
    return _propagate_in_wall(
        coeffs,
        current_state,
        contact_code,
        relative_displacement,
        relative_velocity,
        *_duration_and_exit_mask(
            coeffs, contact_code, relative_displacement, relative_velocity, current_state, path_end
        ),
        order,
    ), None


def complete_pending_contact(coeffs, current_state, pending_contact, path_end, order):
    """Return the state unchanged, because no contact phase is pending."""
    return current_state


def replay_wall_entry(coeffs, current_state, side, entry_delay, path_end, order):
    """Return (state at the exit or at the end of the path, None) of lanes that enter a soft wall after a delay.

    `side` is the side of the wall, 0 without an entry. Lanes at a rigid wall are unchanged.
    """
    contact_code = choose(motion_in_soft_wall.is_soft_side(coeffs, side), side * Contact.ENTERED, 0.0)
    _, wall_velocity = taylor_polynomials.wall_state(
        taylor_polynomials.wall_derivatives(coeffs, current_state, side, order), entry_delay, order
    )
    entry_velocity = (
        taylor_polynomials.evaluate_taylor(
            coeffs.flow.jet_at_point(coeffs, current_state, order)[1:], entry_delay, order
        )
        - wall_velocity
    )
    drive_cosine, drive_sine = _advance_drive_and_time(coeffs, current_state, entry_delay)[2:4]
    zero = lax.full_like(entry_velocity, 0.0)
    contact_duration, exits_wall = _duration_and_exit_mask(
        coeffs, contact_code, zero, entry_velocity, current_state, path_end
    )
    contact_coeffs = motion_in_soft_wall.coeffs_by_lane(coeffs, contact_code)
    extra_force_derivs = motion_in_soft_wall.frame_force_derivs(
        coeffs, contact_code, current_state.cosine, current_state.sine, order
    )
    long_contact_state = _propagate_in_wall(
        coeffs,
        current_state,
        contact_code,
        *contact_coeffs.flow.state_before_delay(
            contact_coeffs, current_state, zero, entry_velocity, entry_delay, order, extra_force_derivs
        ),
        contact_duration,
        exits_wall,
        order,
    )
    is_short_contact = exits_wall & (contact_duration < MEMORY_STEPS * contact_coeffs.max_step)
    entry_arguments = (
        choose(is_short_contact, side, 0.0),
        drive_cosine,
        drive_sine,
        choose(is_short_contact, side * entry_velocity, 1.0),
    )
    short_contact_state = _state_after_contact(
        coeffs,
        current_state,
        entry_delay,
        contact_duration,
        solve_contact_end(coeffs, *entry_arguments, choose(is_short_contact, contact_duration, 0.0), order),
        side,
        order,
    )
    return ExpansionPoint(
        *(
            choose(is_short_contact, short_contact_value, long_contact_value)
            for short_contact_value, long_contact_value in zip(short_contact_state, long_contact_state, strict=True)
        )
    ), None


def _duration_and_exit_mask(coeffs, contact_code, relative_displacement, relative_velocity, current_state, path_end):
    """Return (duration of the contact phase without derivatives, at most until the path ends; mask of exits)."""
    time_remaining = path_end.time - current_state.time
    contact_duration = linear_contact_duration(
        *lax.stop_gradient(
            (
                coeffs,
                contact_code,
                relative_displacement,
                relative_velocity,
                current_state.cosine,
                current_state.sine,
                time_remaining,
            )
        )
    )
    contact_duration = lax.stop_gradient(choose(is_inside_soft_wall(contact_code), contact_duration, 0.0))
    exits_wall = exits_wall_before_end(coeffs, path_end, current_state, contact_code, contact_duration)
    return choose(is_inside_soft_wall(contact_code) & ~exits_wall, time_remaining, contact_duration), exits_wall


def _state_after_contact(coeffs, current_state, delay, contact_duration, contact_end, side, order):
    """Return the state after a contact phase with a delayed entry; `contact_duration` is the duration as a constant."""
    exit_state = _advance_drive_and_time(coeffs, current_state, contact_duration)
    delay = delay + (contact_end.time - contact_duration)
    wall_position, wall_velocity = taylor_polynomials.wall_state(
        taylor_polynomials.wall_derivatives(coeffs, exit_state, side, order), delay, order
    )
    x, v = coeffs.flow.state_before_delay(
        coeffs, exit_state, wall_position, wall_velocity + contact_end.v, delay, order
    )
    return exit_state._replace(x=x, v=v)


def _advance_drive_and_time(coeffs, current_state, duration):
    """Return the state with the drive phase and the time advanced by a duration."""
    drive_cosine, drive_sine = flow.rotate_phasor_by_angle(
        current_state.cosine, current_state.sine, coeffs.frequency * duration
    )
    return current_state._replace(cosine=drive_cosine, sine=drive_sine, time=current_state.time + duration)


def _propagate_in_wall(
    coeffs, current_state, contact_code, relative_displacement, v, contact_duration, exits_wall, order
):
    """Advance lanes within a wall by `contact_duration`, to the exit from the wall or to the end of the path."""
    is_within_wall = is_inside_soft_wall(contact_code)
    contact_coeffs = motion_in_soft_wall.coeffs_by_lane(coeffs, contact_code)
    relative_displacement, v = motion_in_soft_wall.apply_response(
        contact_coeffs,
        contact_code,
        motion_in_soft_wall.contact_response(contact_coeffs, contact_code, contact_duration),
        (relative_displacement, v),
        current_state.cosine,
        current_state.sine,
    )
    relative_end_state = _advance_drive_and_time(coeffs, current_state, contact_duration)._replace(
        x=relative_displacement, v=v
    )
    relative_jet = _relative_jet(coeffs, contact_coeffs, contact_code, relative_end_state, order)
    jet_for_exit_root = [relative_jet[0], choose(exits_wall, relative_jet[1], 1.0), *relative_jet[2 : order + 1]]
    exit_delay = choose(exits_wall, taylor_polynomials.locate_root_near_zero(jet_for_exit_root, order), 0.0)
    x, v = _absolute_state(coeffs, relative_end_state, contact_code, relative_jet, exit_delay, order)
    xv_after_exit = coeffs.flow.state_before_delay(coeffs, relative_end_state, x, v, exit_delay, order)
    x, v = choose(exits_wall, xv_after_exit[0], x), choose(exits_wall, xv_after_exit[1], v)
    return ExpansionPoint(
        *(
            choose(is_within_wall, new, old)
            for new, old in zip((x, v, *relative_end_state[2:]), current_state, strict=True)
        )
    )


def _relative_jet(coeffs, contact_coeffs, contact_code, relative_state, order):
    """Return the displacement relative to the wall and its time derivatives up to `order` + 1."""
    return contact_coeffs.flow.jet_at_point(
        contact_coeffs,
        relative_state,
        order,
        motion_in_soft_wall.frame_force_derivs(coeffs, contact_code, relative_state.cosine, relative_state.sine, order),
    )


def _absolute_state(coeffs, current_state, contact_code, relative_jet, delay, order):
    """Return (x, v) after a delay for a mass within a wall; `relative_jet` is the result of `_relative_jet`."""
    wall_position, wall_velocity = taylor_polynomials.wall_state(
        taylor_polynomials.wall_derivatives(coeffs, current_state, contact_code, order), delay, order
    )
    return wall_position + taylor_polynomials.evaluate_taylor(
        relative_jet, delay, order
    ), wall_velocity + taylor_polynomials.evaluate_taylor(relative_jet[1:], delay, order)


def state_after_delay(coeffs, current_state, contact_code, free_flight_state, delay, order):
    """Return (x, v) after a delay; see `rigid.state_after_delay`."""
    inner_contact_code = choose(is_inside_soft_wall(contact_code), contact_code, 0.0)
    contact_coeffs = motion_in_soft_wall.coeffs_by_lane(coeffs, inner_contact_code)
    wall_position, wall_velocity = taylor_polynomials.wall_state(
        taylor_polynomials.wall_derivatives(coeffs, current_state, inner_contact_code, order), 0.0 * delay, order
    )
    relative_jet = _relative_jet(
        coeffs,
        contact_coeffs,
        inner_contact_code,
        current_state._replace(x=current_state.x - wall_position, v=current_state.v - wall_velocity),
        order,
    )
    contact_state = _absolute_state(coeffs, current_state, inner_contact_code, relative_jet, delay, order)
    return tuple(
        choose(is_inside_soft_wall(inner_contact_code), contact_value, free_value)
        for contact_value, free_value in zip(contact_state, free_flight_state, strict=True)
    )
