"""Represent and fit chains of impacts that explain a record with missing and spurious impacts.

The functions fit a chain, extend it, insert an impact that is missing from the record, or remove an impact.
`impact_chain_search` decides which changes are tried, and in which order.
"""

from itertools import product
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from ..scene.scene import SIDES
from ..scene.soft_walls import effective_restitution
from . import impact_chain_equations
from .constrained_least_squares import FreeParameterSpec, LeastSquaresSolution, max_plausible_chi2
from .impact_chain_equations import ChainNodes, TimeMeasurements, flight_residuals, speeds_between_impacts
from .impact_prediction import min_clearances

# Penalties added to chi2: for each missing and each spurious impact, and for a chain that is not a motion.
MISSED_COST, SPURIOUS_COST, IMPOSSIBLE_COST = 6.0, 14.0, 1e6
GRID_SIZE = 24  # grid points of the time of an inserted impact
MAX_GRID_MINIMA = 2  # minima on a grid that are tried
# Newton steps; tolerance of the step during the search, in standard errors and scales
MAX_ITERATIONS, ROUGH_TOLERANCE = 25, 1e-2
MIN_RESTITUTION = 0.05  # smaller restitutions do not determine the speed before an impact from that after it
MAX_DEPTH_ERRORS = 4.0  # in standard errors of the penetration: a deeper flight passes through the wall


class ImpactChain(NamedTuple):
    """Fitted chain of impacts.

    Attributes
    ----------
    record_indices : numpy.ndarray
        Index in the record of the impact of each node, -1 for an impact that is missing from the record. Array of shape
        (nodes,).
    spurious_indices : tuple of int
        Indices of the impacts of the record that have no node.
    solution : LeastSquaresSolution
        Fitted nodes and parameters.
    cost : float
        chi2 of the residuals and of the prior, plus penalties for missing and spurious impacts and for a chain that is
        not a motion.
    """

    record_indices: Int[np.ndarray, " nodes"]
    spurious_indices: tuple[int, ...]
    solution: LeastSquaresSolution
    cost: float


class ImpactFitProblem(NamedTuple):
    """Problem of a fit to a record of impacts.

    Attributes
    ----------
    times, sides, sigma : numpy.ndarray
        Times, sides and standard errors of the impacts of the record. Arrays of shape (record,).
    free_spec : FreeParameterSpec
        Initial scene and its free parameters.
    """

    times: Float[np.ndarray, " record"]
    sides: Float[np.ndarray, " record"]
    sigma: Float[np.ndarray, " record"]
    free_spec: FreeParameterSpec


class ImpactChainGuess(NamedTuple):
    """Approximate chain that is not yet fitted.

    Attributes
    ----------
    record_indices : numpy.ndarray
        Index in the record of the impact of each node, -1 for an impact that is missing from the record. Array of shape
        (nodes,).
    sides, times, speeds : numpy.ndarray
        Sides, times and speeds of the impacts. An unknown speed is nan. Arrays of shape (nodes,).
    spurious_indices : tuple of int
        Indices of the impacts of the record that have no node.
    parameters : numpy.ndarray
        Approximate values of the free parameters. Array of shape (free,).
    """

    record_indices: Int[np.ndarray, " nodes"]
    sides: Float[np.ndarray, " nodes"]
    times: Float[np.ndarray, " nodes"]
    speeds: Float[np.ndarray, " nodes"]
    spurious_indices: tuple[int, ...]
    parameters: Float[np.ndarray, " free"]


