"""Carry attractors from one parameter value to the next by simulation with a slowly changing parameter."""

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from ..attractors import derived_candidates
from ..attractors.classify import AttractorCandidate, chaotic_candidate, find_chaotic, find_periodic, sample_motion
from ..attractors.transients import extract_orbit, is_rotation, settle_lanes
from ..compiled.kernels import BLOCK_WIDTH
from ..flight.wall_positions import clamp_to_walls
from ..maps.initial_conditions import initial_box
from ..maps.iterate import iterate
from ..orbits.orbit_comparison import is_same_orbit, is_same_set
from ..scene.check import MAX_ORBIT_PERIODS
from ..scene.codes import Status
from ..scene.scene import Scene
from ..scene.state import State

N_STEPS = 64  # steps of the parameter from one value to the next
PERTURBATION_POWER = (
    0.375  # perturbation eps^power, relative to the largest x and v: motions leave orbits that have become unstable
)
PERTURBATION_DIRECTION = (0.6, 0.8)


class TransportResult(NamedTuple):
    """Result of carrying an attractor to a neighbouring value.

    Attributes
    ----------
    attractor_index : int or None
        Index among the attractors of that value; None if the motion settled on none.
    path : ndarray
        x, v and contact at phase 0 along the way, over `MAX_ORBIT_PERIODS` periods at each step. Array of shape
        (N_STEPS, MAX_ORBIT_PERIODS, 3).
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
    n_unresolved : int
        Number of initial states on no attractor.
    scale : float
        Largest magnitude of x and v.
    status : int
        Worst status of the initial states.
    transports : dict
        Results {-1 or 1: {index in `candidates`: `TransportResult`}} towards the previous and the next value.
    """

    value: float
    scene: Scene
    candidates: list[AttractorCandidate]
    n_unresolved: int
    scale: float | np.floating
    status: int
    transports: dict[int, dict[int, TransportResult]] = field(default_factory=lambda: {-1: {}, 1: {}})


def transport_attractors(nodes, name, settle):
    """Carry each attractor of some `ParameterNode`s, in order of their values, to the neighbouring values.

    A motion that settles there on an attractor that no initial state found adds it with a share of 0, and it is carried
    on in turn. There are at most as many rounds as values.
    """
    for _ in nodes:
        tasks = [
            (node_index, index, direction)
            for node_index, node in enumerate(nodes)
            for index in range(len(node.candidates))
            for direction in (-1, 1)
            if 0 <= node_index + direction < len(nodes) and index not in node.transports[direction]
        ]
        for start in range(0, len(tasks), BLOCK_WIDTH):
            _transport_batch(nodes, name, tasks[start : start + BLOCK_WIDTH], settle)


def _transport_batch(nodes, name, tasks, settle):
    """Carry at most `BLOCK_WIDTH` attractors, (node index, attractor index, direction) each, at the same time."""
    padded_tasks = tasks + tasks[-1:] * (BLOCK_WIDTH - len(tasks))
    start_values = np.array([nodes[node_index].value for node_index, _, _ in padded_tasks])
    end_values = np.array([nodes[node_index + direction].value for node_index, _, direction in padded_tasks])
    states = [nodes[node_index].candidates[index].fields["state"] for node_index, index, _ in padded_tasks]
    state, status, path = _ramp_parameter(
        nodes[0].scene,
        name,
        start_values,
        end_values,
        _stack_states(nodes[0].scene, states),
        _node_scales(nodes, padded_tasks),
    )
    target_nodes = np.array([node_index + direction for node_index, _, direction in tasks])
    attractor_indices = np.full(len(tasks), -1)
    for target in np.unique(target_nodes):
        lanes = np.flatnonzero((target_nodes == target) & (status[: len(tasks)] < Status.CAP))
        if lanes.size:
            attractor_indices[lanes] = assign_attractors(
                nodes[target], jax.tree.map(lambda leaf, lanes=lanes: leaf[lanes], state), settle
            )
    for lane, (node_index, index, direction) in enumerate(tasks):
        attractor_index = None if attractor_indices[lane] < 0 else int(attractor_indices[lane])
        nodes[node_index].transports[direction][index] = TransportResult(attractor_index, path[:, :, lane])


def _node_scales(nodes, tasks):
    return np.array(
        [max(nodes[node_index].scale, nodes[node_index + direction].scale) for node_index, _, direction in tasks]
    )


def _stack_states(scene, states):
    """Stack states of one lane each, at phase 0, into one state of many lanes."""
    components = ([getattr(state, key) for state in states] for key in ("x", "v", "contact"))
    x, v, contact = (np.array(values, scene.dtype) for values in components)
    return State(x, v, np.zeros_like(x), contact)


