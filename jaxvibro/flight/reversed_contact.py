"""What a mass feels within a soft wall with time reversed: its damping takes the other sign."""

import jax.numpy as jnp

from . import drive, flow
from .soft_half_swing import plunge


def reversed_in_time(frame, wall, soft):
    """The `soft_contact.SoftFlow` within a wall with time reversed. wall, frame: its `Lane` and the flow's, reversed;
    soft: as it was.

    The energy of y^(6) grows as that of x^(6) does, see `spring_flow.reversed_in_time`.
    """
    frequency, damping, stiffness = frame.frequency, wall.damping, soft.stiffness
    slope = soft.slope * jnp.exp(-2.0 * damping * soft.reach)
    forcing = soft.curb / (1.0 + soft.slope * soft.reach)
    series, waves = flow.series(frequency, damping, stiffness), None
    if soft.waves is not None:
        waves = flow.series(frequency * float(wall.harmonic), damping, stiffness)
    more = tuple(flow.series(drive.rate_of(term, frequency), damping, stiffness) for term in frame.terms)
    terms = list(zip(frame.terms, more, strict=True))
    first = plunge(wall, frame.force, frequency, series, waves, stiffness, terms)
    return soft._replace(
        damping=damping,
        series=series,
        waves=waves,
        plunge=first._replace(change=soft.plunge.change),
        curb=forcing * (1.0 + slope * soft.reach),
        slope=slope,
        terms=more,
    )
