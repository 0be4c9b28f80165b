"""Take long steps inside a soft wall.

A long step covers most of a contact phase (`soft_entry_step`) or many oscillations of the wall. Inside a wall y is the
sum of a slow and a fast part. The slow part is the forced motion and, in an overdamped wall, the slowly decaying mode.
The energy of the fast part w decreases, so that ``|w|`` never exceeds B = sqrt(w^2 + w'^2 / (1 + k2)). While the slow
part exceeds B the mass cannot leave. This is the certified step of `event` with the time scale of the slow part. The
flow over it is exact.
"""

from typing import NamedTuple

import jax
from jax import lax
from jaxtyping import Float

from ..compiled.compiler_hints import bit_mask, choose, merge_bits, minimum, positive_part, stage
from ..scene.codes import Contact
from . import drive, event, flow, soft_contact
from .flight_state import SlowMotion, subtract_time
from .soft_entry_step import is_certified

MIN_SHORT_STEPS = 8.0  # number of short steps before a long step is tried
MIN_STEP_RATIO = 4.0  # least ratio of a long to a short step
MIN_STIFFNESS_RATIO = 4.0  # times the square of the largest slow rate; at lower stiffness all motion is slow
OVERDAMPED_RATIO = 2.0  # least ratio damping^2 / stiffness at which the two decay rates are separated


class HarmonicPart(NamedTuple):
    """Part of a slow motion: the real part of (real + i imaginary) exp(i rate t)."""

    real: Float[jax.Array, "..."]
    imaginary: Float[jax.Array, "..."]
    rate: Float[jax.Array, "..."]

    @property
    def size(self) -> Float[jax.Array, "..."]:
        """Bound on the magnitude."""
        return lax.abs(self.real) + lax.abs(self.imaginary)

    def values(self, n_derivatives: int) -> list[Float[jax.Array, "..."]]:
        """Return the value and its derivatives at t = 0, n_derivatives numbers."""
        derivatives, (real, imaginary) = [], (self.real, self.imaginary)
        for _ in range(n_derivatives):
            derivatives.append(real)
            real, imaginary = -self.rate * imaginary, self.rate * real
        return derivatives


class DecayPart(NamedTuple):
    """Part of a slow motion: real exp(-rate t)."""

    real: Float[jax.Array, "..."]
    rate: Float[jax.Array, "..."]

    @property
    def size(self) -> Float[jax.Array, "..."]:
        """Bound on the magnitude."""
        return lax.abs(self.real)

    def values(self, n_derivatives: int) -> list[Float[jax.Array, "..."]]:
        """Return the value and its derivatives at t = 0, n_derivatives numbers."""
        derivatives = [self.real]
        while len(derivatives) < n_derivatives:
            derivatives.append(-self.rate * derivatives[-1])
        return derivatives


def take_entry_step(coeffs, path):
    """Return the path after the entry step of lanes that have just entered a stiff wall with sufficient speed.

    `coeffs` are those of each lane, see `soft_contact.coeffs_by_lane`.
    """
    mask = stage(_entry_step_mask, coeffs, path)
    next_phasor = stage(_phasor_after_entry, coeffs, path)
    x, v = stage(_state_after_entry, coeffs, path)
    next_remaining = stage(_remaining_after_entry, coeffs, path)
    next_values = x, v, x, v, *next_phasor, *next_remaining, lax.sign(path.contact) * Contact.WITHIN
    values = path.x, path.v, path.motion.slow_x, path.motion.slow_v, path.cosine, path.sine
    values = *values, path.time_remaining, path.time_remaining_low, path.contact
    x, v, slow_x, slow_v, cosine, sine, time_remaining, time_remaining_low, contact = (
        merge_bits(mask, *pair) for pair in zip(next_values, values, strict=True)
    )
    motion = path.motion._replace(slow_x=slow_x, slow_v=slow_v, cosine=cosine, sine=sine)
    return path._replace(
        x=x, v=v, motion=motion, time_remaining=time_remaining, time_remaining_low=time_remaining_low, contact=contact
    )


