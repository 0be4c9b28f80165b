"""What a mass feels within a soft wall with time reversed: its damping takes the other sign."""

import jax.numpy as jnp

from . import drive, flow
from .soft_entry_step import entry_step


def reverse_time(coeffs, wall, soft_flow):
    """The `soft_contact.SoftFlow` within a wall with time reversed. wall, coeffs: its `Lane` and the flow's, reversed;
    soft_flow: as it was.

    The energy of y^(6) grows as that of x^(6) does, see `spring_flow.reversed_in_time`.
    """
    frequency, damping, stiffness = coeffs.frequency, wall.damping, soft_flow.stiffness
    jet_bound_slope = soft_flow.jet_bound_slope * jnp.exp(-2.0 * damping * soft_flow.max_step)
    force_bound = soft_flow.jet_bound / (1.0 + soft_flow.jet_bound_slope * soft_flow.max_step)
    series, wall_series = flow.flow_series(frequency, damping, stiffness), None
    if soft_flow.wall_series is not None:
        wall_series = flow.flow_series(frequency * float(wall.harmonic), damping, stiffness)
    term_series = tuple(
        flow.flow_series(drive.angular_rate(term, frequency), damping, stiffness) for term in coeffs.drive_terms
    )
    term_pairs = list(zip(coeffs.drive_terms, term_series, strict=True))
    entry = entry_step(wall, coeffs.amplitude, frequency, series, wall_series, stiffness, term_pairs)
    return soft_flow._replace(
        damping=damping,
        series=series,
        wall_series=wall_series,
        entry_step=entry._replace(push_change=soft_flow.entry_step.push_change),
        jet_bound=force_bound * (1.0 + jet_bound_slope * soft_flow.max_step),
        jet_bound_slope=jet_bound_slope,
        term_series=term_series,
    )