def _ramp_parameter(scene, name, start_values, end_values, state, scale):
    """Return (state, worst status, path (steps, periods, lanes, 3)) of lanes with slowly changing parameters."""
    worst_status, path = np.zeros(len(start_values), int), []
    for step in range(1, N_STEPS + 1):
        values = end_values if step == N_STEPS else start_values + (end_values - start_values) * ramp_fraction(step)
        step_scenes = scene.replace(**{name: values})
        state = jax.tree.map(np.asarray, clamp_to_walls(step_scenes, perturb_states(scene, state, scale)))
        iterates = iterate(step_scenes, state, MAX_ORBIT_PERIODS, max_single_lanes=0)
        state, worst_status = iterates.state, np.maximum(worst_status, iterates.status)
        path.append(np.stack([iterates.x, iterates.v, iterates.contact], -1))
    return state, worst_status, np.stack(path)


def ramp_fraction(step):
    """Return the fraction of the parameter change after `step` steps.

    The steps are small at both ends, where an attractor of one of the values may be near the end of its branch.
    """
    u = step / N_STEPS
    return u * u * (3.0 - 2.0 * u)


def perturb_states(scene, state, scale):
    """Return slightly perturbed states, unchanged if in contact with a wall; scale: largest magnitude of x and v."""
    offset = np.where(np.asarray(state.contact) == 0, np.finfo(scene.dtype).eps ** PERTURBATION_POWER * scale, 0.0)
    x, v = (
        np.asarray(component + offset * direction, scene.dtype)
        for component, direction in zip((state.x, state.v), PERTURBATION_DIRECTION, strict=True)
    )
    return State(x, v, state.phase, state.contact)


def assign_attractors(node, state, settle):
    """Return the indices of the node's attractors that states (lanes) approach, -1 for none.

    New attractors are added to the node, with their mirror images if the scene is symmetric.
    """
    scene, candidates = node.scene, node.candidates
    x_min, x_max, _ = initial_box(scene)
    state = jax.tree.map(np.asarray, clamp_to_walls(scene, perturb_states(scene, state, node.scale)))
    iterates, periods, _ = settle_lanes(scene, state, settle, max(abs(x_min), abs(x_max)))
    attractor_indices = np.full(len(periods), -1)
    for lane in np.flatnonzero(periods):
        attractor_indices[lane] = _find_orbit(candidates, extract_orbit(iterates, lane, periods[lane])[0], node.scale)
    nonrecurrent_lanes = np.flatnonzero((periods == 0) & (iterates.status < Status.CAP))
    for lane in nonrecurrent_lanes:
        motion = sample_motion(scene, jax.tree.map(lambda leaf, lane=lane: leaf[[lane]], iterates.state))
        if motion.status[0] < Status.CAP:
            attractor_indices[lane] = _find_candidate(candidates, chaotic_candidate(scene, motion, node.scale, {}))
    n_known = len(candidates)
    for motion in find_periodic(scene, iterates, np.where(attractor_indices < 0, periods, 0), settle, node.scale)[0]:
        attractor_indices[motion.lanes] = _find_or_add(candidates, motion)
    for motion in find_chaotic(
        scene, iterates, nonrecurrent_lanes[attractor_indices[nonrecurrent_lanes] < 0], node.scale
    )[0]:
        attractor_indices[motion.lanes] = _find_or_add(candidates, motion)
    if len(candidates) > n_known:
        candidates += derived_candidates.mirror_images(scene, candidates, node.scale)
    return attractor_indices


def _find_orbit(candidates, points, scale):
    """Return the index of the periodic attractor with these points, -1 if there is none."""
    tolerance = np.finfo(points.dtype).eps ** 0.4 * scale
    for index, candidate in enumerate(candidates):
        candidate_points = candidate.fields["points"]
        if candidate.fields["periods"] == len(points) and is_rotation(points, candidate_points, tolerance):
            return index
    return -1


def _find_candidate(candidates, candidate):
    """Return the index of the candidate that is the same attractor, -1 if there is none."""
    is_same = is_same_orbit if candidate.fields["periods"] else is_same_set
    indices = (
        index for index, other in enumerate(candidates) if other.fields["periods"] == candidate.fields["periods"]
    )
    return next((index for index in indices if is_same(candidate.impact_points, candidates[index].impact_points)), -1)


def _find_or_add(candidates, candidate):
    """Return the index of an attractor among the candidates, adding it without initial states if it is new."""
    index = _find_candidate(candidates, candidate)
    if index < 0:
        candidates.append(replace(candidate, lanes=[]))
        return len(candidates) - 1
    return index
