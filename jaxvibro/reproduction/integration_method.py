"""Check the integration method of the paper, which brackets contacts to 1e-6 of a step."""

import numpy as np

from ..maps.strobe import strobe
from ..scene.state import State
from .claim import own_claim, statement_claim
from .fixed_step import BRACKET_WIDTH, MAX_IMPACTS, DriveParameters
from .fixed_step import fixed_step_strobe as stepped

N_STARTS, STEPS_PER_PERIOD = 4096, (100, 400, 1600)  # the paper does not state the steps per period
FINE_BRACKET = 1e-12  # relative to a step: the remaining error is that of the integrator


def method_claims(scene):
    """Yield the claims on the accuracy of contacts and of the stroboscopic map, in a scene with walls at -1 and 1."""
    rng = np.random.default_rng(0)
    lower, upper = [-1.0, -3.0, 0.0], [1.0, 3.0, 6.0]
    states = rng.uniform(lower, upper, (N_STARTS, len(lower)))
    end_state, impacts = strobe(
        scene.replace(amplitude=states[:, 2]), State(states[:, 0], states[:, 1]), slots=MAX_IMPACTS
    )
    exact_ends, exact_sides = (
        np.stack([np.asarray(end_state.x), np.asarray(end_state.v)], axis=1),
        np.asarray(impacts.side),
    )
    params = DriveParameters(*(float(getattr(scene, key)) for key in ("frequency", "damping", "restitution")))
    runs = [
        [stepped(params, states, steps, bracket) for bracket in (BRACKET_WIDTH, FINE_BRACKET)]
        for steps in STEPS_PER_PERIOD
    ]
    yield _bracket_claim(runs, 2.0 * np.pi / params.frequency)
    errors = np.array([[_median_error(run, exact_ends, exact_sides) for run in pair] for pair in runs])
    errors_text = "; ".join(
        f"{steps} steps per period: {coarse:.2g}, the integrator alone {fine:.2g}"
        for steps, (coarse, fine) in zip(STEPS_PER_PERIOD, errors, strict=True)
    )
    order = np.log(errors[-2, 0] / errors[-1, 0]) / np.log(STEPS_PER_PERIOD[-1] / STEPS_PER_PERIOD[-2])
    text = (
        "with that bracket the error of a strobe decreases like the step, not like its fourth power:"
        f" {errors_text} (order)"
    )
    yield own_claim("method", text, (float(order), 0.1), low=0.8, high=1.2)


def _bracket_claim(runs, period):
    """Return the claim on the distance of the first contacts from those of the integrator, in steps."""
    distances = []
    for (coarse, fine), steps in zip(runs, STEPS_PER_PERIOD, strict=True):
        is_same_wall = (coarse.sides[:, 0] == fine.sides[:, 0]) & (coarse.sides[:, 0] != 0)
        distances.append(abs(coarse.times[is_same_wall, 0] - fine.times[is_same_wall, 0]).max() * steps / period)
    steps_text = ", ".join(f"{steps}" for steps in STEPS_PER_PERIOD)
    text = (
        f"a contact is bracketed to 1e-6 of a step (first contacts of {N_STARTS} starts, {steps_text} steps"
        " per period; largest "
        "distance from the crossing of the integrator, in steps)"
    )
    return statement_claim("method", text, (float(max(distances)), 2.0 * FINE_BRACKET), high=BRACKET_WIDTH)


def _median_error(run, exact_ends, exact_sides):
    """Return the median error of the states after a period, over motions with the exact sequence of impacts."""
    n_slots = min(exact_sides.shape[1], run.sides.shape[1])
    is_same = (run.sides[:, :n_slots] == exact_sides[:, :n_slots]).all(axis=1) & (exact_sides[:, 0] != 0)
    return float(np.median(abs(run.ends - exact_ends)[is_same].max(axis=1)))
