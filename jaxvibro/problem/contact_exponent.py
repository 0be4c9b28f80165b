"""Determine the power of the depth by which a contact with a soft wall changes the motion near a grazing."""

import numpy as np

SMALL_DEPTH_ROOT = 1e-4  # square root of the depth
POWER_TOLERANCE = 0.02  # largest distance of a fitted power from an integer


def contact_exponent(wall):
    """Return the power of the depth by which a contact changes the motion.

    A contact of depth d lasts a time in proportion to h = sqrt(d), and its speed is in proportion to h. A force in
    proportion to h^m changes the velocity by h^(m + 1). A force that changes sign with the rate, such as damping, is
    cancelled on the way out to leading order and acts with one power more. So a force in proportion to depth^n gives
    n + 1/2; spring and damper give 3/2.

    Parameters
    ----------
    wall : Wall
        Soft wall whose force has no jump.

    Returns
    -------
    float
        Exponent, a multiple of 1/2; nan if no power is recognised.
    """
    if wall.law is None:
        return 1.5
    force_pairs = [
        [_contact_force(wall.law, factor * SMALL_DEPTH_ROOT, sign) for sign in (1.0, -1.0)] for factor in (1.0, 2.0)
    ]
    powers = [
        _fit_power(*(0.5 * (plus + sign * minus) for plus, minus in force_pairs)) + extra_power
        for sign, extra_power in ((1.0, 1), (-1.0, 2))
    ]
    min_power = min(powers)
    return (
        0.5 * round(min_power)
        if np.isfinite(min_power) and abs(min_power - round(min_power)) <= POWER_TOLERANCE
        else np.nan
    )


def _contact_force(law, depth_root, sign):
    """Evaluate the contact force at depth h^2 and rate sign * h."""
    return float(law.function(np.float64(depth_root * depth_root), np.float64(sign * depth_root), law.numbers))


def _fit_power(value_at_h, value_at_2h):
    """Return m of a function in proportion to h^m from its values at h and 2 h; inf if they vanish."""
    return np.log2(value_at_2h / value_at_h) if value_at_h * value_at_2h > 0 else np.inf