def _entry_step_mask(coeffs, path):
    """Return the bit mask of the lanes that take the entry step."""
    entry, side = soft_contact.entry_steps(coeffs, path.contact), lax.sign(path.contact)
    push = coeffs.amplitude * path.cosine
    extra_force = soft_contact.extra_force_derivs(coeffs, path.contact, path.cosine, path.sine, 0)
    (extra_force,) = drive.add_term_derivatives(
        coeffs.drive_terms, coeffs.frequency, path.cosine, path.sine, extra_force
    )
    certified = is_certified(entry, side * path.v, side * (push if extra_force is None else push + extra_force))
    return bit_mask((lax.abs(path.contact) == Contact.ENTERED) & certified & (path.time_remaining > entry.time), path.x)


def _phasor_after_entry(coeffs, path):
    """Return the phasor of the drive after the entry step."""
    return flow.rotate(path.cosine, path.sine, *soft_contact.entry_steps(coeffs, path.contact).drive_rotation)


def _state_after_entry(coeffs, path):
    """Return (y, y') after the entry step."""
    entry = soft_contact.entry_steps(coeffs, path.contact)
    harmonic_flows = entry.term_flows if entry.wall_flow is None else (*entry.term_flows, entry.wall_flow)
    response = soft_contact.ContactResponse(entry.free_flow, entry.forced_flow, harmonic_flows)
    return soft_contact.apply_response(coeffs, path.contact, response, (path.x, path.v), path.cosine, path.sine)


def _remaining_after_entry(coeffs, path):
    """Return the remaining time and its low part after the entry step."""
    return subtract_time(path, soft_contact.entry_steps(coeffs, path.contact).time)


def is_due(path, wait_count):
    """Return the lanes that have waited long enough for a long step.

    Parameters
    ----------
    path : Path
        Path of the lanes.
    wait_count : array
        Number of steps since the entry or the last attempt at a long step.

    Returns
    -------
    array of bool
        True where a long step is due.
    """
    return (wait_count >= MIN_SHORT_STEPS) & (path.time_remaining > 0)


def advance_by_series(coeffs, path, time):
    """Return (y, y') after a time, from the `flow.FlowSeries` of each lane."""
    return stage(_advance_by_series, coeffs, path, time)


def take_long_step(coeffs, path, wait_count, advance_lanes=advance_by_series):
    """Take a long step in lanes for which one is due and exists.

    Parameters
    ----------
    coeffs : FlowCoefficients
        Coefficients of the scene.
    path : Path
        Path of the lanes.
    wait_count : array
        Number of steps since the entry or the last attempt at a long step.
    advance_lanes : callable, optional
        Function from (coefficients of each lane, path, time) to (y, y') after the time.

    Returns
    -------
    path : Path
        Path after the step.
    wait_count : array
        Number of steps, 0 in lanes for which a long step was due.
    """
    lane_coeffs = soft_contact.coeffs_by_lane(coeffs, path.contact)
    due = is_due(path, wait_count)
    time = choose(due, minimum(stage(_certified_time, lane_coeffs, path), path.time_remaining), 0.0)
    is_worthwhile = time > MIN_STEP_RATIO * lane_coeffs.max_step
    time = choose(is_worthwhile, time, 0.0)
    angle = coeffs.frequency * time
    phasor = stage(flow.rotate, path.cosine, path.sine, flow.cos_less_1(angle), flow.sin_by_series(angle))
    x, v = advance_lanes(lane_coeffs, path, time)
    zero = lax.full_like(x, 0.0)
    next_motion = SlowMotion(x, zero, v, zero, *phasor)
    next_motion = SlowMotion(
        *(choose(is_worthwhile, next_value, value) for next_value, value in zip(next_motion, path.motion, strict=True))
    )
    time_remaining, time_remaining_low = subtract_time(path, time)
    side = lax.sign(path.contact)
    next_path = path._replace(
        x=choose(is_worthwhile, x, path.x),
        x_low=choose(is_worthwhile, 0.0, path.x_low),
        v=choose(is_worthwhile, v, path.v),
        motion=next_motion,
        time_remaining=choose(is_worthwhile, positive_part(time_remaining), path.time_remaining),
        time_remaining_low=choose(is_worthwhile, time_remaining_low, path.time_remaining_low),
        contact=choose(is_worthwhile, side * Contact.WITHIN, path.contact),
    )
    return next_path, choose(due, 0.0, wait_count)


