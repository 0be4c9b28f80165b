"""Numbers of a scene from samples of a motion: least squares of what is measured under shots that join.

A record is gone along from its beginning, as a frequency that is little off is much off in the phase of a late sample:
the motion found is flown on as far as its errors let it be known, and solved for anew. Where it leaves the record, and
at the beginning, many states and numbers that may be are tried, and those gone on with that go best along what follows.
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

MAX_ITERATIONS, ROUGH_TOLERANCE = (
    20,
    1e-2,
)  # of Newton's steps; of errors and scales: so short is the last while a record is gone along
N_VELOCITIES, N_LOOKAHEAD = 128, 6  # velocities that are tried; samples that choose among them
MAX_CANDIDATES, MAX_OPENINGS = 16, 4  # how many are begun with; how many are gone on with
N_DRAWS, N_PHASES = 256, 32  # numbers within their scales; phases
MATCH_ERRORS, SURE_ERRORS = (
    5.0,
    10.0,
)  # errors: so near a motion goes along a record; the record's: a state as sure is known
ERROR_FACTOR = 3.0  # than told: errors that a record may have, while it is gone along
MAX_DEVIATIONS = 2.0  # standard deviations of a chi2: more than as much above its mean is looked at again
SPEED_FACTOR = 2.0  # of what the motion measured, and the drive, would have as a harmonic one
CONSTRAINT_FRACTION = 0.1  # of the smallest error: as little may be left open
MISFIT_WIDTH = 0.1  # of the range of x: as far from a sample is not near
MIN_CLEARANCE_FRACTION = 0.25  # of a node's clearance is kept by a step
MAX_HALVINGS = 30


class Samples(NamedTuple):
    """What is fitted: the scene, the phase; the shots; what was measured, (record, 1) or (record, 2), the errors of
    both; what is free."""

    scene: Scene
    phase: float
    shots: Shots
    measurements: Float[np.ndarray, "record channels"]
    sigma: Float[np.ndarray, " channels"]
    free_params: FreeParameters

    def scene_and_phase(self, parameters: Float[np.ndarray, " free"]) -> tuple[Scene, float]:
        """(the scene with free numbers, the phase)."""
        return self.free_params.scene_and_phase(self.scene, self.phase, parameters)


def make_samples(scene: Scene, data: SampleRecord, free_params: FreeParameters) -> Samples:
    """The `Samples` of a record."""
    (measurements, sigma), phase = data.measured, data.phase or 0.0
    return Samples(
        scene, phase, lay_out_shots(scene, phase, data.times, measurements[:, 0]), measurements, sigma, free_params
    )


def follow_record(samples: Samples) -> LeastSquaresSolution | None:
    """The `LeastSquaresSolution` of a whole record; None where no motion goes along it."""
    for state, parameters in _start_candidates(samples):
        solution = _grow_solution(
            samples._replace(free_params=samples.free_params.with_start_phase(parameters)), state, parameters
        )
        if solution is not None:
            return solution
    return None


def _grow_solution(samples, state, parameters):
    """The `LeastSquaresSolution` of all shots, from the first one's state on: it is flown on from the last as far as it
    goes along the record, and then solved for anew. None where it breaks off."""
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
    """Whether noise, of errors that may be larger than told, may have made the record of what was found; at a grazing,
    where steps need not become short, it is as good as the last one."""
    chi2_limit = ERROR_FACTOR**2 * largest_chi2(len(solution.residuals) - 2)
    is_closed = solution.converged or solution.max_constraint <= CONSTRAINT_FRACTION * np.min(samples.sigma)
    return bool(is_closed and solution.chi2 + solution.prior_chi2 <= chi2_limit)


def _is_expensive(solution, new_solution):
    """Whether what came to a record cost more than noise does in nearly all."""
    n_new = len(new_solution.residuals) - len(solution.residuals)
    return _total_cost(new_solution) - _total_cost(solution) > n_new + MAX_DEVIATIONS * np.sqrt(2.0 * n_new)


def _draw_parameters(free_params, solution):
    """Numbers that may be, those found first."""
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
    """The `LeastSquaresSolution` with nodes more."""
    states = np.concatenate([solution.nodes, new_states])
    return _solve_nodes(samples, states, samples.free_params, solution.parameters, MAX_ITERATIONS, ROUGH_TOLERANCE)


def _predict_states(samples, solution):
    """States of the next nodes, as the last one flies on to them, up to where it leaves the record."""
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
    """The `LeastSquaresSolution` least squares of the whole record, with other free numbers, from what was found of
    it."""
    return _solve_nodes(samples, solution.nodes, free_params, solution.parameters)


def _solve_nodes(samples, states, free_params, parameters, *stop_settings):
    """The `LeastSquaresSolution` least squares from the first nodes' states and numbers near it; stop_settings: as of
    `least_squares.solved`."""
    shots = samples.shots.first_shots(len(states))
    problem = LeastSquaresProblem(
        partial(_linearise, samples, shots), _shift_nodes, partial(_max_step_fraction, samples, shots)
    )
    return least_squares.solve_least_squares(problem, states, free_params, parameters, *stop_settings)


def _linearise(samples, shots, states, parameters):
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
    order = np.argsort(sample_indices)  # that of the record
    values = np.concatenate([states, shot_results.values[is_used]])[order, :n_channels]
    rows = np.concatenate([np.arange(n_nodes), n_nodes + np.flatnonzero(is_used)])[order]
    value_jacobian = scipy.sparse.vstack([identity, derivatives], format="csr")[_channel_rows(rows, n_channels)]
    residuals = (values - samples.measurements[sample_indices[order]]) / samples.sigma
    inverse_errors = scipy.sparse.diags_array(np.tile(1.0 / samples.sigma, len(values)))
    return Linearisation(constraints.ravel(), constraint_jacobian, residuals.ravel(), inverse_errors @ value_jacobian)


def _channel_rows(state_indices, n_channels=2):
    """Rows of the x and v of places, or of x alone."""
    return (2 * state_indices[:, None] + np.arange(n_channels)).ravel()


def _shift_nodes(states, change):
    return states + change.reshape(-1, 2)


def _max_step_fraction(samples, shots, states, parameters, state_change, parameter_change):
    """How much of a step leaves all nodes between the walls."""
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
    """(first state, numbers), likely ones first: with the numbers as they are, then with others within their scales; at
    all phases where it is not known."""
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
    """[(state of a node, numbers)] that go along what follows it, likely ones first: the state as measured, or with
    each of many velocities; in each of some numbers, (several, free). check_indices: places of samples that choose
    among them, by default the next ones."""
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
    """Positions; those that noise put beyond a rigid wall, or nearly, are an error before it."""
    for side, wall in scene.walls.items():
        if not wall.soft:
            wall_motion = make_wall_motion(scene, side, phase)
            wall_limit = wall_motion.sign * wall_state(wall_motion, times)[0] - sigma
            x = wall_motion.sign * np.minimum(wall_motion.sign * x, wall_limit)
    return x
