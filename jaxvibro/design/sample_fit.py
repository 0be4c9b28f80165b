"""Fit parameters of a scene to samples of a motion: least squares under continuity of consecutive shots.

A record is processed from its beginning, because a small error of the frequency is a large error of the phase of a late
sample. The motion is predicted as far as its errors allow, and solved again. At the beginning, and where the motion
leaves the record, many states and parameters are tried. The candidates that agree best with the next samples are
continued.
"""

from functools import partial
from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Float

from ..scene.scene import Scene, replace_unchecked
from . import least_squares
from .least_squares import FreeParameters, LeastSquaresProblem, LeastSquaresSolution, Linearisation, largest_chi2
from .next_impact import make_wall_motion, wall_state
from .records import SampleRecord
from .shooting import Shots, fly_shots, lay_out_shots, sample_motions, wall_clearances

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


class Samples(NamedTuple):
    """Problem of a fit: scene, phase, shots, measured values (record, channels), their errors, free parameters."""

    scene: Scene
    phase: float
    shots: Shots
    measurements: Float[np.ndarray, "record channels"]
    sigma: Float[np.ndarray, " channels"]
    free_params: FreeParameters

    def scene_and_phase(self, parameters: Float[np.ndarray, " free"]) -> tuple[Scene, float]:
        """Return the scene with the given parameters, and the phase."""
        return self.free_params.scene_and_phase(self.scene, self.phase, parameters)


def make_samples(scene: Scene, data: SampleRecord, free_params: FreeParameters) -> Samples:
    """Make the `Samples` of a record."""
    (measurements, sigma), phase = data.measured, data.phase or 0.0
    return Samples(
        scene, phase, lay_out_shots(scene, phase, data.times, measurements[:, 0]), measurements, sigma, free_params
    )


def follow_record(samples: Samples) -> LeastSquaresSolution | None:
    """Return the `LeastSquaresSolution` of a whole record, or None if no motion follows it."""
    for state, parameters in _start_candidates(samples):
        solution = _grow_solution(
            samples._replace(free_params=samples.free_params.with_start_phase(parameters)), state, parameters
        )
        if solution is not None:
            return solution
    return None


def _grow_solution(samples, state, parameters):
    """Extend the solution from the first shot to all shots, or return None if it breaks off.

    The motion is predicted from the last node as long as it follows the record, and then solved again.
    """
    solution = _solve_nodes(samples, state[None], samples.free_params, parameters, MAX_ITERATIONS, ROUGH_TOLERANCE)
    while _is_acceptable(samples, solution) and len(solution.nodes) < len(samples.shots.start_indices):
        next_states = _predict_states(samples, solution)
        new_solution = _add_nodes(samples, solution, next_states)
        if not _is_acceptable(samples, new_solution) and len(next_states) > 1:
            new_solution = _add_nodes(samples, solution, next_states[:1])
        if not _is_acceptable(samples, new_solution) or _is_expensive(solution, new_solution):
            alternatives = _state_candidates(
                samples, _draw_parameters(samples.free_params, solution), len(solution.nodes)
            )[:MAX_OPENINGS]
            alternatives = [
                _add_nodes(samples, solution._replace(parameters=parameters), node_state[None])
                for node_state, parameters in alternatives
            ]
            new_solution = min((new_solution, *alternatives), key=_total_cost)
        solution = new_solution
    return solution if _is_acceptable(samples, solution) else None


def _is_acceptable(samples, solution):
    """Check that noise may have made the record from the solution, with an allowance for underestimated errors.

    At a grazing, where steps need not become short, the last step is accepted.
    """
    chi2_limit = ERROR_FACTOR**2 * largest_chi2(len(solution.residuals) - 2)
    is_closed = solution.converged or solution.max_constraint <= CONSTRAINT_FRACTION * np.min(samples.sigma)
    return bool(is_closed and solution.chi2 + solution.prior_chi2 <= chi2_limit)


