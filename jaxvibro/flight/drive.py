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
class Term:
    """force cos(harmonic omega t + phase), numbers scalars or lanes. cosine, sine: of the phase; series: of the flow
    under it, None under a force of the user's own."""

    force: Float[jax.Array, "..."]
    cosine: Float[jax.Array, "..."]
    sine: Float[jax.Array, "..."]
    series: flow.Series | None
    harmonic: int = field(metadata={"static": True})


def terms(scene, frequency, damping):
    """The further `Term`s of a scene's drive; damping: None under a force of the user's own."""
    found = []
    for each in scene.drive:
        phase = jnp.asarray(each.phase, scene.dtype)
        series = None if damping is None else flow.series(frequency * float(each.harmonic), damping)
        force = jnp.asarray(each.amplitude, scene.dtype)
        found.append(Term(force, jnp.cos(phase), jnp.sin(phase), series, each.harmonic))
    return tuple(found)


def rate_of(term, frequency):
    """How fast its angle grows."""
    return frequency * float(term.harmonic)


def fastest(terms):
    """The highest of their harmonics, 0 of none."""
    return max((each.harmonic for each in terms), default=0)


def bound(terms, frequency, order):
    """A bound on the derivative of an order of their force."""
    return sum(abs(each.force) * rate_of(each, frequency) ** order for each in terms)


def largest(terms, force, frequency, order):
    """The same with force cos(omega t)."""
    own = abs(force) * frequency**order if order else abs(force)
    return own + bound(terms, frequency, order) if terms else own


def waves(terms, frequency, cosine, sine):
    """[(along, across, rate)], where the drive is at this cosine and sine: a force along cos - across sin of its own
    angle since now."""
    found = []
    for each in terms:
        c, s = wave(each, cosine, sine)
        found.append((each.force * c, each.force * s, rate_of(each, frequency)))
    return found


def forces(terms, frequency, cosine, sine, order):
    """Their force together and its derivatives to an order, where the drive is at this cosine and sine."""
    total = None
    for along, across, rate in waves(terms, frequency, cosine, sine):
        own = [along, -across * rate]
        for k in range(2, order + 1):
            own.append(own[k - 2] * -(rate * rate))
        total = own if total is None else [a + b for a, b in zip(total, own, strict=True)]
    return total[: order + 1]


def pushed(terms, frequency, cosine, sine, given, first=0):
    """Derivatives of a force, from the first on, None where zero, and those of the terms: `given` where there are
    none."""
    if not terms:
        return given
    more = forces(terms, frequency, cosine, sine, first + len(given) - 1)[first:]
    return [new if own is None else own + new for own, new in zip(given, more, strict=True)]


def moved(terms, frequency, cosine, sine, move, lifted):
    """(dx, dv) that they make of a flight; move: of the `flow.Gains`; lifted: (lift, lag) of each."""
    dx = dv = 0.0
    for (along, across, rate), (lift, lag) in zip(waves(terms, frequency, cosine, sine), lifted, strict=True):
        dx = dx + (along * lift - across * lag)
        dv = dv + (along * (move - rate * lag) - across * (rate * lift))
    return dx, dv


def responses(terms, frequency, damping, time):
    """x and v after a start from rest under the cosine, the sine of each one's angle over any time >= 0."""
    return [flow.doubled(each.series, rate_of(each, frequency), damping, time)[1] for each in terms]


def forced(terms, responses, frequency, cosine, sine):
    """(x, v) after a flight from rest of these `responses`."""
    x = v = 0.0
    for (along, across, _), (first, second) in zip(waves(terms, frequency, cosine, sine), responses, strict=True):
        x, v = x + (along * first[0] - across * second[0]), v + (along * first[1] - across * second[1])
    return x, v


def wave(each, cosine, sine):
    """Cosine and sine of the angle of a harmonic, a `Term`'s or a wall's, from the drive's."""
    c, s = _power(cosine, sine, each.harmonic)
    return c * each.cosine - s * each.sine, s * each.cosine + c * each.sine


def _power(cosine, sine, harmonic):
    """Cosine and sine of a whole multiple of the angle, by squaring."""
    if harmonic == 0:
        return lax.full_like(cosine, 1.0), lax.full_like(sine, 0.0)
    if harmonic == 1:
        return cosine, sine
    c, s = _power(cosine, sine, harmonic // 2)
    c, s = c * c - s * s, 2.0 * c * s
    return (c * cosine - s * sine, s * cosine + c * sine) if harmonic % 2 else (c, s)
