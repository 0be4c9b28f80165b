"""Check the accuracy of the paper's integration method, which brackets contacts to 1e-6 of a step."""

import numpy as np

from ..maps.strobe import strobe
from ..scene.state import State
from .claim import additional_claim, statement_claim
from .fixed_step import BRACKET_WIDTH, MAX_IMPACTS, OscillatorParameters
from .fixed_step import fixed_step_strobe as stepped

N_STARTS, STEPS_PER_PERIOD = 4096, (100, 400, 1600)  # the paper does not state the steps per period
FINE_BRACKET = 1e-12  # relative to a step: the remaining error is that of the integrator


def accuracy_claims(scene):
    """Yield the claims on the accuracy of contacts and of the stroboscopic map; the walls must be at -1 and 1."""
    rng = np.random.default_rng(0)
    lower_bounds, upper_bounds = [-1.0, -3.0, 0.0], [1.0, 3.0, 6.0]
    state_rows = rng.uniform(lower_bounds, upper_bounds, (N_STARTS, len(lower_bounds)))
    end_state, impacts = strobe(
        scene.replace(amplitude=state_rows[:, 2]), State(state_rows[:, 0], state_rows[:, 1]), slots=MAX_IMPACTS
    )
    exact_end_states, exact_sides = (
        np.stack([np.asarray(end_state.x), np.asarray(end_state.v)], axis=1),
        np.asarray(impacts.side),
    )
    oscillator_params = OscillatorParameters(
        *(float(getattr(scene, parameter_name)) for parameter_name in ("frequency", "damping", "restitution"))
    )
    fixed_step_runs = [
        [
            stepped(oscillator_params, state_rows, steps_per_period, bracket_width)
            for bracket_width in (BRACKET_WIDTH, FINE_BRACKET)
        ]
        for steps_per_period in STEPS_PER_PERIOD
    ]
    yield _bracket_claim(fixed_step_runs, 2.0 * np.pi / oscillator_params.frequency)
    median_errors = np.array(
        [
            [_median_error(fixed_step_run, exact_end_states, exact_sides) for fixed_step_run in runs_by_bracket]
            for runs_by_bracket in fixed_step_runs
        ]
    )
    errors_text = "; ".join(
        f"{steps_per_period} steps per period: {paper_bracket_error:.2g}, the integrator alone {fine_bracket_error:.2g}"
        for steps_per_period, (paper_bracket_error, fine_bracket_error) in zip(
            STEPS_PER_PERIOD, median_errors, strict=True
        )
    )
    convergence_order = np.log(median_errors[-2, 0] / median_errors[-1, 0]) / np.log(
        STEPS_PER_PERIOD[-1] / STEPS_PER_PERIOD[-2]
    )
    claim_text = (
        "with that bracket the error of a strobe decreases like the step, not like its fourth power:"
        f" {errors_text} (order)"
    )
    yield additional_claim("method", claim_text, (float(convergence_order), 0.1), low=0.8, high=1.2)


def _bracket_claim(fixed_step_runs, period):
    """Return the claim on the error of the first contact times with the paper's bracket, in units of a step."""
    contact_time_errors = []
    for (paper_bracket_run, fine_bracket_run), steps_per_period in zip(fixed_step_runs, STEPS_PER_PERIOD, strict=True):
        is_same_wall = (paper_bracket_run.sides[:, 0] == fine_bracket_run.sides[:, 0]) & (
            paper_bracket_run.sides[:, 0] != 0
        )
        contact_time_errors.append(
            abs(paper_bracket_run.times[is_same_wall, 0] - fine_bracket_run.times[is_same_wall, 0]).max()
            * steps_per_period
            / period
        )
    steps_text = ", ".join(f"{steps_per_period}" for steps_per_period in STEPS_PER_PERIOD)
    claim_text = (
        f"a contact is bracketed to 1e-6 of a step (first contacts of {N_STARTS} starts, {steps_text} steps"
        " per period; largest "
        "distance from the crossing of the integrator, in steps)"
    )
    return statement_claim(
        "method", claim_text, (float(max(contact_time_errors)), 2.0 * FINE_BRACKET), high=BRACKET_WIDTH
    )


def _median_error(fixed_step_run, exact_end_states, exact_sides):
    """Return the median error of the final states over the motions with impacts whose sequence of walls is exact."""
    n_impact_slots = min(exact_sides.shape[1], fixed_step_run.sides.shape[1])
    has_exact_sequence = (fixed_step_run.sides[:, :n_impact_slots] == exact_sides[:, :n_impact_slots]).all(axis=1) & (
        exact_sides[:, 0] != 0
    )
    return float(np.median(abs(fixed_step_run.ends - exact_end_states)[has_exact_sequence].max(axis=1)))
