"""Attractors carried from one value of a parameter to the next: their motion goes on while the parameter changes."""

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

N_STEPS = 64  # of the parameter from one value to the next
PERTURBATION_POWER = (
    0.375  # power of eps, of the largest x and v: it lets a motion leave an orbit that has ceased to attract
)
PERTURBATION_DIRECTION = (0.6, 0.8)


class TransportResult(NamedTuple):
    """Where an attractor was carried to. attractor_index: the place among those of the next value, None where it
    settled on none; path: x, v and contact at phase 0 on the way, MOST_PERIODS of them at each step, shape (STEPS,
    MOST_PERIODS, 3)."""

    attractor_index: int | None
    path: Float[np.ndarray, "steps periods 3"]


@dataclass(eq=False)
class ParameterNode:
    """What there is at one value of the parameter.

    scene; candidates: its attractors, as `AttractorCandidate`, whose lanes are the starts on them; n_unresolved: how
    many starts are on none; scale: of x and v, the largest; status: the worst of the starts'. transports: {-1 or 1:
    {place in `candidates`: `TransportResult`}}, to the value before and to the one after."""

    value: float
    scene: Scene
    candidates: list[AttractorCandidate]
    n_unresolved: int
    scale: float | np.floating
    status: int
    transports: dict[int, dict[int, TransportResult]] = field(default_factory=lambda: {-1: {}, 1: {}})


def transport_attractors(nodes, name, settle):
    """Carries each attractor of some `ParameterNode`s, in order of their values, to the values beside its own.

    What it settles on there and no start has found is an attractor of that value too, of no starts, and carried on in
    its turn. That takes as many rounds as there are values at most, for one that goes all along the parameter.
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
    """Carries at most WIDTH attractors, (station, place, way) each, all at once."""
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
    """States of one lane each, at phase 0, as one of many lanes."""
    components = ([getattr(state, key) for state in states] for key in ("x", "v", "contact"))
    x, v, contact = (np.array(values, scene.dtype) for values in components)
    return State(x, v, np.zeros_like(x), contact)


def _ramp_parameter(scene, name, start_values, end_values, state, scale):
    """(state, the worst status, trail (STEPS, MOST_PERIODS, lanes, 3)) of lanes whose parameters go from the beginning
    to the end."""
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
    """The part of the way that the parameter has gone after so many steps: they are small at both ends, where an
    attractor of one of the values may be near its own end."""
    u = step / N_STEPS
    return u * u * (3.0 - 2.0 * u)


def perturb_states(scene, state, scale):
    """States a little aside, but for those in contact with a wall; scale: of x and v, the largest."""
    offset = np.where(np.asarray(state.contact) == 0, np.finfo(scene.dtype).eps ** PERTURBATION_POWER * scale, 0.0)
    x, v = (
        np.asarray(component + offset * direction, scene.dtype)
        for component, direction in zip((state.x, state.v), PERTURBATION_DIRECTION, strict=True)
    )
    return State(x, v, state.phase, state.contact)


def assign_attractors(node, state, settle):
    """The places among a station's attractors on which states (lanes) settle, -1 for none; new ones are added to them,
    with their mirror images where the scene is symmetric."""
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
    """The place of the periodic attractor with these points, -1 where there is none."""
    tolerance = np.finfo(points.dtype).eps ** 0.4 * scale
    for index, candidate in enumerate(candidates):
        candidate_points = candidate.fields["points"]
        if candidate.fields["periods"] == len(points) and is_rotation(points, candidate_points, tolerance):
            return index
    return -1


def _find_candidate(candidates, candidate):
    """The place of an attractor that is one of those seen, -1 where it is none."""
    is_same = is_same_orbit if candidate.fields["periods"] else is_same_set
    indices = (
        index for index, other in enumerate(candidates) if other.fields["periods"] == candidate.fields["periods"]
    )
    return next((index for index in indices if is_same(candidate.impact_points, candidates[index].impact_points)), -1)


def _find_or_add(candidates, candidate):
    """The place of an attractor among those seen, to which it is added where it is new, as one of no starts."""
    index = _find_candidate(candidates, candidate)
    if index < 0:
        candidates.append(replace(candidate, lanes=[]))
        return len(candidates) - 1
    return index
