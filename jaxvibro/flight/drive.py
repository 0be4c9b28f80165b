"""Compute the response to the terms of the drive in addition to A cos(omega t).

The flow is linear. Hence each term is advanced with the `flow.FlowSeries` of its own frequency. A scene without
further terms does none of this work.
"""

from dataclasses import dataclass, field

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Float

from . import flow


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
    terms = []
    for motion in scene.drive:
        phase = jnp.asarray(motion.phase, scene.dtype)
        series = None if damping is None else flow.flow_series(frequency * float(motion.harmonic), damping)
        amplitude = jnp.asarray(motion.amplitude, scene.dtype)
        terms.append(DriveTerm(amplitude, jnp.cos(phase), jnp.sin(phase), series, motion.harmonic))
    return tuple(terms)


def angular_rate(term, frequency):
    """Return the angular frequency of a term."""
    return frequency * float(term.harmonic)


def highest_harmonic(terms):
    """Return the highest harmonic of some drive terms.

    Parameters
    ----------
    terms : sequence of DriveTerm
        Terms of the drive.

    Returns
    -------
    int
        Highest harmonic, and 0 without terms.
    """
    return max((term.harmonic for term in terms), default=0)


def derivative_bound(terms, frequency, order):
    """Return a bound on a derivative of the force of some drive terms."""
    return sum(abs(term.amplitude) * angular_rate(term, frequency) ** order for term in terms)


def total_derivative_bound(terms, amplitude, frequency, order):
    """Return a bound on a derivative of the whole drive, including amplitude cos(omega t)."""
    first_bound = abs(amplitude) * frequency**order if order else abs(amplitude)
    return first_bound + derivative_bound(terms, frequency, order) if terms else first_bound


def term_forces(terms, frequency, cosine, sine):
    """Return the forces of some drive terms as a list of (force_cos, force_sin, rate).

    At a time t from now, when the phasor of the drive is (cosine, sine), the force of a term is force_cos cos(rate t) -
    force_sin sin(rate t).
    """
    forces = []
    for term in terms:
        term_cosine, term_sine = harmonic_phasor(term, cosine, sine)
        forces.append((term.amplitude * term_cosine, term.amplitude * term_sine, angular_rate(term, frequency)))
    return forces


def force_derivatives(terms, frequency, cosine, sine, order):
    """Return the total force of some drive terms and its derivatives up to an order, at a phasor of the drive."""
    total_derivs = None
    for force_cos, force_sin, rate in term_forces(terms, frequency, cosine, sine):
        derivatives = [force_cos, -force_sin * rate]
        for k in range(2, order + 1):
            derivatives.append(derivatives[k - 2] * -(rate * rate))
        total_derivs = (
            derivatives if total_derivs is None else [a + b for a, b in zip(total_derivs, derivatives, strict=True)]
        )
    return total_derivs[: order + 1]


def add_term_derivatives(terms, frequency, cosine, sine, derivatives, first_order=0):
    """Add the derivatives of the drive terms to those of a force.

    `derivatives` starts at `first_order`; None stands for zero. Without drive terms it is returned unchanged.
    """
    if not terms:
        return derivatives
    term_derivatives = force_derivatives(terms, frequency, cosine, sine, first_order + len(derivatives) - 1)[
        first_order:
    ]
    return [
        term_derivative if derivative is None else derivative + term_derivative
        for derivative, term_derivative in zip(derivatives, term_derivatives, strict=True)
    ]


def term_increments(terms, frequency, cosine, sine, p01, responses):
    """Return the increments (dx, dv) of a flight due to the drive terms.

    `p01` belongs to the `flow.Propagator`. `responses` holds (cos_response, sin_response) for each term.
    """
    dx = dv = 0.0
    for (force_cos, force_sin, rate), (cos_response, sin_response) in zip(
        term_forces(terms, frequency, cosine, sine), responses, strict=True
    ):
        dx = dx + (force_cos * cos_response - force_sin * sin_response)
        dv = dv + (force_cos * (p01 - rate * sin_response) - force_sin * (rate * cos_response))
    return dx, dv


def term_responses(terms, frequency, damping, time):
    """Compute the response to each drive term after a start from rest.

    Parameters
    ----------
    terms : sequence of DriveTerm
        Terms of the drive.
    frequency : array
        Drive frequency.
    damping : array
        Damping ratio.
    time : array
        Duration of the flight, at least 0, in units of t.

    Returns
    -------
    list of ForcedFlow
        For each term ((x, v), (x, v)) under the cosine and under the sine of its angle.
    """
    return [flow.doubling_responses(term.series, angular_rate(term, frequency), damping, time)[1] for term in terms]


def forced_response(terms, responses, frequency, cosine, sine):
    """Compute the state after a flight from rest under the drive terms.

    Parameters
    ----------
    terms : sequence of DriveTerm
        Terms of the drive.
    responses : list of ForcedFlow
        Result of `term_responses`.
    frequency : array
        Drive frequency.
    cosine : array
        Cosine of the drive angle at the start.
    sine : array
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
        term_forces(terms, frequency, cosine, sine), responses, strict=True
    ):
        x, v = (
            x + (force_cos * cos_response[0] - force_sin * sin_response[0]),
            v + (force_cos * cos_response[1] - force_sin * sin_response[1]),
        )
    return x, v


def harmonic_phasor(term_or_wall, cosine, sine):
    """Return the phasor (cosine, sine) of a drive term or a moving wall from the phasor of the drive."""
    multiple_cosine, multiple_sine = _multiple_angle(cosine, sine, term_or_wall.harmonic)
    return (
        multiple_cosine * term_or_wall.cosine - multiple_sine * term_or_wall.sine,
        multiple_sine * term_or_wall.cosine + multiple_cosine * term_or_wall.sine,
    )


def _multiple_angle(cosine, sine, harmonic):
    """Return cosine and sine of an integer multiple of an angle, by repeated squaring."""
    if harmonic == 0:
        return lax.full_like(cosine, 1.0), lax.full_like(sine, 0.0)
    if harmonic == 1:
        return cosine, sine
    multiple_cosine, multiple_sine = _multiple_angle(cosine, sine, harmonic // 2)
    multiple_cosine, multiple_sine = (
        multiple_cosine * multiple_cosine - multiple_sine * multiple_sine,
        2.0 * multiple_cosine * multiple_sine,
    )
    return (
        (multiple_cosine * cosine - multiple_sine * sine, multiple_sine * cosine + multiple_cosine * sine)
        if harmonic % 2
        else (multiple_cosine, multiple_sine)
    )