def _is_expensive(solution, new_solution):
    """Check whether additional samples cost more than noise nearly always does."""
    n_new = len(new_solution.residuals) - len(solution.residuals)
    return _total_cost(new_solution) - _total_cost(solution) > n_new + MAX_DEVIATIONS * np.sqrt(2.0 * n_new)


def _draw_parameters(free_params, solution):
    """Draw plausible parameters; the first are those of the solution."""
    remaining_range, deviations = (
        free_params.remaining_range(solution.parameters),
        np.random.default_rng(0).normal(size=(N_DRAWS, len(free_params.names))),
    )
    eigenvalues, eigenvectors = np.linalg.eigh(np.nan_to_num(solution.covariance))
    deviations = (deviations * np.sqrt(np.maximum(eigenvalues, 0.0))) @ eigenvectors.T
    return (
        solution.parameters
        + np.concatenate([0.0 * deviations[:1], np.clip(deviations, *remaining_range)]) * free_params.scales
    )


def _total_cost(solution):
    return solution.chi2 + solution.prior_chi2 if np.isfinite(solution.chi2) else np.inf


def _add_nodes(samples, solution, new_states):
    """Return the `LeastSquaresSolution` with additional nodes."""
    states = np.concatenate([solution.nodes, new_states])
    return _solve_nodes(samples, states, samples.free_params, solution.parameters, MAX_ITERATIONS, ROUGH_TOLERANCE)


def _predict_states(samples, solution):
    """Predict the states of the next nodes from the last one, up to the point at which the motion leaves the record."""
    n_nodes, n_channels, n_params = len(solution.nodes), len(samples.sigma), len(solution.parameters)
    names, phase = samples.free_params.split_phase(solution.parameters, samples.phase)
    covariance, state, sensitivity = (
        solution.covariance_with([2 * n_nodes - 2, 2 * n_nodes - 1]),
        solution.nodes[-1],
        np.eye(2, 2 + n_params),
    )
    states = []
    for k in range(n_nodes - 1, min(len(samples.shots.start_indices), 2 * n_nodes) - 1):
        shot = samples.shots.single_shot(k)
        shot_result = fly_shots(samples.scene, names, shot, state[None], solution.parameters[: len(names)], phase)
        derivatives = shot_result.derivatives[0, ..., : 2 + n_params] * np.append(
            [1.0, 1.0], samples.free_params.scales
        )
        derivatives = derivatives[..., :2] @ sensitivity + np.concatenate(
            [np.zeros((*derivatives.shape[:2], 2)), derivatives[..., 2:]], -1
        )
        if k >= n_nodes:
            errors = np.sqrt(np.maximum(np.einsum("tcu,uw,tcw->tc", derivatives, covariance, derivatives), 0.0))[
                :, :n_channels
            ]
            deviation = abs(shot_result.values[0, :, :n_channels] - samples.measurements[shot.sample_indices[0]])
            if not np.all(
                (deviation <= MATCH_ERRORS * np.hypot(errors, samples.sigma)) & (errors <= SURE_ERRORS * samples.sigma)
            ):
                return np.array(states[: max(1, len(states) - 1)])
        state, sensitivity = shot_result.values[0, -1], derivatives[-1]
        states.append(state)
    return np.array(states)


def solve_samples(
    samples: Samples, solution: LeastSquaresSolution, free_params: FreeParameters
) -> LeastSquaresSolution:
    """Solve the least squares of the whole record with other free parameters, from an earlier solution."""
    return _solve_nodes(samples, solution.nodes, free_params, solution.parameters)


def _solve_nodes(samples, states, free_params, parameters, *stop_settings):
    """Solve the least squares of the first shots from approximate states and parameters.

    `stop_settings` are those of `solve_least_squares`.
    """
    shots = samples.shots.first_shots(len(states))
    problem = LeastSquaresProblem(
        partial(_linearise, samples, shots), _shift_nodes, partial(_max_step_fraction, samples, shots)
    )
    return least_squares.solve_least_squares(problem, states, free_params, parameters, *stop_settings)


