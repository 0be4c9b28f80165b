"""The drive's further terms, beside A cos(omega t): what each is, and what they do together.

As the flow is linear, each is flown by the `flow.Series` of its own frequency; a scene without any has none of this.
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
    """force cos(harmonic omega t + phase), numbers scalars or lanes. cosine, sine: of the phase; series: of the flow
    under it, None under a force of the user's own."""

    amplitude: Float[jax.Array, "..."]
    cosine: Float[jax.Array, "..."]
    sine: Float[jax.Array, "..."]
    series: flow.FlowSeries | None
    harmonic: int = field(metadata={"static": True})


def drive_terms(scene, frequency, damping):
    """The further `DriveTerm`s of a scene's drive; damping: None under a force of the user's own."""
    terms = []
    for motion in scene.drive:
        phase = jnp.asarray(motion.phase, scene.dtype)
        series = None if damping is None else flow.flow_series(frequency * float(motion.harmonic), damping)
        amplitude = jnp.asarray(motion.amplitude, scene.dtype)
        terms.append(DriveTerm(amplitude, jnp.cos(phase), jnp.sin(phase), series, motion.harmonic))
    return tuple(terms)


def angular_rate(term, frequency):
    """How fast its angle grows."""
    return frequency * float(term.harmonic)


def highest_harmonic(terms):
    """The highest of their harmonics, 0 of none."""
    return max((term.harmonic for term in terms), default=0)


def derivative_bound(terms, frequency, order):
    """A bound on the derivative of an order of their force."""
    return sum(abs(term.amplitude) * angular_rate(term, frequency) ** order for term in terms)


def total_derivative_bound(terms, amplitude, frequency, order):
    """The same with force cos(omega t)."""
    first_bound = abs(amplitude) * frequency**order if order else abs(amplitude)
    return first_bound + derivative_bound(terms, frequency, order) if terms else first_bound


def term_forces(terms, frequency, cosine, sine):
    """[(along, across, rate)], where the drive is at this cosine and sine: a force along cos - across sin of its own
    angle since now."""
    forces = []
    for term in terms:
        term_cosine, term_sine = harmonic_phasor(term, cosine, sine)
        forces.append((term.amplitude * term_cosine, term.amplitude * term_sine, angular_rate(term, frequency)))
    return forces


def force_derivatives(terms, frequency, cosine, sine, order):
    """Their force together and its derivatives to an order, where the drive is at this cosine and sine."""
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
    """Derivatives of a force, from the first on, None where zero, and those of the terms: `derivatives` where there are
    none."""
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
    """(dx, dv) that they make of a flight; p01: of the `flow.Gains`; responses: (lift, lag) of each."""
    dx = dv = 0.0
    for (force_cos, force_sin, rate), (cos_response, sin_response) in zip(
        term_forces(terms, frequency, cosine, sine), responses, strict=True
    ):
        dx = dx + (force_cos * cos_response - force_sin * sin_response)
        dv = dv + (force_cos * (p01 - rate * sin_response) - force_sin * (rate * cos_response))
    return dx, dv


def term_responses(terms, frequency, damping, time):
    """x and v after a start from rest under the cosine, the sine of each one's angle over any time >= 0."""
    return [flow.doubling_responses(term.series, angular_rate(term, frequency), damping, time)[1] for term in terms]


def forced_response(terms, responses, frequency, cosine, sine):
    """(x, v) after a flight from rest of these `term_responses`."""
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
    """Cosine and sine of the angle of a harmonic, a `DriveTerm`'s or a wall's, from the drive's."""
    multiple_cosine, multiple_sine = _multiple_angle(cosine, sine, term_or_wall.harmonic)
    return (
        multiple_cosine * term_or_wall.cosine - multiple_sine * term_or_wall.sine,
        multiple_sine * term_or_wall.cosine + multiple_cosine * term_or_wall.sine,
    )


def _multiple_angle(cosine, sine, harmonic):
    """Cosine and sine of a whole multiple of the angle, by squaring."""
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
