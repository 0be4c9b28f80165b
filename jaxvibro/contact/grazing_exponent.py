"""Estimate how the change of motion by a contact with a soft wall with a law depends on the depth, near a grazing."""

import numpy as np

SMALL_DEPTH_ROOT = 1e-4  # square root of the depth
POWER_TOLERANCE = 0.02  # largest distance of a fitted power from an integer


def grazing_exponent(wall):
    """Return the exponent of the depth in the change of motion by a contact.

    The duration and the speed of a contact of depth d are proportional to h = sqrt(d). A force proportional to h^m
    changes the velocity in proportion to h^(m + 1). If the force changes sign with the rate of the depth, as damping
    does, the changes on the way in and on the way out cancel to leading order, and the power is larger by one. A force
    proportional to depth^n therefore gives the exponent n + 1/2. Spring and damper give 3/2.

    Parameters
    ----------
    wall : Wall
        Soft wall with a law, whose force has no jump.

    Returns
    -------
    float
        Exponent, a multiple of 1/2; nan if no power is recognised.
    """
    forces_at_both_rates = [
        [_contact_force(wall.law, depth_root_factor * SMALL_DEPTH_ROOT, sign) for sign in (1.0, -1.0)]
        for depth_root_factor in (1.0, 2.0)
    ]
    fitted_powers = [
        _fit_power(
            *(
                0.5 * (force_moving_in + sign * force_moving_out)
                for force_moving_in, force_moving_out in forces_at_both_rates
            )
        )
        + power_from_integration
        for sign, power_from_integration in ((1.0, 1), (-1.0, 2))
    ]
    lowest_power = min(fitted_powers)
    return (
        0.5 * round(lowest_power)
        if np.isfinite(lowest_power) and abs(lowest_power - round(lowest_power)) <= POWER_TOLERANCE
        else np.nan
    )


def _contact_force(wall_law, depth_root, rate_sign):
    """Evaluate the contact force at the depth h^2 and the rate sign * h, where h is `depth_root`."""
    return float(
        wall_law.function(np.float64(depth_root * depth_root), np.float64(rate_sign * depth_root), wall_law.numbers)
    )


def _fit_power(value_at_h, value_at_2h):
    """Return the exponent m of a function proportional to h^m from values at h and 2 h; inf if not of one sign."""
    return np.log2(value_at_2h / value_at_h) if value_at_h * value_at_2h > 0 else np.inf
