"""Represent chains of impacts: match impacts of a record with those of the motion, with missing and spurious impacts.

The functions fit a chain, extend it, insert an impact that the record lacks, or remove one. `chain_search` decides what
is tried, and in which order.
"""

from itertools import product
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from ..scene.scene import SIDES, Scene
from ..scene.soft_walls import effective_restitution
from . import chain_fit
from .chain_equations import Nodes, connecting_speeds, flight_residuals
from .chain_fit import Measurements
from .least_squares import FreeParameters, LeastSquaresSolution, largest_chi2
from .next_impact import Motion

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

    `record_indices` holds the index in the record of each node, -1 for a missing impact. `spurious_indices` are impacts
    of the record without a node. `cost` is chi2 plus the penalties.
    """

    record_indices: Int[np.ndarray, " nodes"]
    spurious_indices: tuple[int, ...]
    solution: LeastSquaresSolution
    cost: float


class Record(NamedTuple):
    """Record to be explained: scene, phase, times, sides, standard errors, free parameters."""

    scene: Scene
    phase: float
    times: Float[np.ndarray, " record"]
    sides: Float[np.ndarray, " record"]
    sigma: Float[np.ndarray, " record"]
    free_params: FreeParameters


class ChainGuess(NamedTuple):
    """Chain that is not fitted; an unknown speed is nan."""

    record_indices: Int[np.ndarray, " nodes"]
    sides: Float[np.ndarray, " nodes"]
    times: Float[np.ndarray, " nodes"]
    speeds: Float[np.ndarray, " nodes"]
    spurious_indices: tuple[int, ...]
    parameters: Float[np.ndarray, " free"]


def fit_chain(record: Record, guess: ChainGuess) -> ImpactChain:
    """Fit a `ChainGuess`; unknown speeds start from those of the connecting flights."""
    scene, phase = scene_and_phase(record, guess.parameters)
    times, zeros = _separate_times(guess.times, record.sigma[0]), np.zeros(len(guess.record_indices))
    speeds_after, speeds_before = connecting_speeds(scene, Nodes(guess.sides, zeros, times, zeros), phase)
    impact_speeds = np.concatenate(
        [[speeds_after[0] / max(restitutions(scene, guess.sides[:1])[0], MIN_RESTITUTION)], speeds_before]
    )
    nodes = Nodes(guess.sides, zeros, times, np.where(np.isnan(guess.speeds), impact_speeds, guess.speeds))
    measurements = measurements_of(record, guess)
    solution = chain_fit.fit_chain_parameters(
        record.scene,
        record.phase,
        nodes,
        measurements,
        record.free_params,
        guess.parameters,
        MAX_ITERATIONS,
        ROUGH_TOLERANCE,
    )
    cost = (
        solution.chi2
        + solution.prior_chi2
        + MISSED_COST * np.sum(guess.record_indices < 0)
        + SPURIOUS_COST * len(guess.spurious_indices)
    )
    return ImpactChain(
        guess.record_indices,
        guess.spurious_indices,
        solution,
        float(cost if is_possible(record, solution) else IMPOSSIBLE_COST + cost),
    )


def measurements_of(record, chain):
    """Return the `Measurements` of the nodes of a chain."""
    node_indices = np.flatnonzero(chain.record_indices >= 0)
    return Measurements(
        node_indices,
        np.zeros(len(node_indices), int),
        record.times[chain.record_indices[node_indices]],
        record.sigma[chain.record_indices[node_indices]],
    )


def is_possible(record, solution):
    """Check that a chain is a motion, within errors.

    It must be converged, each impact must enter its wall, and no flight may pass through a wall.
    """
    if not solution.converged or np.any(solution.nodes.second_unknown <= 0):
        return False
    scene, phase = scene_and_phase(record, solution.parameters)
    min_clearances, nearest_sides, min_times = Motion(scene, phase).min_clearances(solution.nodes)
    return all(
        _may_graze(record, solution, k, nearest_sides[k], min_times[k], -min_clearances[k])
        for k in np.flatnonzero(min_clearances < 0)
    )


def _may_graze(record, solution, flight, side, contact_time, depth):
    """Check that the penetration of a flight at a time is within its error."""
    nodes, n_params = solution.nodes, len(solution.parameters)
    node_pair = Nodes(
        np.array([nodes.sides[flight], side]),
        np.zeros(2),
        np.array([nodes.first_unknown[flight], contact_time]),
        np.array([nodes.second_unknown[flight], 0.0]),
    )
    depth_derivatives = residual_derivatives(record, node_pair, solution.parameters)[0, 0]
    depth_derivatives = depth_derivatives[[0, 1, *range(4, 4 + n_params)]]
    covariance = solution.covariance_with([2 * flight, 2 * flight + 1])
    return bool(depth <= MAX_DEPTH_ERRORS * np.sqrt(max(depth_derivatives @ covariance @ depth_derivatives, 0.0)))


def residual_derivatives(record, nodes, parameters):
    """Return the derivatives of the residuals of flights in the unknowns of their nodes and the free parameters.

    The array has shape (flights, 2, 4 + free). Parameters are in units of their scales.
    """
    names, phase = record.free_params.split_phase(parameters, record.phase)
    derivatives = flight_residuals(record.scene, names, nodes, parameters[: len(names)], phase).derivatives[
        :, :, : 4 + len(parameters)
    ]
    return derivatives * np.concatenate([np.ones(4), record.free_params.scales])


def is_acceptable(record: Record, chain: ImpactChain) -> bool:
    """Check that a chain is a motion from which noise may have made the record."""
    solution = chain.solution
    return bool(
        chain.cost < IMPOSSIBLE_COST
        and solution.chi2 + solution.prior_chi2 <= largest_chi2(len(solution.residuals) - 2)
    )


def _separate_times(times, sigma):
    """Return increasing times, separated by at least half a standard error."""
    times = np.array(times)
    for k in range(1, len(times)):
        times[k] = max(times[k], times[k - 1] + 0.5 * sigma)
    return times


def scene_and_phase(record, parameters):
    """Return the scene with the given parameters, and the phase."""
    return record.free_params.scene_and_phase(record.scene, record.phase, parameters)


def restitutions(scene, sides):
    """Return the restitution of the walls on given sides, the effective one of soft walls."""
    restitution_by_side = {side: _restitution_of(scene, SIDES[int(side > 0)]) for side in set(sides)}
    return np.array([restitution_by_side[side] for side in sides])


def _restitution_of(scene, side):
    wall = scene.walls[side]
    if not wall.soft:
        return float(scene.bounce(side))
    return float(effective_restitution(wall.stiffness, scene.parameter(f"{side}.damping")))


def wall_sides(scene):
    """Return the sides, -1 and 1, of the walls of a scene."""
    return tuple(-1.0 if side == "left" else 1.0 for side in scene.walls)


def guess_from_record(record: Record, parameters, record_indices) -> ChainGuess:
    """Return the chain of some impacts of the record."""
    record_indices = np.asarray(record_indices, int)
    return ChainGuess(
        record_indices,
        record.sides[record_indices],
        record.times[record_indices],
        np.full(len(record_indices), np.nan),
        (),
        parameters,
    )


def guess_from_chain(chain: ImpactChain) -> ChainGuess:
    """Return a fitted chain as a guess."""
    nodes, solution = chain.solution.nodes, chain.solution
    return ChainGuess(
        chain.record_indices,
        nodes.sides,
        nodes.first_unknown,
        nodes.second_unknown,
        chain.spurious_indices,
        solution.parameters,
    )


def join_guesses(guess: ChainGuess, addition: ChainGuess, direction: int) -> ChainGuess:
    """Append a chain to another, or prepend it if `direction` is -1.

    Parameters and spurious impacts are those of the first chain.
    """
    ordered_guesses = (guess, addition) if direction > 0 else (addition, guess)
    columns = [np.concatenate(pair) for pair in zip(ordered_guesses[0][:4], ordered_guesses[1][:4], strict=True)]
    return guess._replace(record_indices=columns[0], sides=columns[1], times=columns[2], speeds=columns[3])


def insert_impacts(record: Record, guess: ChainGuess, flight: int, sides) -> list[ChainGuess]:
    """Return the chains with impacts on given sides inserted after a node, at plausible times, the best first."""
    position, n_inserted = flight + 1, len(sides)
    speeds = np.insert(guess.speeds, position, np.full(n_inserted, np.nan))
    speeds[position + n_inserted] = np.nan
    longer_guess = guess._replace(
        record_indices=np.insert(guess.record_indices, position, np.full(n_inserted, -1)),
        sides=np.insert(guess.sides, position, sides),
        speeds=speeds,
    )
    time_choices = rate_insertions(record, guess, flight, sides)[1]
    return [longer_guess._replace(times=np.insert(guess.times, position, times)) for times in time_choices]


def remove_node(guess: ChainGuess, node: int) -> ChainGuess:
    """Return the chain without a node; its impact of the record, if any, becomes spurious."""
    columns = [np.delete(column, node) for column in guess[:4]]
    if node < len(columns[3]):
        columns[3][node] = np.nan
    spurious_indices = (
        guess.spurious_indices
        if guess.record_indices[node] < 0
        else (*guess.spurious_indices, int(guess.record_indices[node]))
    )
    return guess._replace(
        record_indices=columns[0],
        sides=columns[1],
        times=columns[2],
        speeds=columns[3],
        spurious_indices=spurious_indices,
    )


def speed_mismatch(record: Record, guess: ChainGuess) -> Float[np.ndarray, " inner"]:
    """Return the mismatch of the speeds before and after each inner node."""
    scene, phase = scene_and_phase(record, guess.parameters)
    zeros = np.zeros(len(guess.record_indices))
    speeds_after, speeds_before = connecting_speeds(
        scene, Nodes(guess.sides, zeros, _separate_times(guess.times, record.sigma[0]), zeros), phase
    )
    speed_defects = speeds_after[1:] - restitutions(scene, guess.sides[1:-1]) * speeds_before[:-1]
    return speed_defects**2 + 10.0 * (np.minimum(speeds_after[1:], 0.0) ** 2 + np.minimum(speeds_before[:-1], 0.0) ** 2)


def rate_insertions(record, guess, flight, sides):
    """Return (mismatch, times) of impacts inserted after a node.

    Times are the best points of a grid, at which the speeds before and after the impacts match.
    """
    scene, phase = scene_and_phase(record, guess.parameters)
    start_time, end_time = guess.times[flight], guess.times[flight + 1]
    fractions = (np.arange(GRID_SIZE) + 0.5) / GRID_SIZE
    fractions = np.array(
        [
            fraction_tuple
            for fraction_tuple in product(fractions, repeat=len(sides))
            if list(fraction_tuple) == sorted(set(fraction_tuple))
        ]
    )
    times = start_time + (end_time - start_time) * fractions
    side_sequence = np.array([guess.sides[flight], *sides, guess.sides[flight + 1]])
    time_rows = np.column_stack([np.full(len(times), start_time), times, np.full(len(times), end_time)])
    n_nodes = time_rows.shape[1]
    zeros = np.zeros(time_rows.size)
    speeds_after, speeds_before = connecting_speeds(
        scene, Nodes(np.tile(side_sequence, len(time_rows)), zeros, time_rows.ravel(), zeros), phase
    )
    speeds_after, speeds_before = (
        np.append(array, 0.0).reshape(len(time_rows), n_nodes)[:, :-1] for array in (speeds_after, speeds_before)
    )
    first_speed = guess.speeds[flight]
    first_speed = (
        speeds_after[:, 0] / restitutions(scene, side_sequence[:1])[0]
        if np.isnan(first_speed)
        else np.full(len(time_rows), first_speed)
    )
    impact_speeds = np.column_stack([first_speed, speeds_before[:, :-1]])
    speed_defects = speeds_after - restitutions(scene, side_sequence[:-1]) * impact_speeds
    negative_penalty = np.sum(np.minimum(speeds_after, 0.0) ** 2, 1) + np.sum(np.minimum(speeds_before, 0.0) ** 2, 1)
    mismatch = np.sum(speed_defects**2, 1) + 10.0 * negative_penalty
    mismatch = np.where(np.isfinite(mismatch), mismatch, np.inf)
    best_rows = [int(np.argmin(mismatch))]
    if len(sides) == 1:
        is_minimum = (mismatch < np.append(np.inf, mismatch[:-1])) & (mismatch < np.append(mismatch[1:], np.inf))
        best_rows = sorted(np.flatnonzero(is_minimum), key=lambda k: mismatch[k])[:MAX_GRID_MINIMA] or best_rows
    return float(mismatch[best_rows[0]]), times[best_rows]
