"""Compute the response to the further terms of the drive, those in addition to A cos(omega t).

The flow of a spring and a damper is linear. Hence each term is advanced with the `flow.FlowSeries` of its own
frequency. A scene without further terms needs none of these computations.
"""

import operator
from dataclasses import dataclass, field
from functools import reduce

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Float

from . import flow
from .power_series import add_coefficients


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class DriveTerm:
    """Term of the drive: amplitude cos(harmonic omega t + phase).

    Numbers are scalars or lanes.

    Attributes
    ----------
    amplitude : array
        Amplitude of the force.
    cosine : array
        Cosine of the phase.
    sine : array
        Sine of the phase.
    series : FlowSeries or None
        Series of the flow under this term. None under a user-defined force.
    harmonic : int
        Multiple of the drive frequency.
    """

    amplitude: Float[jax.Array, "..."]
    cosine: Float[jax.Array, "..."]
    sine: Float[jax.Array, "..."]
    series: flow.FlowSeries | None
    harmonic: int = field(metadata={"static": True})


def drive_terms(scene, frequency, damping):
    """Return the further `DriveTerm`s of a scene; `damping` is None under a user-defined force."""
    further_terms = []
    for harmonic_motion in scene.drive:
        phase = jnp.asarray(harmonic_motion.phase, scene.dtype)
        series = None if damping is None else flow.flow_series(frequency * float(harmonic_motion.harmonic), damping)
        amplitude = jnp.asarray(harmonic_motion.amplitude, scene.dtype)
        further_terms.append(DriveTerm(amplitude, jnp.cos(phase), jnp.sin(phase), series, harmonic_motion.harmonic))
    return tuple(further_terms)


def term_angular_rate(term, frequency):
    """Return the angular frequency of a drive term."""
    return frequency * float(term.harmonic)


def highest_harmonic(drive_terms):
    """Return the highest harmonic of drive terms.

    Parameters
    ----------
    drive_terms : sequence of DriveTerm
        Terms of the drive.

    Returns
    -------
    int
        Highest harmonic; 0 without terms.
    """
    return max((term.harmonic for term in drive_terms), default=0)


def terms_derivative_bound(drive_terms, frequency, order):
    """Return a bound on the derivative of a given order of the total force of drive terms."""
    return sum(abs(term.amplitude) * term_angular_rate(term, frequency) ** order for term in drive_terms)


def drive_derivative_bound(drive_terms, amplitude, frequency, order):
    """Return a bound on the derivative of a given order of the whole drive, including amplitude cos(omega t)."""
    main_term_bound = abs(amplitude) * frequency**order if order else abs(amplitude)
    return main_term_bound + terms_derivative_bound(drive_terms, frequency, order) if drive_terms else main_term_bound


def term_forces(drive_terms, frequency, drive_cosine, drive_sine):
    """Return the forces of drive terms as a list of (force_cos, force_sin, angular rate).

    `drive_cosine` and `drive_sine` are the phasor of the drive at t = 0. The force of a term at the time t is
    force_cos cos(rate t) - force_sin sin(rate t).
    """
    forces = []
    for term in drive_terms:
        term_cosine, term_sine = harmonic_phasor(term, drive_cosine, drive_sine)
        forces.append((term.amplitude * term_cosine, term.amplitude * term_sine, term_angular_rate(term, frequency)))
    return forces


def harmonic_derivatives(force_cos, force_sin, angular_rate, order):
    """Return force_cos cos(rate t) - force_sin sin(rate t) and its time derivatives up to an order at t = 0."""
    derivatives = [force_cos, -force_sin * angular_rate]
    for k in range(2, order + 1):
        derivatives.append(derivatives[k - 2] * -(angular_rate * angular_rate))
    return derivatives[: order + 1]


def term_force_derivatives(drive_terms, frequency, drive_cosine, drive_sine, order):
    """Return the total force of drive terms and its time derivatives up to an order, at a phasor of the drive."""
    forces = term_forces(drive_terms, frequency, drive_cosine, drive_sine)
    derivs_by_term = [harmonic_derivatives(*force, order) for force in forces]
    return [reduce(operator.add, term_derivs) for term_derivs in zip(*derivs_by_term, strict=True)]