def fit_chain(fit_problem: ImpactFitProblem, chain_guess: ImpactChainGuess) -> ImpactChain:
    """Fit an `ImpactChainGuess`. The flights that connect the impacts give initial values of unknown speeds."""
    scene, start_phase = fit_problem.free_spec.scene_and_start_phase(chain_guess.parameters)
    times = _separate_times(chain_guess.times, fit_problem.sigma[0])
    speeds_after, speeds_before = speeds_between_impacts(scene, chain_guess.sides, times, start_phase)
    first_restitution = max(restitutions_on_sides(scene, chain_guess.sides[:1])[0], MIN_RESTITUTION)
    approach_speeds = np.append(speeds_after[0] / first_restitution, speeds_before)
    speeds = np.where(np.isnan(chain_guess.speeds), approach_speeds, chain_guess.speeds)
    solution = impact_chain_equations.fit_chain_parameters(
        ChainNodes(chain_guess.sides, times, speeds),
        chain_measurements(fit_problem, chain_guess),
        fit_problem.free_spec,
        chain_guess.parameters,
        MAX_ITERATIONS,
        ROUGH_TOLERANCE,
    )
    cost = (
        solution.chi2
        + solution.prior_chi2
        + MISSED_COST * np.sum(chain_guess.record_indices < 0)
        + SPURIOUS_COST * len(chain_guess.spurious_indices)
    )
    return ImpactChain(
        chain_guess.record_indices,
        chain_guess.spurious_indices,
        solution,
        float(cost if is_possible_motion(fit_problem.free_spec, solution) else IMPOSSIBLE_COST + cost),
    )


def chain_measurements(fit_problem, chain):
    """Return the `TimeMeasurements` of the nodes of a chain."""
    node_indices = np.flatnonzero(chain.record_indices >= 0)
    record_indices = chain.record_indices[node_indices]
    return TimeMeasurements(node_indices, fit_problem.times[record_indices], fit_problem.sigma[record_indices])


def is_possible_motion(free_spec, solution):
    """Check that a fitted chain is a motion of its scene, within the errors.

    The fit must have converged, each impact speed must be positive, and no flight may pass through a wall.
    """
    if not solution.converged or np.any(solution.nodes.speeds <= 0):
        return False
    clearances, nearest_sides, closest_times = min_clearances(
        *free_spec.scene_and_start_phase(solution.parameters), solution.nodes
    )
    return all(
        _is_depth_within_error(
            free_spec,
            solution,
            flight_index,
            nearest_sides[flight_index],
            closest_times[flight_index],
            -clearances[flight_index],
        )
        for flight_index in np.flatnonzero(clearances < 0).tolist()
    )


def _is_depth_within_error(free_spec, solution, flight_index, wall_side, closest_time, depth):
    """Check that the depth to which a flight penetrates a wall at a time is within the error of this depth."""
    nodes, n_params = solution.nodes, len(solution.parameters)
    node_pair = ChainNodes(
        np.array([nodes.sides[flight_index], wall_side]),
        np.array([nodes.times[flight_index], closest_time]),
        np.array([nodes.speeds[flight_index], 0.0]),
    )
    depth_derivatives = flight_residuals(free_spec, node_pair, solution.parameters)[1][0, 0]
    depth_derivatives = depth_derivatives[[0, 1, *range(4, 4 + n_params)]]
    covariance = solution.covariance_with([2 * flight_index, 2 * flight_index + 1])
    return bool(depth <= MAX_DEPTH_ERRORS * np.sqrt(max(depth_derivatives @ covariance @ depth_derivatives, 0.0)))


def is_acceptable_chain(chain: ImpactChain) -> bool:
    """Check that a chain is a motion and that noise explains its deviations from the record."""
    solution = chain.solution
    return bool(
        chain.cost < IMPOSSIBLE_COST
        and solution.chi2 + solution.prior_chi2 <= max_plausible_chi2(len(solution.residuals) - 2)
    )


def _separate_times(times, sigma):
    """Return increasing times, separated by at least half a standard error."""
    times = np.array(times)
    for k in range(1, len(times)):
        times[k] = max(times[k], times[k - 1] + 0.5 * sigma)
    return times