def _linearise(samples, shots, states, parameters):
    """Return the `Linearisation` of the shots at states and parameters."""
    names, phase = samples.free_params.split_phase(parameters, samples.phase)
    shot_results = fly_shots(samples.scene, names, shots, states, parameters[: len(names)], phase)
    n_nodes, n_times, n_params, n_channels = (
        len(states),
        shot_results.values.shape[1],
        len(parameters),
        len(samples.sigma),
    )
    derivatives = shot_results.derivatives[..., : 2 + n_params] * np.append([1.0, 1.0], samples.free_params.scales)
    node_column, derivative_indices = np.repeat(np.arange(n_nodes), 2 * n_times)[:, None], np.arange(2 + n_params)
    columns = np.where(
        derivative_indices < 2, 2 * node_column + derivative_indices, 2 * n_nodes - 2 + derivative_indices
    )
    derivatives = scipy.sparse.csr_array(
        (derivatives.ravel(), columns.ravel(), np.arange(0, derivatives.size + 1, 2 + n_params))
    )
    identity = scipy.sparse.eye_array(2 * n_nodes, 2 * n_nodes + n_params, format="csr")
    inner_nodes, end_indices = np.arange(n_nodes - 1), shots.n_samples[:-1] - 1
    constraints, constraint_jacobian = (
        shot_results.values[inner_nodes, end_indices] - states[1:],
        derivatives[_channel_rows(inner_nodes * n_times + end_indices)] - identity[2:],
    )
    is_used = np.arange(n_times) < shots.n_samples[:, None] - (np.arange(n_nodes) < n_nodes - 1)[:, None]
    sample_indices = np.concatenate([shots.start_indices, shots.sample_indices[is_used]])
    order = np.argsort(sample_indices)  # order of the record
    values = np.concatenate([states, shot_results.values[is_used]])[order, :n_channels]
    rows = np.concatenate([np.arange(n_nodes), n_nodes + np.flatnonzero(is_used)])[order]
    value_jacobian = scipy.sparse.vstack([identity, derivatives], format="csr")[_channel_rows(rows, n_channels)]
    residuals = (values - samples.measurements[sample_indices[order]]) / samples.sigma
    inverse_errors = scipy.sparse.diags_array(np.tile(1.0 / samples.sigma, len(values)))
    return Linearisation(constraints.ravel(), constraint_jacobian, residuals.ravel(), inverse_errors @ value_jacobian)


def _channel_rows(state_indices, n_channels=2):
    """Return the rows of x and v, or of x alone, of states."""
    return (2 * state_indices[:, None] + np.arange(n_channels)).ravel()


def _shift_nodes(states, change):
    return states + change.reshape(-1, 2)


def _max_step_fraction(samples, shots, states, parameters, state_change, parameter_change):
    """Return the largest tried fraction of a step that keeps all nodes between the walls."""
    times, fraction = shots.times[shots.start_indices], 1.0
    clearances_before = wall_clearances(*samples.scene_and_phase(parameters), times, states[:, 0])
    for _ in range(MAX_HALVINGS):
        moved_scene = samples.scene_and_phase(parameters + fraction * parameter_change)
        if np.all(
            wall_clearances(*moved_scene, times, _shift_nodes(states, fraction * state_change)[:, 0])
            >= MIN_CLEARANCE_FRACTION * clearances_before
        ):
            break
        fraction *= 0.5
    return fraction


