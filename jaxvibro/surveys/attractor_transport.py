"""Carry attractors from one parameter value to the next by simulation with a slowly changing parameter."""

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from ..attractors import classify_attractors
from ..attractors.classify_attractors import (
    AttractorCandidate,
    find_chaotic_attractors,
    find_periodic_attractors,
    make_chaotic_attractor,
    sample_motions,
)
from ..attractors.transients import extract_orbit, is_rotated_orbit, settle_lanes
from ..compiled.kernel_calls import BLOCK_WIDTH
from ..flight.wall_positions import adapt_to_moved_walls
from ..maps.iterate import iterate, take_lanes
from ..scene.check import MAX_ORBIT_PERIODS
from ..scene.scene import Scene
from ..scene.state import State, Status

N_STEPS = 64  # steps of the parameter from one value to the next
PERTURBATION_POWER = (
    0.375  # perturbation eps^power, relative to the largest x and v: motions leave orbits that have become unstable
)
PERTURBATION_DIRECTION = (0.6, 0.8)


class TransportResult(NamedTuple):
    """Result of carrying the motion on an attractor to a neighbouring value of the parameter.

    Attributes
    ----------
    attractor_index : int or None
        Index among the attractors at the neighbouring value. None if the motion settles on no attractor.
    path : ndarray
        x, v and contact at phase 0 while the parameter changes, over `MAX_ORBIT_PERIODS` periods at each step. Array of
        shape (N_STEPS, MAX_ORBIT_PERIODS, 3).
    """

    attractor_index: int | None
    path: Float[np.ndarray, "steps periods 3"]


@dataclass(eq=False)
class ParameterNode:
    """Attractors at one value of the parameter.

    Parameters
    ----------
    value : float
        Value of the parameter.
    scene : Scene
        Scene at this value.
    candidates : list of AttractorCandidate
        Attractors, with the indices of their initial states as lanes.
    n_unresolved_starts : int
        Number of initial states on no attractor.
    scale : float
        Largest magnitude of x and v.
    status : int
        Worst status of the initial states.
    transports : dict
        Results ``{-1 or 1: {index in candidates: TransportResult}}``, -1 towards the previous value and 1 towards the
        next.
    """

    value: float
    scene: Scene
    candidates: list[AttractorCandidate]
    n_unresolved_starts: int
    scale: float | np.floating
    status: int
    transports: dict[int, dict[int, TransportResult]] = field(default_factory=lambda: {-1: {}, 1: {}})


def transport_attractors(nodes, name, settle):
    """Carry each attractor of some `ParameterNode`s, in order of their values, to the neighbouring values.

    If a motion settles on an attractor that no initial state approached, this attractor is added with a share of 0. New
    attractors are carried in the next round. The number of rounds is the number of values.
    """
    for _ in nodes:
        transport_tasks = [
            (node_index, candidate_index, node_step)
            for node_index, node in enumerate(nodes)
            for candidate_index in range(len(node.candidates))
            for node_step in (-1, 1)
            if 0 <= node_index + node_step < len(nodes) and candidate_index not in node.transports[node_step]
        ]
        for first_task_index in range(0, len(transport_tasks), BLOCK_WIDTH):
            _transport_batch(nodes, name, transport_tasks[first_task_index : first_task_index + BLOCK_WIDTH], settle)


def _transport_batch(nodes, name, transport_tasks, settle):
    """Carry at most `BLOCK_WIDTH` attractors, (node index, attractor index, direction) each, at the same time."""
    padded_tasks = transport_tasks + transport_tasks[-1:] * (BLOCK_WIDTH - len(transport_tasks))
    start_values = np.array([nodes[node_index].value for node_index, _, _ in padded_tasks])
    end_values = np.array([nodes[node_index + node_step].value for node_index, _, node_step in padded_tasks])
    start_states = [
        nodes[node_index].candidates[candidate_index].attractor_fields["state"]
        for node_index, candidate_index, _ in padded_tasks
    ]
    end_state, worst_status, state_path = _ramp_parameter(
        nodes[0].scene,
        name,
        start_values,
        end_values,
        jax.tree.map(lambda *leaves: np.array(leaves, nodes[0].scene.dtype), *start_states),
        np.array([max(nodes[index].scale, nodes[index + node_step].scale) for index, _, node_step in padded_tasks]),
    )
    target_node_indices = np.array([node_index + node_step for node_index, _, node_step in transport_tasks])
    target_indices = np.full(len(transport_tasks), -1)
    for target_node_index in np.unique(target_node_indices):
        lanes = np.flatnonzero(
            (target_node_indices == target_node_index) & (worst_status[: len(transport_tasks)] < Status.CAP)
        )
        if lanes.size:
            target_indices[lanes] = assign_or_add_attractors(
                nodes[target_node_index], take_lanes(end_state, lanes), settle
            )
    for lane, (node_index, candidate_index, node_step) in enumerate(transport_tasks):
        target_index = None if target_indices[lane] < 0 else int(target_indices[lane])
        nodes[node_index].transports[node_step][candidate_index] = TransportResult(target_index, state_path[:, :, lane])


