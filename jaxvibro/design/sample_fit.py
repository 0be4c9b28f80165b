"""Fit parameters of a scene to samples of a motion by least squares, with continuous consecutive shots.

A record is processed from its beginning, because a small error of the frequency causes a large error of the phase of a
late sample. The motion is predicted as far as its errors allow, and the fit is then repeated with the additional
samples. At the beginning, and where the prediction deviates from the record, many states and parameters are tried. The
candidates that agree best with the next samples are continued.
"""

from functools import partial
from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Float

from ..scene.scene import replace_unchecked, rigid_wall_positions
from . import constrained_least_squares
from .constrained_least_squares import (
    FreeParameterSpec,
    LeastSquaresProblem,
    LeastSquaresSolution,
    Linearisation,
    max_plausible_chi2,
)
from .multiple_shooting import Shots, divide_into_shots, rigid_wall_clearances, sample_motions, simulate_shots
from .records import SampleRecord

# Newton steps; tolerance of the step while the record is followed, in standard errors and scales
MAX_ITERATIONS, ROUGH_TOLERANCE = 20, 1e-2
N_VELOCITIES, N_LOOKAHEAD = 128, 6  # trial velocities; samples that rank them
MAX_CANDIDATES, MAX_OPENINGS = 16, 4  # candidates at the beginning; candidates that are continued
N_DRAWS, N_PHASES = 256, 32  # random parameters within their scales; phases
# Largest deviation of a motion that follows the record, in standard errors; largest error of a certain state, in errors
# of the record.
MATCH_ERRORS, SURE_ERRORS = 5.0, 10.0
ERROR_FACTOR = 3.0  # ratio of the true errors to the given errors that is tolerated while the record is followed
MAX_DEVIATIONS = 2.0  # in standard deviations: a chi2 farther above its mean is examined again
SPEED_FACTOR = 2.0  # relative to the speed of a harmonic motion with the measured range and the drive
CONSTRAINT_FRACTION = 0.1  # relative to the smallest error: tolerated violation of the constraints
MISFIT_WIDTH = 0.1  # relative to the range of x: deviation that counts as a full misfit
MIN_CLEARANCE_FRACTION = 0.25  # fraction of the clearance of a node that a step keeps
MAX_HALVINGS = 30


class SampleFitProblem(NamedTuple):
    """Problem of a fit to a record of samples.

    Attributes
    ----------
    shots : Shots
        Shots of the record.
    measurements : numpy.ndarray
        Measured values of x, or of x and v. Array of shape (record, channels).
    sigma : numpy.ndarray
        Standard error of each channel. Array of shape (channels,).
    free_spec : FreeParameterSpec
        Initial scene and its free parameters.
    """

    shots: Shots
    measurements: Float[np.ndarray, "record channels"]
    sigma: Float[np.ndarray, " channels"]
    free_spec: FreeParameterSpec


def make_sample_problem(data: SampleRecord, free_spec: FreeParameterSpec) -> SampleFitProblem:
    """Make the `SampleFitProblem` of a record. A free phase is 0 in the division into shots."""
    measurements, sigma = data.measured
    shots = divide_into_shots(free_spec.scene, free_spec.phase, data.times, measurements[:, 0])
    return SampleFitProblem(shots, measurements, sigma, free_spec)


def follow_sample_record(fit_problem: SampleFitProblem) -> LeastSquaresSolution | None:
    """Fit a whole record; return the `LeastSquaresSolution`, or None if no motion agrees with the record."""
    for state, parameters in _first_state_candidates(fit_problem):
        solution = _extend_to_whole_record(
            fit_problem._replace(free_spec=fit_problem.free_spec.with_start_phase(parameters)), state, parameters
        )
        if solution is not None:
            return solution
    return None


def _extend_to_whole_record(fit_problem, state, parameters):
    """Fit the first shot and extend the solution to all shots, or return None if the solution becomes unacceptable.

    The motion is predicted from the last node as long as it agrees with the record. The fit is then repeated with the
    new nodes.
    """
    solution = solve_first_shots(
        fit_problem, state[None], fit_problem.free_spec, parameters, MAX_ITERATIONS, ROUGH_TOLERANCE
    )
    while _is_acceptable_solution(fit_problem, solution) and len(solution.nodes) < len(fit_problem.shots.start_indices):
        predicted_states = _simulate_next_nodes(fit_problem, solution)
        longer_solution = _refit_with_more_nodes(fit_problem, solution, predicted_states)
        if not _is_acceptable_solution(fit_problem, longer_solution) and len(predicted_states) > 1:
            longer_solution = _refit_with_more_nodes(fit_problem, solution, predicted_states[:1])
        if not _is_acceptable_solution(fit_problem, longer_solution) or _is_extension_expensive(
            solution, longer_solution
        ):
            alternative_solutions = _rank_state_candidates(
                fit_problem, _draw_plausible_params(fit_problem.free_spec, solution), len(solution.nodes)
            )[:MAX_OPENINGS]
            alternative_solutions = [
                _refit_with_more_nodes(fit_problem, solution._replace(parameters=parameters), node_state[None])
                for node_state, parameters in alternative_solutions
            ]
            longer_solution = min((longer_solution, *alternative_solutions), key=_total_cost)
        solution = longer_solution
    return solution if _is_acceptable_solution(fit_problem, solution) else None


