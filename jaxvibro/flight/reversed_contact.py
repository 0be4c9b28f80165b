"""Reverse time inside a soft wall: its damping changes sign."""

import jax.numpy as jnp

from . import drive, flow
from .soft_entry_step import entry_step


def reverse_time(coeffs, wall, soft_flow):
    """Return the flow inside a soft wall with time reversed.

    Parameters
    ----------
    coeffs : FlowCoefficients
        Coefficients of the scene, with time reversed.
    wall : WallCoefficients
        Coefficients of the wall, with time reversed.
    soft_flow : SoftWallFlow
        Flow inside the wall, with time forward.

    Returns
    -------
    SoftWallFlow
        Flow with time reversed.

    Notes
    -----
    The energy of y^(6) grows like that of x^(6), see `linear_flow.reverse_time`.
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