def add_term_derivatives(drive_terms, frequency, drive_cosine, drive_sine, force_derivs):
    """Add the derivatives of the drive terms to those of a force.

    An entry of None in `force_derivs` stands for zero. Without drive terms `force_derivs` is returned unchanged.
    """
    if not drive_terms:
        return force_derivs
    term_derivs = term_force_derivatives(drive_terms, frequency, drive_cosine, drive_sine, len(force_derivs) - 1)
    return [
        add_coefficients(force_deriv, term_deriv)
        for force_deriv, term_deriv in zip(force_derivs, term_derivs, strict=True)
    ]


def drive_term_increments(drive_terms, frequency, drive_cosine, drive_sine, p01, term_responses):
    """Return the increments (dx, dv) of a flight due to the drive terms.

    `p01` is the entry of the `flow.Propagator`. `term_responses` is (cos_response, sin_response) for each term.
    """
    forces = term_forces(drive_terms, frequency, drive_cosine, drive_sine)
    return add_force_increments(0.0, 0.0, forces, p01, term_responses)


def add_force_increments(dx, dv, forces, p01, responses):
    """Add the increments due to forces as in `term_forces` to the increments (dx, dv) of a flight."""
    for (force_cos, force_sin, angular_rate), (cos_response, sin_response) in zip(forces, responses, strict=True):
        dx = dx + (force_cos * cos_response - force_sin * sin_response)
        dv = dv + (force_cos * (p01 - angular_rate * sin_response) - force_sin * (angular_rate * cos_response))
    return dx, dv


def term_responses(drive_terms, frequency, damping, duration):
    """Compute the response to each drive term after a start from rest.

    Parameters
    ----------
    drive_terms : sequence of DriveTerm
        Terms of the drive.
    frequency : array
        Drive frequency.
    damping : array
        Damping ratio.
    duration : array
        Duration of the flight, at least 0, in units of t.

    Returns
    -------
    list of ForcedFlow
        For each term ((x, v), (x, v)) under the cosine and under the sine of its angle.
    """
    return [
        flow.doubling_responses(term.series, term_angular_rate(term, frequency), damping, duration)[1]
        for term in drive_terms
    ]


def response_to_terms(drive_terms, term_responses, frequency, drive_cosine, drive_sine):
    """Compute the state after a flight from rest under the drive terms.

    Parameters
    ----------
    drive_terms : sequence of DriveTerm
        Terms of the drive.
    term_responses : list of ForcedFlow
        Result of `term_responses`.
    frequency : array
        Drive frequency.
    drive_cosine : array
        Cosine of the drive angle at the start.
    drive_sine : array
        Sine of the drive angle at the start.

    Returns
    -------
    x : array
        Position.
    v : array
        Velocity.
    """
    x = v = 0.0
    for (force_cos, force_sin, _), (cos_response, sin_response) in zip(
        term_forces(drive_terms, frequency, drive_cosine, drive_sine), term_responses, strict=True
    ):
        x, v = (
            x + (force_cos * cos_response[0] - force_sin * sin_response[0]),
            v + (force_cos * cos_response[1] - force_sin * sin_response[1]),
        )
    return x, v


def harmonic_phasor(term_or_wall, drive_cosine, drive_sine):
    """Return the phasor (cosine, sine) of a drive term or a moving wall from the phasor of the drive."""
    multiple_angle_cosine, multiple_angle_sine = _multiple_angle(drive_cosine, drive_sine, term_or_wall.harmonic)
    return (
        multiple_angle_cosine * term_or_wall.cosine - multiple_angle_sine * term_or_wall.sine,
        multiple_angle_sine * term_or_wall.cosine + multiple_angle_cosine * term_or_wall.sine,
    )


def _multiple_angle(cosine, sine, harmonic):
    """Return cosine and sine of an integer multiple of an angle, by repeated squaring."""
    if harmonic == 0:
        return lax.full_like(cosine, 1.0), lax.full_like(sine, 0.0)
    if harmonic == 1:
        return cosine, sine
    multiple_angle_cosine, multiple_angle_sine = _multiple_angle(cosine, sine, harmonic // 2)
    multiple_angle_cosine, multiple_angle_sine = (
        multiple_angle_cosine * multiple_angle_cosine - multiple_angle_sine * multiple_angle_sine,
        2.0 * multiple_angle_cosine * multiple_angle_sine,
    )
    return (
        (
            multiple_angle_cosine * cosine - multiple_angle_sine * sine,
            multiple_angle_sine * cosine + multiple_angle_cosine * sine,
        )
        if harmonic % 2
        else (multiple_angle_cosine, multiple_angle_sine)
    )