def _is_acceptable_solution(fit_problem, solution):
    """Check that noise explains the residuals of a solution, with an allowance for underestimated errors.

    A solution that has not converged is accepted if its shots are continuous, because at a grazing the steps of the
    iteration need not become short.
    """
    max_chi2 = ERROR_FACTOR**2 * max_plausible_chi2(len(solution.residuals) - 2)
    is_continuous = solution.converged or solution.max_constraint <= CONSTRAINT_FRACTION * np.min(fit_problem.sigma)
    return bool(is_continuous and solution.chi2 + solution.prior_chi2 <= max_chi2)


def _is_extension_expensive(solution, longer_solution):
    """Return True if additional samples increase the cost by more than noise plausibly does."""
    n_new_residuals = len(longer_solution.residuals) - len(solution.residuals)
    return _total_cost(longer_solution) - _total_cost(solution) > n_new_residuals + MAX_DEVIATIONS * np.sqrt(
        2.0 * n_new_residuals
    )


def _draw_plausible_params(free_spec, solution):
    """Draw random parameters from the covariance of a solution; the first row holds the parameters of the solution."""
    change_bounds, parameter_deviations = (
        free_spec.remaining_change_bounds(solution.parameters),
        np.random.default_rng(0).normal(size=(N_DRAWS, len(free_spec.names))),
    )
    principal_variances, principal_directions = np.linalg.eigh(np.nan_to_num(solution.covariance))
    parameter_deviations = (
        parameter_deviations * np.sqrt(np.maximum(principal_variances, 0.0))
    ) @ principal_directions.T
    return (
        solution.parameters
        + np.concatenate([0.0 * parameter_deviations[:1], np.clip(parameter_deviations, *change_bounds)])
        * free_spec.scales
    )


def _total_cost(solution):
    return solution.chi2 + solution.prior_chi2 if np.isfinite(solution.chi2) else np.inf


def _refit_with_more_nodes(fit_problem, solution, new_states):
    """Fit a solution again with additional nodes; return the `LeastSquaresSolution`."""
    node_states = np.concatenate([solution.nodes, new_states])
    return solve_first_shots(
        fit_problem, node_states, fit_problem.free_spec, solution.parameters, MAX_ITERATIONS, ROUGH_TOLERANCE
    )


def _simulate_next_nodes(fit_problem, solution):
    """Predict the states of the next nodes from the last node.

    The prediction continues as long as the motion agrees with the record and its standard errors are small. The number
    of predicted nodes is at least 1 and at most the number of nodes of the solution.
    """
    n_nodes, n_channels, n_params = len(solution.nodes), len(fit_problem.sigma), len(solution.parameters)
    covariance, state, state_sensitivity = (
        solution.covariance_with([2 * n_nodes - 2, 2 * n_nodes - 1]),
        solution.nodes[-1],
        np.eye(2, 2 + n_params),
    )
    predicted_states = []
    for shot_index in range(n_nodes - 1, min(len(fit_problem.shots.start_indices), 2 * n_nodes) - 1):
        shot = fit_problem.shots.single_shot(shot_index)
        sample_values, sample_derivatives = (
            shot_results[0]
            for shot_results in simulate_shots(fit_problem.free_spec, shot, state[None], solution.parameters)
        )
        sample_derivatives = sample_derivatives[..., :2] @ state_sensitivity + np.concatenate(
            [np.zeros((*sample_derivatives.shape[:2], 2)), sample_derivatives[..., 2:]], -1
        )
        if shot_index >= n_nodes:
            prediction_errors = np.sqrt(
                np.maximum(np.einsum("tcu,uw,tcw->tc", sample_derivatives, covariance, sample_derivatives), 0.0)
            )[:, :n_channels]
            sample_deviations = abs(sample_values[:, :n_channels] - fit_problem.measurements[shot.sample_indices[0]])
            if not np.all(
                (sample_deviations <= MATCH_ERRORS * np.hypot(prediction_errors, fit_problem.sigma))
                & (prediction_errors <= SURE_ERRORS * fit_problem.sigma)
            ):
                return np.array(predicted_states[: max(1, len(predicted_states) - 1)])
        state, state_sensitivity = sample_values[-1], sample_derivatives[-1]
        predicted_states.append(state)
    return np.array(predicted_states)


