"""Reverse time inside a soft wall, where the damping changes sign."""

import jax.numpy as jnp

from . import flow, further_drive_terms
from .soft_wall_first_step import make_first_step_in_wall


def reverse_time(coeffs, wall, soft_flow):
    """Reverse the time of the flow inside a soft wall.

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
    force_deriv_bound = soft_flow.jet_bound / (1.0 + soft_flow.jet_bound_slope * soft_flow.max_step)
    series, wall_motion_series = flow.flow_series(frequency, damping, stiffness), None
    if soft_flow.wall_motion_series is not None:
        wall_motion_series = flow.flow_series(frequency * float(wall.harmonic), damping, stiffness)
    drive_term_series = tuple(
        flow.flow_series(further_drive_terms.term_angular_rate(term, frequency), damping, stiffness)
        for term in coeffs.drive_terms
    )
    terms_with_series = list(zip(coeffs.drive_terms, drive_term_series, strict=True))
    first_step = make_first_step_in_wall(
        wall, coeffs.amplitude, frequency, series, wall_motion_series, stiffness, terms_with_series
    )
    return soft_flow._replace(
        damping=damping,
        series=series,
        wall_motion_series=wall_motion_series,
        first_step=first_step._replace(force_change_bound=soft_flow.first_step.force_change_bound),
        jet_bound=force_deriv_bound * (1.0 + jet_bound_slope * soft_flow.max_step),
        jet_bound_slope=jet_bound_slope,
        drive_term_series=drive_term_series,
    )
