"""By which power of its depth a contact with a soft wall changes the motion, near a grazing."""

import numpy as np

SMALL_DEPTH_ROOT = 1e-4  # the root of a depth
POWER_TOLERANCE = 0.02  # of a power: the nearest whole one is meant


def contact_exponent(wall):
    """n + 1/2 of a push in proportion to depth^n, of a soft wall whose force has no jump; nan where no power is seen.

    A contact d deep is as long as the root h of d, and as fast: a push in proportion to h^m changes the velocity by
    h^(m + 1). What changes its sign with the rate, as a damping does, takes back on the way out what it gives on the
    way in, but for one power more. Spring and damper: 3/2.
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
    return float(law.function(np.float64(depth_root * depth_root), np.float64(sign * depth_root), law.numbers))


def _fit_power(value_at_h, value_at_2h):
    """m of what is in proportion to h^m, at h and 2 h; inf of 0."""
    return np.log2(value_at_2h / value_at_h) if value_at_h * value_at_2h > 0 else np.inf