def solve_first_shots(fit_problem, node_states, free_spec, parameters, *stop_settings):
    """Fit the first shots from approximate states of their nodes and approximate parameters.

    `stop_settings` are the last arguments of `solve_least_squares`.
    """
    shots = fit_problem.shots.first_shots(len(node_states))
    problem = LeastSquaresProblem(
        partial(_linearise_shots, fit_problem, shots), _add_node_change, partial(_max_step_fraction, fit_problem, shots)
    )
    return constrained_least_squares.solve_least_squares(problem, node_states, free_spec, parameters, *stop_settings)


def _linearise_shots(fit_problem, shots, node_states, parameters):
    """Return the `Linearisation` of the shots at states of the nodes and parameters."""
    values, state_jacobian = simulate_shots(fit_problem.free_spec, shots, node_states, parameters)
    n_nodes, max_samples_per_shot, n_params, n_channels = (
        len(node_states),
        values.shape[1],
        len(parameters),
        len(fit_problem.sigma),
    )
    node_of_row, derivative_columns = (
        np.repeat(np.arange(n_nodes), 2 * max_samples_per_shot)[:, None],
        np.arange(2 + n_params),
    )
    jacobian_columns = np.where(
        derivative_columns < 2, 2 * node_of_row + derivative_columns, 2 * n_nodes - 2 + derivative_columns
    )
    state_jacobian = scipy.sparse.csr_array(
        (state_jacobian.ravel(), jacobian_columns.ravel(), np.arange(0, state_jacobian.size + 1, 2 + n_params))
    )
    node_jacobian = scipy.sparse.eye_array(2 * n_nodes, 2 * n_nodes + n_params, format="csr")
    inner_node_indices, shot_end_indices = np.arange(n_nodes - 1), shots.n_samples[:-1] - 1
    constraints, constraint_jacobian = (
        values[inner_node_indices, shot_end_indices] - node_states[1:],
        state_jacobian[_rows_of_states(inner_node_indices * max_samples_per_shot + shot_end_indices)]
        - node_jacobian[2:],
    )
    is_sample_of_shot = (
        np.arange(max_samples_per_shot) < shots.n_samples[:, None] - (np.arange(n_nodes) < n_nodes - 1)[:, None]
    )
    sample_indices = np.concatenate([shots.start_indices, shots.sample_indices[is_sample_of_shot]])
    record_order = np.argsort(sample_indices)  # order of the record
    computed_values = np.concatenate([node_states, values[is_sample_of_shot]])[record_order, :n_channels]
    sample_state_indices = np.concatenate([np.arange(n_nodes), n_nodes + np.flatnonzero(is_sample_of_shot)])[
        record_order
    ]
    value_jacobian = scipy.sparse.vstack([node_jacobian, state_jacobian], format="csr")[
        _rows_of_states(sample_state_indices, n_channels)
    ]
    residuals = (computed_values - fit_problem.measurements[sample_indices[record_order]]) / fit_problem.sigma
    inverse_error_matrix = scipy.sparse.diags_array(np.tile(1.0 / fit_problem.sigma, len(computed_values)))
    return Linearisation(
        constraints.ravel(), constraint_jacobian, residuals.ravel(), inverse_error_matrix @ value_jacobian
    )


def _rows_of_states(state_indices, n_channels=2):
    """Return the indices of x and v, or of x alone, of some states in an array that lists x, v of all states."""
    return (2 * state_indices[:, None] + np.arange(n_channels)).ravel()


def _add_node_change(node_states, node_change):
    return node_states + node_change.reshape(-1, 2)


def _max_step_fraction(fit_problem, shots, node_states, parameters, node_change, parameter_change):
    """Return the largest tried fraction of a step that keeps all nodes between the rigid walls.

    The clearance of each node may decrease to `MIN_CLEARANCE_FRACTION` of its value before the step.
    """
    times, fraction = shots.times[shots.start_indices], 1.0
    free_spec = fit_problem.free_spec
    clearances_before = rigid_wall_clearances(*free_spec.scene_and_start_phase(parameters), times, node_states[:, 0])
    for _ in range(MAX_HALVINGS):
        scene_and_phase = free_spec.scene_and_start_phase(parameters + fraction * parameter_change)
        if np.all(
            rigid_wall_clearances(*scene_and_phase, times, _add_node_change(node_states, fraction * node_change)[:, 0])
            >= MIN_CLEARANCE_FRACTION * clearances_before
        ):
            break
        fraction *= 0.5
    return fraction