def restitutions_on_sides(scene, sides):
    """Return the restitutions of the walls on the given sides; soft walls have an effective restitution."""
    restitution_by_side = {side: _wall_restitution(scene, SIDES[int(side > 0)]) for side in set(sides)}
    return np.array([restitution_by_side[side] for side in sides])


def _wall_restitution(scene, side):
    wall = scene.walls[side]
    if not wall.soft:
        return float(scene.bounce(side))
    return float(effective_restitution(wall.stiffness, scene.parameter(f"{side}.damping")))


def wall_side_codes(scene):
    """Return the sides, -1 and 1, of the walls of a scene."""
    return tuple(-1.0 if side == "left" else 1.0 for side in scene.walls)


def guess_from_record(fit_problem: ImpactFitProblem, parameters, record_indices) -> ImpactChainGuess:
    """Return the `ImpactChainGuess` of some impacts of the record, with unknown speeds."""
    record_indices = np.asarray(record_indices, int)
    return ImpactChainGuess(
        record_indices,
        fit_problem.sides[record_indices],
        fit_problem.times[record_indices],
        np.full(len(record_indices), np.nan),
        (),
        parameters,
    )


def guess_from_chain(chain: ImpactChain) -> ImpactChainGuess:
    """Return a fitted chain as an `ImpactChainGuess`."""
    nodes, solution = chain.solution.nodes, chain.solution
    return ImpactChainGuess(
        chain.record_indices,
        nodes.sides,
        nodes.times,
        nodes.speeds,
        chain.spurious_indices,
        solution.parameters,
    )


def join_guesses(chain_guess: ImpactChainGuess, other_guess: ImpactChainGuess, time_direction: int) -> ImpactChainGuess:
    """Append `other_guess` to `chain_guess`, or prepend it if `time_direction` is -1.

    Parameters and spurious impacts are those of `chain_guess`.
    """
    ordered_guesses = (chain_guess, other_guess) if time_direction > 0 else (other_guess, chain_guess)
    columns = [
        np.concatenate(column_pair) for column_pair in zip(ordered_guesses[0][:4], ordered_guesses[1][:4], strict=True)
    ]
    return chain_guess._replace(record_indices=columns[0], sides=columns[1], times=columns[2], speeds=columns[3])


def insert_impacts(
    fit_problem: ImpactFitProblem, chain_guess: ImpactChainGuess, flight_index: int, sides
) -> list[ImpactChainGuess]:
    """Return the guesses with impacts on the given sides inserted in a flight, at plausible times, the best first."""
    insertion_index, n_insertions = flight_index + 1, len(sides)
    speeds = np.insert(chain_guess.speeds, insertion_index, np.full(n_insertions, np.nan))
    speeds[insertion_index + n_insertions] = np.nan
    longer_guess = chain_guess._replace(
        record_indices=np.insert(chain_guess.record_indices, insertion_index, np.full(n_insertions, -1)),
        sides=np.insert(chain_guess.sides, insertion_index, sides),
        speeds=speeds,
    )
    insertion_times = rank_insertion_times(fit_problem, chain_guess, flight_index, sides)[1]
    return [
        longer_guess._replace(times=np.insert(chain_guess.times, insertion_index, times)) for times in insertion_times
    ]


def remove_node(chain_guess: ImpactChainGuess, node_index: int) -> ImpactChainGuess:
    """Return the guess without a node. If the node has an impact of the record, this impact becomes spurious."""
    columns = [np.delete(column, node_index) for column in chain_guess[:4]]
    if node_index < len(columns[3]):
        columns[3][node_index] = np.nan
    spurious_indices = (
        chain_guess.spurious_indices
        if chain_guess.record_indices[node_index] < 0
        else (*chain_guess.spurious_indices, int(chain_guess.record_indices[node_index]))
    )
    return chain_guess._replace(
        record_indices=columns[0],
        sides=columns[1],
        times=columns[2],
        speeds=columns[3],
        spurious_indices=spurious_indices,
    )


