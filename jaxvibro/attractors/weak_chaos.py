"""Chaos too weak for the growth over some hundred periods to tell: the spectrum's estimator, asked about one lane."""

import numpy as np

from ..scene.check import MAX_ORBIT_PERIODS
from ..scene.codes import Status
from .chaotic_exponents import estimate_exponents, run_until_recurrence
from .tangent import start_tangents

MAX_ROUNDS = 8  # looks at whether the lane recurs after all
TARGET_ERROR, MAX_PERIODS = 2e-3, 2**20  # standard error to come to, and drive periods that may be averaged for it
CERTAIN_ERRORS = 4.0  # standard errors by which a positive exponent must exceed 0
RECURRENCE_NOTE = "recurs only after long"
SHEAR_RATE = 2e-3  # growth a period of what shears, as `chaotic_exponents.of_motion` sees it


def assess_weak_chaos(scene, state):
    """(exponent, what was seen) of one lane's motion: the largest, per drive period, where it is chaotic beyond doubt.

    It is -inf where the motion is not known to be chaotic, and nan where the estimator cannot tell. A mass that rests
    forgets all but the moment at which it is let go: it comes back, be it after long. scene: a single one; state:
    leaves (1,), on what the exponent is asked of.
    """
    settled_lanes = run_until_recurrence(scene, start_tangents(state), 0, MAX_ROUNDS)
    if not settled_lanes.is_valid:
        return np.nan, f"status {Status(settled_lanes.status[0]).word}"
    if settled_lanes.periods[0]:
        return -np.inf, RECURRENCE_NOTE
    estimate, new_settled = estimate_exponents(scene, settled_lanes, TARGET_ERROR, MAX_PERIODS)
    exponent, error = float(estimate.exponent[0]), float(estimate.error[0])
    if new_settled is not None:
        return -np.inf, RECURRENCE_NOTE
    if np.isneginf(exponent):
        return -np.inf, f"rests on a wall, and so recurs, but after more than {MAX_ORBIT_PERIODS} periods"
    if estimate.status >= Status.CAP or not np.isfinite(exponent):
        return np.nan, f"does not recur, and has no exponent (status {Status(estimate.status).word})"
    if exponent > max(CERTAIN_ERRORS * error, SHEAR_RATE):
        return exponent, f"does not recur, its exponent known to {error:.1g}"
    return -np.inf, f"does not recur, and its exponent {exponent:.1g} +- {error:.1g} is not positive beyond doubt"
