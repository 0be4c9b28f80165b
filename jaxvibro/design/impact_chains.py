"""Chains of impacts: which of a record's impacts are of the motion, and which of the motion are missing from it.

How a chain is fitted, made longer, given an impact that the record lacks, or relieved of one. What is tried, and in
which order, is in `growth`.
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

MISSED_COST, SPURIOUS_COST, IMPOSSIBLE_COST = (
    6.0,
    14.0,
    1e6,
)  # what is added to chi2 for each of them, for a chain that cannot be
GRID_SIZE = 24  # times of an impact that is put in
MAX_GRID_MINIMA = 2  # places on a grid that are tried
MAX_ITERATIONS, ROUGH_TOLERANCE = (
    25,
    1e-2,
)  # of Newton's steps; of errors and scales: so short is the last while chains are looked for
MIN_RESTITUTION = 0.05  # restitution below which a speed before an impact is not told from that after it
MAX_DEPTH_ERRORS = 4.0  # errors of a flight's depth in a wall: deeper it passes through


class ImpactChain(NamedTuple):
    """record_indices: of each node the record's impact, -1 where it was missed; spurious_indices: the record's impacts
    of no node; solution: the `LeastSquaresSolution`; cost: chi2 and what is added."""

    record_indices: Int[np.ndarray, " nodes"]
    spurious_indices: tuple[int, ...]
    solution: LeastSquaresSolution
    cost: float


class Record(NamedTuple):
    """What the chains are of: the scene, the phase, times, sides and their errors, what is free."""

    scene: Scene
    phase: float
    times: Float[np.ndarray, " record"]
    sides: Float[np.ndarray, " record"]
    sigma: Float[np.ndarray, " record"]
    free_params: FreeParameters


class ChainGuess(NamedTuple):
    """A chain that is not fitted yet; a speed that is not known is nan."""

    record_indices: Int[np.ndarray, " nodes"]
    sides: Float[np.ndarray, " nodes"]
    times: Float[np.ndarray, " nodes"]
    speeds: Float[np.ndarray, " nodes"]
    spurious_indices: tuple[int, ...]
    parameters: Float[np.ndarray, " free"]


def fit_chain(record: Record, guess: ChainGuess) -> ImpactChain:
    """The `ImpactChain` of a `ChainGuess`; speeds that are not known are those with which flights come."""
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
    """What was measured of a chain's nodes."""
    node_indices = np.flatnonzero(chain.record_indices >= 0)
    return Measurements(
        node_indices,
        np.zeros(len(node_indices), int),
        record.times[chain.record_indices[node_indices]],
        record.sigma[chain.record_indices[node_indices]],
    )


def is_possible(record, solution):
    """Whether a chain is a motion: solved, each impact into its wall, and no flight through one, but for errors."""
    if not solution.converged or np.any(solution.nodes.second_unknown <= 0):
        return False
    scene, phase = scene_and_phase(record, solution.parameters)
    min_clearances, nearest_sides, min_times = Motion(scene, phase).min_clearances(solution.nodes)
    return all(
        _may_graze(record, solution, k, nearest_sides[k], min_times[k], -min_clearances[k])
        for k in np.flatnonzero(min_clearances < 0)
    )


def _may_graze(record, solution, flight, side, contact_time, depth):
    """Whether a flight is as deep in a wall at a time as errors may take it, and no deeper."""
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
    """How what flights leave open changes with their nodes' unknowns and the free numbers, in their scales,
    (flights, 2, 4 + free)."""
    names, phase = record.free_params.split_phase(parameters, record.phase)
    derivatives = flight_residuals(record.scene, names, nodes, parameters[: len(names)], phase).derivatives[
        :, :, : 4 + len(parameters)
    ]
    return derivatives * np.concatenate([np.ones(4), record.free_params.scales])


def is_acceptable(record: Record, chain: ImpactChain) -> bool:
    """Whether a chain is a motion that noise may have made the record of."""
    solution = chain.solution
    return bool(
        chain.cost < IMPOSSIBLE_COST
        and solution.chi2 + solution.prior_chi2 <= largest_chi2(len(solution.residuals) - 2)
    )


def _separate_times(times, sigma):
    """Times in order, none as near to the next as their error."""
    times = np.array(times)
    for k in range(1, len(times)):
        times[k] = max(times[k], times[k - 1] + 0.5 * sigma)
    return times


def scene_and_phase(record, parameters):
    """(the scene with free numbers, the phase)."""
    return record.free_params.scene_and_phase(record.scene, record.phase, parameters)


def restitutions(scene, sides):
    """R of the walls on sides, of soft ones the effective one."""
    restitution_by_side = {side: _restitution_of(scene, SIDES[int(side > 0)]) for side in set(sides)}
    return np.array([restitution_by_side[side] for side in sides])


def _restitution_of(scene, side):
    wall = scene.walls[side]
    if not wall.soft:
        return float(scene.bounce(side))
    return float(effective_restitution(wall.stiffness, scene.parameter(f"{side}.damping")))


def wall_sides(scene):
    """-1, 1 of the walls that a scene has."""
    return tuple(-1.0 if side == "left" else 1.0 for side in scene.walls)


def guess_from_record(record: Record, parameters, record_indices) -> ChainGuess:
    """The chain of some impacts of the record, as they are."""
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
    """A chain as it was found."""
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
    """A chain with more after it, or before it where way is -1; left out is what either leaves out."""
    ordered_guesses = (guess, addition) if direction > 0 else (addition, guess)
    columns = [np.concatenate(pair) for pair in zip(ordered_guesses[0][:4], ordered_guesses[1][:4], strict=True)]
    return guess._replace(record_indices=columns[0], sides=columns[1], times=columns[2], speeds=columns[3])


def insert_impacts(record: Record, guess: ChainGuess, flight: int, sides) -> list[ChainGuess]:
    """The chains with impacts on sides put in after a node, at times that suit, the best first."""
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
    """The chain without a node; of a measured one the record's impact is left out."""
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
    """How badly the speeds with which flights come suit those with which the next ones go, at each inner node."""
    scene, phase = scene_and_phase(record, guess.parameters)
    zeros = np.zeros(len(guess.record_indices))
    speeds_after, speeds_before = connecting_speeds(
        scene, Nodes(guess.sides, zeros, _separate_times(guess.times, record.sigma[0]), zeros), phase
    )
    speed_defects = speeds_after[1:] - restitutions(scene, guess.sides[1:-1]) * speeds_before[:-1]
    return speed_defects**2 + 10.0 * (np.minimum(speeds_after[1:], 0.0) ** 2 + np.minimum(speeds_before[:-1], 0.0) ** 2)


def rate_insertions(record, guess, flight, sides):
    """(how badly, times) of impacts put in after a node, on a grid, at its lowest places: where speeds before and after
    suit each other."""
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
