"""By which power of its depth a contact with a soft wall changes the motion, near a grazing."""

import numpy as np

SMALL = 1e-4  # the root of a depth
NEAR = 0.02  # of a power: the nearest whole one is meant


def exponent_of(wall):
    """n + 1/2 of a push in proportion to depth^n, of a soft wall whose force has no jump; nan where no power is seen.

    A contact d deep is as long as the root h of d, and as fast: a push in proportion to h^m changes the velocity by
    h^(m + 1). What changes its sign with the rate, as a damping does, takes back on the way out what it gives on the
    way in, but for one power more. Spring and damper: 3/2.
    """
    if wall.law is None:
        return 1.5
    push = [[_push(wall.law, size * SMALL, sign) for sign in (1.0, -1.0)] for size in (1.0, 2.0)]
    powers = [_power(*(0.5 * (a + sign * b) for a, b in push)) + more for sign, more in ((1.0, 1), (-1.0, 2))]
    least = min(powers)
    return 0.5 * round(least) if np.isfinite(least) and abs(least - round(least)) <= NEAR else np.nan


def _push(law, root, sign):
    return float(law.function(np.float64(root * root), np.float64(sign * root), law.numbers))


def _power(near, far):
    """m of what is in proportion to h^m, at h and 2 h; inf of 0."""
    return np.log2(far / near) if near * far > 0 else np.inf