def _ramp_parameter(scene, name, start_values, end_values, state, max_state_magnitude):
    """Return (final state, worst status, path (steps, periods, lanes, 3)) of lanes with slowly changing parameters."""
    worst_status, state_path = np.zeros(len(start_values), int), []
    for step_number in range(1, N_STEPS + 1):
        step_values = (
            end_values
            if step_number == N_STEPS
            else start_values + (end_values - start_values) * ramp_fraction(step_number)
        )
        step_scenes = scene.replace(**{name: step_values})
        state = jax.tree.map(
            np.asarray, adapt_to_moved_walls(step_scenes, perturb_free_states(scene, state, max_state_magnitude))
        )
        iterates = iterate(step_scenes, state, MAX_ORBIT_PERIODS, max_single_lanes=0)
        state, worst_status = iterates.state, np.maximum(worst_status, iterates.status)
        state_path.append(np.stack([iterates.x, iterates.v, iterates.contact], -1))
    return state, worst_status, np.stack(state_path)


def ramp_fraction(step_number):
    """Return the fraction of the parameter change after `step_number` steps.

    The steps are small at both ends, where an attractor of one of the values may be near the end of its branch.
    """
    step_fraction = step_number / N_STEPS
    return step_fraction * step_fraction * (3.0 - 2.0 * step_fraction)


def perturb_free_states(scene, state, max_state_magnitude):
    """Return slightly perturbed states; states in contact are unchanged. max_state_magnitude: largest magnitude of x
    and v."""
    perturbation_size = np.where(
        np.asarray(state.contact) == 0, np.finfo(scene.dtype).eps ** PERTURBATION_POWER * max_state_magnitude, 0.0
    )
    x, v = (
        np.asarray(component + perturbation_size * direction_component, scene.dtype)
        for component, direction_component in zip((state.x, state.v), PERTURBATION_DIRECTION, strict=True)
    )
    return State(x, v, state.phase, state.contact)


def assign_or_add_attractors(node, state, settle):
    """Return the indices of the node's attractors that states (lanes) approach, -1 for none.

    New attractors are added to the node, with their mirror images if the scene is symmetric.
    """
    scene, candidates = node.scene, node.candidates
    state = jax.tree.map(np.asarray, adapt_to_moved_walls(scene, perturb_free_states(scene, state, node.scale)))
    iterates, recurrence_periods, _ = settle_lanes(scene, state, settle)
    attractor_indices = np.full(len(recurrence_periods), -1)
    for lane in np.flatnonzero(recurrence_periods):
        attractor_indices[lane] = _find_orbit_index(
            candidates, extract_orbit(iterates, lane, recurrence_periods[lane])[0], node.scale
        )
    nonrecurrent_lanes = np.flatnonzero((recurrence_periods == 0) & (iterates.status < Status.CAP))
    for lane in nonrecurrent_lanes:
        motion = sample_motions(scene, take_lanes(iterates.state, [lane]))
        if motion.status[0] < Status.CAP:
            index = classify_attractors.find_attractor_index(
                candidates, 0, make_chaotic_attractor(scene, motion, node.scale, {}).impact_points
            )
            attractor_indices[lane] = -1 if index is None else index
    n_known_candidates = len(candidates)
    for found_candidate in find_periodic_attractors(
        scene, iterates, np.where(attractor_indices < 0, recurrence_periods, 0), settle, node.scale
    )[0]:
        attractor_indices[found_candidate.lanes] = _find_or_add_attractor(candidates, found_candidate)
    for found_candidate in find_chaotic_attractors(
        scene, iterates, nonrecurrent_lanes[attractor_indices[nonrecurrent_lanes] < 0], node.scale
    )[0]:
        attractor_indices[found_candidate.lanes] = _find_or_add_attractor(candidates, found_candidate)
    if len(candidates) > n_known_candidates:
        candidates += classify_attractors.derive_mirror_images(scene, candidates, node.scale)
    return attractor_indices


def _find_orbit_index(candidates, section_points, max_state_magnitude):
    """Return the index of the periodic attractor with these points, -1 if there is none."""
    tolerance = np.finfo(section_points.dtype).eps ** 0.4 * max_state_magnitude
    return next(
        (
            index
            for index, candidate in enumerate(candidates)
            if candidate.attractor_fields["periods"] == len(section_points)
            and is_rotated_orbit(section_points, candidate.attractor_fields["points"], tolerance)
        ),
        -1,
    )


def _find_or_add_attractor(candidates, new_candidate):
    """Return the index of an attractor among the candidates, adding it without initial states if it is new."""
    index = classify_attractors.find_attractor_index(
        candidates, new_candidate.attractor_fields["periods"], new_candidate.impact_points
    )
    if index is None:
        candidates.append(replace(new_candidate, lanes=[]))
        return len(candidates) - 1
    return index
