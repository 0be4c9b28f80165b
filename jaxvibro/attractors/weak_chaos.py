"""Chaos too weak for the growth over some hundred periods to tell: the spectrum's estimator, asked about one lane."""

import numpy as np

from ..scene.check import MOST_PERIODS
from ..scene.codes import Status
from .chaotic_exponents import of_motion, settled
from .tangent import begin

ROUNDS = 8  # looks at whether the lane recurs after all
GOAL, MOST = 2e-3, 2**20  # standard error to come to, and drive periods that may be averaged for it
SURE = 4.0  # standard errors by which a positive exponent must exceed 0
LATE = "recurs only after long"
SHEAR = 2e-3  # growth a period of what shears, as `chaotic_exponents.of_motion` sees it


def weigh(scene, state):
    """(exponent, what was seen) of one lane's motion: the largest, per drive period, where it is chaotic beyond doubt.

    It is -inf where the motion is not known to be chaotic, and nan where the estimator cannot tell. A mass that rests
    forgets all but the moment at which it is let go: it comes back, be it after long. scene: a single one; state:
    leaves (1,), on what the exponent is asked of.
    """
    seen = settled(scene, begin(state), 0, ROUNDS)
    if not seen.is_well:
        return np.nan, f"status {Status(seen.status[0]).word}"
    if seen.periods[0]:
        return -np.inf, LATE
    rates, end = of_motion(scene, seen, GOAL, MOST)
    rate, error = float(rates.exponent[0]), float(rates.error[0])
    if end is not None:
        return -np.inf, LATE
    if np.isneginf(rate):
        return -np.inf, f"rests on a wall, and so recurs, but after more than {MOST_PERIODS} periods"
    if rates.status >= Status.CAP or not np.isfinite(rate):
        return np.nan, f"does not recur, and has no exponent (status {Status(rates.status).word})"
    if rate > max(SURE * error, SHEAR):
        return rate, f"does not recur, its exponent known to {error:.1g}"
    return -np.inf, f"does not recur, and its exponent {rate:.1g} +- {error:.1g} is not positive beyond doubt"