def _first_state_candidates(fit_problem):
    """Yield (first state, parameters): candidates with the initial parameters, then with random parameters.

    Each group is in order of decreasing plausibility. The random parameters are normally distributed about the initial
    ones, with their scales as standard deviations, and lie within the bounds. If the phase is unknown, the initial
    parameters are combined with many phases instead of random parameters.
    """
    free_spec, times = fit_problem.free_spec, fit_problem.shots.times
    if free_spec.names[-1] == "phase":
        start_phases = 2.0 * np.pi * np.arange(N_PHASES) / N_PHASES
        period = 2.0 * np.pi / float(free_spec.scene.frequency)
        lookahead_indices = np.searchsorted(times, times[0] + np.arange(1, N_LOOKAHEAD + 1) * period / N_LOOKAHEAD)
        ranking_indices = np.maximum(np.minimum(lookahead_indices, len(times) - 1), np.arange(1, N_LOOKAHEAD + 1))
        yield from _rank_state_candidates(
            fit_problem,
            np.stack([np.append(free_spec.start_values[:-1], start_phase) for start_phase in start_phases]),
            0,
            ranking_indices,
        )
        return
    yield from _rank_state_candidates(fit_problem, free_spec.start_values[None], 0)[:MAX_OPENINGS]
    parameter_deviations = np.clip(
        np.random.default_rng(0).normal(size=(N_DRAWS, len(free_spec.names))), free_spec.lower, free_spec.upper
    )
    yield from _rank_state_candidates(fit_problem, free_spec.start_values + parameter_deviations * free_spec.scales, 0)


def _rank_state_candidates(fit_problem, candidate_parameters, node_index, ranking_indices=None):
    """Return [(state of a node, parameters)] that agree with the following samples, the most plausible first.

    The position is the measured position. The velocity is the measured velocity, or a trial velocity if the record
    contains no velocities. `candidate_parameters` has shape (candidates, free). `ranking_indices` are the indices of
    the samples that rank the candidates, by default those of the next samples.
    """
    sample_index, times, measurements = (
        fit_problem.shots.start_indices[node_index],
        fit_problem.shots.times,
        fit_problem.measurements,
    )
    scene, start_phase = fit_problem.free_spec.scene_and_start_phase(candidate_parameters[0])
    left_wall, right_wall = rigid_wall_positions(scene, start_phase + float(scene.frequency) * times[sample_index])
    x = np.clip(measurements[sample_index, 0], left_wall + fit_problem.sigma[0], right_wall - fit_problem.sigma[0])
    measurement_ranges = np.maximum(np.ptp(measurements, axis=0), fit_problem.sigma)
    force_amplitude = sum((abs(float(term.amplitude)) for term in scene.drive), abs(float(scene.amplitude)))
    max_speed = SPEED_FACTOR * max(1.0, float(scene.frequency)) * (measurement_ranges[0] + force_amplitude)
    velocities = (
        measurements[sample_index, 1:]
        if len(measurement_ranges) > 1
        else max_speed * np.linspace(-1.0, 1.0, N_VELOCITIES)
    )
    trial_parameters, trial_velocities = (
        np.repeat(candidate_parameters, len(velocities), axis=0),
        np.tile(velocities, len(candidate_parameters)),
    )
    parameter_names, start_phases = fit_problem.free_spec.separate_start_phase(trial_parameters.T)
    scenes = replace_unchecked(scene, dict(zip(parameter_names, trial_parameters.T, strict=False)))
    ranking_indices = np.minimum(
        sample_index + np.arange(1, N_LOOKAHEAD + 1) if ranking_indices is None else ranking_indices, len(times) - 1
    )
    states, start_times = (
        np.stack([np.full(len(trial_velocities), x), trial_velocities], 1),
        np.full(len(trial_velocities), times[sample_index]),
    )
    predictions = sample_motions(
        scenes, start_phases, states, start_times, np.tile(times[ranking_indices], (len(trial_velocities), 1))
    )[..., : len(measurement_ranges)]
    scaled_deviations = np.nan_to_num(
        (predictions - measurements[ranking_indices]) / (MISFIT_WIDTH * measurement_ranges), nan=np.inf
    )
    misfit_costs = np.sum(np.minimum(scaled_deviations**2, 1.0), axis=(1, 2)).reshape(len(candidate_parameters), -1)
    padded_costs = np.pad(misfit_costs, ((0, 0), (1, 1)), constant_values=np.inf)
    minimum_indices = np.flatnonzero((misfit_costs <= padded_costs[:, :-2]) & (misfit_costs < padded_costs[:, 2:]))
    minimum_indices = minimum_indices[np.argsort(misfit_costs.ravel()[minimum_indices], kind="stable")][:MAX_CANDIDATES]
    return [(states[candidate_index], trial_parameters[candidate_index]) for candidate_index in minimum_indices]
