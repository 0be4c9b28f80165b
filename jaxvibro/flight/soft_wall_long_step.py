"""Take long steps inside a soft wall.

A long step covers most of a contact phase (`soft_wall_first_step`) or many oscillations of the mass on the wall's
spring. Inside a wall the displacement y past the wall is the sum of a slow and a fast part. The slow part is the forced
motion and, in an overdamped wall, the slowly decaying mode. The energy of the fast part w decreases, so that ``|w|``
never exceeds B = sqrt(w^2 + w'^2 / (1 + k2)). In an overdamped wall w is the rapidly decaying mode, and B is its
initial magnitude. While the slow part exceeds B the mass cannot exit. The certificates are those of
`event_certificates`, with the time scale of the slow part. The flow over a long step is exact."""

from typing import NamedTuple

import jax
from jax import lax
from jaxtyping import Float

from ..compiled.lane_arithmetic import bit_mask, call_without_inlining, choose, merge_bits, minimum, positive_part
from ..scene.state import Contact
from . import event_certificates, flow, further_drive_terms, motion_in_soft_wall
from .flight_state import SlowMotion, reduce_time_remaining
from .power_series import add_coefficients
from .soft_wall_first_step import is_first_step_certified

MIN_SHORT_STEPS = 8.0  # number of short steps before a long step is tried
MIN_STEP_RATIO = 4.0  # least ratio of a long to a short step
MIN_STIFFNESS_RATIO = 4.0  # times the square of the largest slow rate; at lower stiffness all motion is slow
OVERDAMPED_RATIO = 2.0  # least ratio damping^2 / stiffness at which the two decay rates are separated


class HarmonicMotionPart(NamedTuple):
    """Part of a slow motion: the real part of (a + i b) exp(i omega t).

    Attributes
    ----------
    real : array
        Real part a of the amplitude.
    imaginary : array
        Imaginary part b of the amplitude.
    rate : array
        Angular frequency omega.
    """

    real: Float[jax.Array, "..."]
    imaginary: Float[jax.Array, "..."]
    rate: Float[jax.Array, "..."]

    @property
    def size(self) -> Float[jax.Array, "..."]:
        """Bound on the magnitude."""
        return lax.abs(self.real) + lax.abs(self.imaginary)

    def values(self, n_values: int) -> list[Float[jax.Array, "..."]]:
        """Return the value and its first derivatives at t = 0, `n_values` numbers in all."""
        derivatives, (real, imaginary) = [], (self.real, self.imaginary)
        for _ in range(n_values):
            derivatives.append(real)
            real, imaginary = -self.rate * imaginary, self.rate * real
        return derivatives


class DecayingMotionPart(NamedTuple):
    """Part of a slow motion: a exp(-lambda t).

    Attributes
    ----------
    real : array
        Amplitude a.
    rate : array
        Decay rate lambda.
    """

    real: Float[jax.Array, "..."]
    rate: Float[jax.Array, "..."]

    @property
    def size(self) -> Float[jax.Array, "..."]:
        """Bound on the magnitude."""
        return lax.abs(self.real)

    def values(self, n_values: int) -> list[Float[jax.Array, "..."]]:
        """Return the value and its first derivatives at t = 0, `n_values` numbers in all."""
        derivatives = [self.real]
        while len(derivatives) < n_values:
            derivatives.append(-self.rate * derivatives[-1])
        return derivatives


def take_first_step_in_wall(coeffs, path):
    """Return the path after the first step of lanes that have just entered a stiff wall with sufficient speed.

    `coeffs` are the coefficients of each lane, see `motion_in_soft_wall.coeffs_by_lane`.
    """
    first_step_mask = call_without_inlining(_first_step_mask, coeffs, path)
    next_phasor = call_without_inlining(_phasor_after_first_step, coeffs, path)
    x, v = call_without_inlining(_state_after_first_step, coeffs, path)
    next_time_remaining = call_without_inlining(_time_after_first_step, coeffs, path)
    next_values = x, v, x, v, *next_phasor, *next_time_remaining, lax.sign(path.contact) * Contact.WITHIN
    values = path.x, path.v, path.motion.slow_x, path.motion.slow_v, path.cosine, path.sine
    values = *values, path.time_remaining, path.time_remaining_low_part, path.contact
    x, v, slow_x, slow_v, cosine, sine, time_remaining, time_remaining_low_part, contact = (
        merge_bits(first_step_mask, *pair) for pair in zip(next_values, values, strict=True)
    )
    motion = path.motion._replace(slow_x=slow_x, slow_v=slow_v, cosine=cosine, sine=sine)
    return path._replace(
        x=x,
        v=v,
        motion=motion,
        time_remaining=time_remaining,
        time_remaining_low_part=time_remaining_low_part,
        contact=contact,
    )