def _certified_time(coeffs, path):
    """Return a time for which the mass certainly stays inside its wall.

    It is 0 if there is no certificate, for example if oscillations grow with time reversed.
    """
    parts = _forced_parts(coeffs, path.contact, path.cosine, path.sine)
    stiffness, damping, side = coeffs.stiffness, coeffs.damping, lax.sign(path.contact)
    slow_y, max_rate = (sum(values) for values in zip(*(part.values(2) for part in parts), strict=True))
    fast_y, fast_v = path.x - slow_y, path.v - max_rate
    discriminant = damping * damping - stiffness
    overdamped = damping * damping > OVERDAMPED_RATIO * stiffness
    fast_decay_rate = damping + lax.sqrt(choose(overdamped, discriminant, 0.0))
    slow_decay_rate = choose(overdamped, stiffness / fast_decay_rate, 0.0)
    fast_decay = (fast_v + slow_decay_rate * fast_y) / choose(overdamped, slow_decay_rate - fast_decay_rate, -1.0)
    slow_decay = choose(overdamped, fast_y - fast_decay, 0.0)
    fast_bound = choose(overdamped, lax.abs(fast_decay), lax.sqrt(fast_y * fast_y + fast_v * fast_v / stiffness))
    parts = [*parts, DecayPart(slow_decay, slow_decay_rate)]
    max_rate = slow_decay_rate
    for part in parts[:-1]:
        max_rate = choose(part.rate > max_rate, part.rate, max_rate)
    max_step = flow.MAX_SCALED_STEP / max_rate
    weights = event.taylor_weights(max_step)
    slow_derivs = [sum(values) for values in zip(*(part.values(event.N_TERMS) for part in parts), strict=True)]
    terms = [-(side * values) * weight for values, weight in zip(slow_derivs, weights, strict=False)]
    terms[0] = terms[0] + fast_bound
    remainder = sum(part.size * part.rate**event.N_TERMS for part in parts) * weights[event.N_TERMS]
    progress = event.Progress(tuple(terms), remainder)
    progress_bound = event.bound_progress(progress, event.cubic_bound(progress))
    safe_step = event.safe_step(progress_bound)
    certified_step = event.safe_horizon_step(
        progress_bound,
        event.bounding_horizon(progress_bound, event.first_quadratic_root(*progress_bound[:3])),
        safe_step,
    )
    is_stiff = stiffness > MIN_STIFFNESS_RATIO * max_rate * max_rate
    return choose((terms[0] < 0) & is_stiff & (damping >= 0), certified_step * max_step, 0.0)


def _advance_by_series(coeffs, path, time):
    """Return (y, y') after a time by doubling a short step of the flow."""
    response = soft_contact.contact_response(coeffs, path.contact, time)
    return soft_contact.apply_response(coeffs, path.contact, response, (path.x, path.v), path.cosine, path.sine)


def _forced_parts(coeffs, contact, cosine, sine):
    """Return the `HarmonicPart`s of y due to the drive and the wall; not useful at resonance.

    `coeffs` are those of each lane.
    """
    zero = 0.0 * cosine
    forces = [(coeffs.amplitude * cosine, coeffs.amplitude * sine, coeffs.frequency + zero)]
    forces += soft_contact.harmonic_forces(coeffs, contact, cosine, sine)
    parts = []
    for force_cos, force_sin, angular_rate in forces:
        drag, detuning = 2.0 * coeffs.damping * angular_rate, coeffs.stiffness - angular_rate * angular_rate
        denominator = detuning * detuning + drag * drag
        parts.append(
            HarmonicPart(
                (force_cos * detuning + force_sin * drag) / denominator,
                (force_sin * detuning - force_cos * drag) / denominator,
                angular_rate,
            )
        )
    mean_position, _ = soft_contact.mean_position_increments(coeffs, contact, cosine, -1.0, zero)
    return [HarmonicPart(mean_position, zero, zero), *parts]
