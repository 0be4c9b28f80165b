"""Decide whether a motion with a small exponent is chaotic, with the estimator of `chaotic_exponents`."""

import numpy as np

from ..scene.check import MAX_ORBIT_PERIODS
from ..scene.state import Status
from .chaotic_exponents import estimate_exponents, run_until_recurrence
from .tangent_growth import start_tangents

MAX_ROUNDS = 8  # rounds of the test for recurrence
TARGET_ERROR, MAX_PERIODS = 2e-3, 2**20  # standard error at which the average ends, and its largest number of periods
CERTAIN_ERRORS = 4.0  # standard errors by which a positive exponent must exceed 0
RECURRENCE_NOTE = "recurs only after a long time"
SHEAR_RATE = 2e-3  # growth per period of a mere shear in `chaotic_exponents.estimate_exponents`


def assess_weak_chaos(scene, state):
    """Return (largest exponent per drive period, note on the evidence) of one lane's motion.

    The exponent is finite if the motion is chaotic beyond doubt, -inf if it is not certainly chaotic, and nan if the
    estimator cannot decide. After sticking, a motion depends only on the phase of the release, and releases occur at
    few phases. A motion that sticks repeatedly therefore recurs, possibly after a long time. scene: single; state:
    leaves (1,), after the transient.
    """
    settled_lanes = run_until_recurrence(scene, start_tangents(state), 0, MAX_ROUNDS)
    if not settled_lanes.has_finite_state:
        return np.nan, f"status {Status(settled_lanes.status[0]).word}"
    if settled_lanes.periods[0]:
        return -np.inf, RECURRENCE_NOTE
    exponent_estimate, recurrent_lanes = estimate_exponents(scene, settled_lanes, TARGET_ERROR, MAX_PERIODS)
    exponent, error = float(exponent_estimate.exponent[0]), float(exponent_estimate.error[0])
    if recurrent_lanes is not None:
        return -np.inf, RECURRENCE_NOTE
    if np.isneginf(exponent):
        return -np.inf, f"sticks to a wall, so it recurs, but after more than {MAX_ORBIT_PERIODS} periods"
    if exponent_estimate.status >= Status.CAP or not np.isfinite(exponent):
        return np.nan, f"does not recur, and has no exponent (status {Status(exponent_estimate.status).word})"
    if exponent > max(CERTAIN_ERRORS * error, SHEAR_RATE):
        return exponent, f"does not recur, standard error of its exponent {error:.1g}"
    return -np.inf, f"does not recur, and its exponent {exponent:.1g} +- {error:.1g} is not positive beyond doubt"