def _first_step_mask(coeffs, path):
    """Return the bit mask of the lanes that take the first step after an entry."""
    first_step, side = motion_in_soft_wall.first_steps_by_lane(coeffs, path.contact), lax.sign(path.contact)
    drive_force = coeffs.amplitude * path.cosine
    extra_force = motion_in_soft_wall.frame_force_derivs(coeffs, path.contact, path.cosine, path.sine, 0)
    (extra_force,) = further_drive_terms.add_term_derivatives(
        coeffs.drive_terms, coeffs.frequency, path.cosine, path.sine, extra_force
    )
    is_step_certified = is_first_step_certified(
        first_step, side * path.v, side * add_coefficients(drive_force, extra_force)
    )
    return bit_mask(
        (lax.abs(path.contact) == Contact.ENTERED) & is_step_certified & (path.time_remaining > first_step.time), path.x
    )


def _phasor_after_first_step(coeffs, path):
    """Return the phasor of the drive after the first step in the wall."""
    return flow.rotate_phasor(
        path.cosine, path.sine, *motion_in_soft_wall.first_steps_by_lane(coeffs, path.contact).drive_rotation
    )


def _state_after_first_step(coeffs, path):
    """Return (y, y') after the first step in the wall."""
    first_step = motion_in_soft_wall.first_steps_by_lane(coeffs, path.contact)
    contact_response = motion_in_soft_wall.ContactResponse(
        first_step.free_flow, first_step.forced_flow, first_step.harmonic_flows
    )
    return motion_in_soft_wall.apply_response(
        coeffs, path.contact, contact_response, (path.x, path.v), path.cosine, path.sine
    )


def _time_after_first_step(coeffs, path):
    """Return the remaining time and its low part after the first step in the wall."""
    return reduce_time_remaining(path, motion_in_soft_wall.first_steps_by_lane(coeffs, path.contact).time)


def is_long_step_due(path, n_waiting_steps):
    """Return the lanes that have waited long enough for a long step.

    Parameters
    ----------
    path : Path
        Path of the lanes.
    n_waiting_steps : array
        Number of steps since the entry or the last attempt at a long step.

    Returns
    -------
    array of bool
        True where a long step is due.
    """
    return (n_waiting_steps >= MIN_SHORT_STEPS) & (path.time_remaining > 0)


def advance_by_flow_series(coeffs, path, time):
    """Return (y, y') after a time, from the `flow.FlowSeries` of each lane."""
    return call_without_inlining(_advance_by_flow_series, coeffs, path, time)


def take_long_step(coeffs, path, n_waiting_steps, advance_lanes=advance_by_flow_series):
    """Take a long step in lanes for which one is due and exists.

    Parameters
    ----------
    coeffs : FlowCoefficients
        Coefficients of the scene.
    path : Path
        Path of the lanes.
    n_waiting_steps : array
        Number of steps since the entry or the last attempt at a long step.
    advance_lanes : callable, optional
        Function from (coefficients of each lane, path, time) to (y, y') after the time.

    Returns
    -------
    path : Path
        Path after the step.
    n_waiting_steps : array
        Number of steps, 0 in lanes for which a long step was due.
    """
    lane_coeffs = motion_in_soft_wall.coeffs_by_lane(coeffs, path.contact)
    is_due = is_long_step_due(path, n_waiting_steps)
    time = choose(
        is_due, minimum(call_without_inlining(_certified_time_in_wall, lane_coeffs, path), path.time_remaining), 0.0
    )
    takes_long_step = time > MIN_STEP_RATIO * lane_coeffs.max_step
    time = choose(takes_long_step, time, 0.0)
    angle = coeffs.frequency * time
    phasor = call_without_inlining(
        flow.rotate_phasor, path.cosine, path.sine, flow.cos_less_1(angle), flow.sin_by_series(angle)
    )
    x, v = advance_lanes(lane_coeffs, path, time)
    zero = lax.full_like(x, 0.0)
    next_motion = SlowMotion(x, zero, v, zero, *phasor)
    next_motion = SlowMotion(
        *(
            choose(takes_long_step, next_value, value)
            for next_value, value in zip(next_motion, path.motion, strict=True)
        )
    )
    time_remaining, time_remaining_low_part = reduce_time_remaining(path, time)
    side = lax.sign(path.contact)
    next_path = path._replace(
        x=choose(takes_long_step, x, path.x),
        x_low_part=choose(takes_long_step, 0.0, path.x_low_part),
        v=choose(takes_long_step, v, path.v),
        motion=next_motion,
        time_remaining=choose(takes_long_step, positive_part(time_remaining), path.time_remaining),
        time_remaining_low_part=choose(takes_long_step, time_remaining_low_part, path.time_remaining_low_part),
        contact=choose(takes_long_step, side * Contact.WITHIN, path.contact),
    )
    return next_path, choose(is_due, 0.0, n_waiting_steps)