def squared_speed_mismatches(
    fit_problem: ImpactFitProblem, chain_guess: ImpactChainGuess
) -> Float[np.ndarray, " inner"]:
    """Return the squared violation of the impact law at each inner node, plus a penalty for negative speeds."""
    scene, start_phase = fit_problem.free_spec.scene_and_start_phase(chain_guess.parameters)
    times = _separate_times(chain_guess.times, fit_problem.sigma[0])
    speeds_after, speeds_before = speeds_between_impacts(scene, chain_guess.sides, times, start_phase)
    speed_differences = speeds_after[1:] - restitutions_on_sides(scene, chain_guess.sides[1:-1]) * speeds_before[:-1]
    return speed_differences**2 + 10.0 * (
        np.minimum(speeds_after[1:], 0.0) ** 2 + np.minimum(speeds_before[:-1], 0.0) ** 2
    )


def rank_insertion_times(fit_problem, chain_guess, flight_index, sides):
    """Return (smallest speed mismatch, times of the inserted impacts) for impacts inserted in a flight.

    The times are points of a grid, one row per choice. For one impact the rows are the smallest local minima of the
    speed mismatch, at most `MAX_GRID_MINIMA`. For several impacts the only row is the global minimum.
    """
    scene, start_phase = fit_problem.free_spec.scene_and_start_phase(chain_guess.parameters)
    start_time, end_time = chain_guess.times[flight_index], chain_guess.times[flight_index + 1]
    time_fractions = (np.arange(GRID_SIZE) + 0.5) / GRID_SIZE
    time_fractions = np.array(
        [
            increasing_fractions
            for increasing_fractions in product(time_fractions, repeat=len(sides))
            if list(increasing_fractions) == sorted(set(increasing_fractions))
        ]
    )
    trial_times = start_time + (end_time - start_time) * time_fractions
    trial_node_sides = np.array([chain_guess.sides[flight_index], *sides, chain_guess.sides[flight_index + 1]])
    trial_node_times = np.column_stack(
        [np.full(len(trial_times), start_time), trial_times, np.full(len(trial_times), end_time)]
    )
    n_nodes = trial_node_times.shape[1]
    speeds_after, speeds_before = speeds_between_impacts(
        scene, np.tile(trial_node_sides, len(trial_node_times)), trial_node_times.ravel(), start_phase
    )
    speeds_after, speeds_before = (
        np.append(flight_speeds, 0.0).reshape(len(trial_node_times), n_nodes)[:, :-1]
        for flight_speeds in (speeds_after, speeds_before)
    )
    first_impact_speed = chain_guess.speeds[flight_index]
    first_impact_speed = (
        speeds_after[:, 0] / restitutions_on_sides(scene, trial_node_sides[:1])[0]
        if np.isnan(first_impact_speed)
        else np.full(len(trial_node_times), first_impact_speed)
    )
    impact_speeds = np.column_stack([first_impact_speed, speeds_before[:, :-1]])
    speed_differences = speeds_after - restitutions_on_sides(scene, trial_node_sides[:-1]) * impact_speeds
    negative_speed_penalty = np.sum(np.minimum(speeds_after, 0.0) ** 2, 1) + np.sum(
        np.minimum(speeds_before, 0.0) ** 2, 1
    )
    mismatches = np.sum(speed_differences**2, 1) + 10.0 * negative_speed_penalty
    mismatches = np.where(np.isfinite(mismatches), mismatches, np.inf)
    best_trial_indices = [int(np.argmin(mismatches))]
    if len(sides) == 1:
        is_local_minimum = (mismatches < np.append(np.inf, mismatches[:-1])) & (
            mismatches < np.append(mismatches[1:], np.inf)
        )
        best_trial_indices = (
            sorted(np.flatnonzero(is_local_minimum), key=lambda k: mismatches[k])[:MAX_GRID_MINIMA]
            or best_trial_indices
        )
    return float(mismatches[best_trial_indices[0]]), trial_times[best_trial_indices]