def _start_candidates(samples):
    """Yield (first state, parameters) in order of plausibility.

    The initial parameters come first, then others within their scales; all phases if the phase is unknown.
    """
    free_params, times = samples.free_params, samples.shots.times
    if free_params.names[-1] == "phase":
        angles = 2.0 * np.pi * np.arange(N_PHASES) / N_PHASES
        period = 2.0 * np.pi / float(samples.scene.frequency)
        late_indices = np.searchsorted(times, times[0] + np.arange(1, N_LOOKAHEAD + 1) * period / N_LOOKAHEAD)
        check_indices = np.maximum(np.minimum(late_indices, len(times) - 1), np.arange(1, N_LOOKAHEAD + 1))
        yield from _state_candidates(
            samples, np.stack([np.append(free_params.start_values[:-1], angle) for angle in angles]), 0, check_indices
        )
        return
    yield from _state_candidates(samples, free_params.start_values[None], 0)[:MAX_OPENINGS]
    deviations = np.clip(
        np.random.default_rng(0).normal(size=(N_DRAWS, len(free_params.names))), free_params.lower, free_params.upper
    )
    yield from _state_candidates(samples, free_params.start_values + deviations * free_params.scales, 0)


def _state_candidates(samples, parameters, node_index, check_indices=None):
    """Return [(state of a node, parameters)] that agree with the following samples, in order of plausibility.

    The state is as measured, or has one of many velocities. `parameters` has shape (candidates, free). `check_indices`
    are the samples that rank the candidates, by default the next ones.
    """
    sample_index, times, measurements = (
        samples.shots.start_indices[node_index],
        samples.shots.times,
        samples.measurements,
    )
    scene, phase = samples.scene_and_phase(parameters[0])
    x = _clip_to_walls(scene, phase, times[sample_index], measurements[sample_index, 0], samples.sigma[0])
    ranges = np.maximum(np.ptp(measurements, axis=0), samples.sigma)
    force_amplitude = sum((abs(float(term.amplitude)) for term in scene.drive), abs(float(scene.amplitude)))
    max_speed = SPEED_FACTOR * max(1.0, float(scene.frequency)) * (ranges[0] + force_amplitude)
    speeds = measurements[sample_index, 1:] if len(ranges) > 1 else max_speed * np.linspace(-1.0, 1.0, N_VELOCITIES)
    parameter_rows, trial_speeds = np.repeat(parameters, len(speeds), axis=0), np.tile(speeds, len(parameters))
    names, phases = samples.free_params.split_phase(parameter_rows.T, samples.phase)
    scenes = replace_unchecked(scene, dict(zip(names, parameter_rows.T, strict=False)))
    check_indices = np.minimum(
        sample_index + np.arange(1, N_LOOKAHEAD + 1) if check_indices is None else check_indices, len(times) - 1
    )
    states, start_times = (
        np.stack([np.full(len(trial_speeds), x), trial_speeds], 1),
        np.full(len(trial_speeds), times[sample_index]),
    )
    predictions = sample_motions(
        scenes, phases, states, start_times, np.tile(times[check_indices], (len(trial_speeds), 1))
    )[..., : len(ranges)]
    deviations = np.nan_to_num((predictions - measurements[check_indices]) / (MISFIT_WIDTH * ranges), nan=np.inf)
    cost = np.sum(np.minimum(deviations**2, 1.0), axis=(1, 2)).reshape(len(parameters), -1)
    padded_cost = np.pad(cost, ((0, 0), (1, 1)), constant_values=np.inf)
    minima = np.flatnonzero((cost <= padded_cost[:, :-2]) & (cost < padded_cost[:, 2:]))
    minima = minima[np.argsort(cost.ravel()[minima], kind="stable")][:MAX_CANDIDATES]
    return [(states[k], parameter_rows[k]) for k in minima]


def _clip_to_walls(scene, phase, times, x, sigma):
    """Move positions that noise puts beyond a rigid wall, or close to it, to one standard error before it."""
    for side, wall in scene.walls.items():
        if not wall.soft:
            wall_motion = make_wall_motion(scene, side, phase)
            wall_limit = wall_motion.sign * wall_state(wall_motion, times)[0] - sigma
            x = wall_motion.sign * np.minimum(wall_motion.sign * x, wall_limit)
    return x