def _certified_time_in_wall(coeffs, path):
    """Return a time for which the mass certainly remains inside its wall.

    The time is 0 if no certificate exists, for example if oscillations grow because time is reversed.
    """
    motion_parts = _forced_motion_parts(coeffs, path.contact, path.cosine, path.sine)
    stiffness, damping, side = coeffs.stiffness, coeffs.damping, lax.sign(path.contact)
    slow_displacement, slow_velocity = (
        sum(values) for values in zip(*(motion_part.values(2) for motion_part in motion_parts), strict=True)
    )
    fast_displacement, fast_velocity = path.x - slow_displacement, path.v - slow_velocity
    discriminant = damping * damping - stiffness
    is_overdamped = damping * damping > OVERDAMPED_RATIO * stiffness
    fast_decay_rate = damping + lax.sqrt(choose(is_overdamped, discriminant, 0.0))
    slow_decay_rate = choose(is_overdamped, stiffness / fast_decay_rate, 0.0)
    fast_mode_amplitude = (fast_velocity + slow_decay_rate * fast_displacement) / choose(
        is_overdamped, slow_decay_rate - fast_decay_rate, -1.0
    )
    slow_mode_amplitude = choose(is_overdamped, fast_displacement - fast_mode_amplitude, 0.0)
    fast_part_bound = choose(
        is_overdamped,
        lax.abs(fast_mode_amplitude),
        lax.sqrt(fast_displacement * fast_displacement + fast_velocity * fast_velocity / stiffness),
    )
    motion_parts = [*motion_parts, DecayingMotionPart(slow_mode_amplitude, slow_decay_rate)]
    max_rate = slow_decay_rate
    for motion_part in motion_parts[:-1]:
        max_rate = choose(motion_part.rate > max_rate, motion_part.rate, max_rate)
    max_step = flow.MAX_SCALED_STEP / max_rate
    taylor_weights = event_certificates.taylor_weights(max_step)
    slow_part_derivs = [
        sum(values)
        for values in zip(
            *(motion_part.values(event_certificates.N_TERMS) for motion_part in motion_parts), strict=True
        )
    ]
    polynomial_terms = [
        -(side * values) * weight for values, weight in zip(slow_part_derivs, taylor_weights, strict=False)
    ]
    polynomial_terms[0] = polynomial_terms[0] + fast_part_bound
    remainder_bound = (
        sum(motion_part.size * motion_part.rate**event_certificates.N_TERMS for motion_part in motion_parts)
        * taylor_weights[event_certificates.N_TERMS]
    )
    event_polynomial = event_certificates.EventPolynomial(tuple(polynomial_terms), remainder_bound)
    upper_cubic = event_certificates.make_upper_cubic(
        event_polynomial, event_certificates.cubic_coefficient_bound(event_polynomial)
    )
    safe_step = event_certificates.safe_step(upper_cubic)
    certified_step = event_certificates.safe_step_to_horizon(
        upper_cubic,
        event_certificates.certificate_horizon(upper_cubic, event_certificates.first_quadratic_root(*upper_cubic[:3])),
        safe_step,
    )
    is_stiff = stiffness > MIN_STIFFNESS_RATIO * max_rate * max_rate
    return choose((polynomial_terms[0] < 0) & is_stiff & (damping >= 0), certified_step * max_step, 0.0)


def _advance_by_flow_series(coeffs, path, time):
    """Return (y, y') after a time by doubling a short step of the flow."""
    contact_response = motion_in_soft_wall.contact_response(coeffs, path.contact, time)
    return motion_in_soft_wall.apply_response(
        coeffs, path.contact, contact_response, (path.x, path.v), path.cosine, path.sine
    )


def _forced_motion_parts(coeffs, contact, cosine, sine):
    """Return the `HarmonicMotionPart`s of y due to the drive and the wall, which diverge at undamped resonance.

    `coeffs` are the coefficients of each lane.
    """
    zero = 0.0 * cosine
    harmonic_forces = [(coeffs.amplitude * cosine, coeffs.amplitude * sine, coeffs.frequency + zero)]
    harmonic_forces += motion_in_soft_wall.harmonic_forces(coeffs, contact, cosine, sine)
    motion_parts = []
    for force_cos, force_sin, angular_rate in harmonic_forces:
        drag_coefficient, detuning = 2.0 * coeffs.damping * angular_rate, coeffs.stiffness - angular_rate * angular_rate
        denominator = detuning * detuning + drag_coefficient * drag_coefficient
        motion_parts.append(
            HarmonicMotionPart(
                (force_cos * detuning + force_sin * drag_coefficient) / denominator,
                (force_sin * detuning - force_cos * drag_coefficient) / denominator,
                angular_rate,
            )
        )
    mean_position, _ = motion_in_soft_wall.mean_position_increments(coeffs, contact, cosine, -1.0, zero)
    return [HarmonicMotionPart(mean_position, zero, zero), *motion_parts]
