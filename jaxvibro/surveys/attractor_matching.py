"""Match attractors between neighbouring values of a parameter.

A motion is carried from one value to the next by simulation with a slowly changing parameter (`attractor_transport`).
Two attractors match if the motion that is carried from the first attractor approaches the second, and the motion that
is carried back approaches the first. If the values are far apart, two different attractors may also lead to each other,
each at the end of its branch. Both attractors then exist at a value in between, and they are not matched.
`_is_plausible_match` gives the weaker conditions for chaotic attractors and for nearby orbits.
"""

from itertools import pairwise

import jax
import numpy as np

from ..attractors.classify_attractors import find_mirror_index
from ..attractors.transients import settle_lanes
from ..flight.wall_positions import adapt_to_moved_walls
from ..orbits.orbit import impacts_as_points, is_same_orbit, mirror_points
from ..scene.scene_properties import is_symmetric
from ..scene.state import State
from .attractor_transport import perturb_free_states, ramp_fraction

PATH_TOLERANCE = 0.01  # relative to the largest x and v: paths in both directions that are nearer at each step are one
MATCH_DISTANCE = 0.1  # relative to the same: largest distance of an orbit from the extrapolation of another


def match_attractors(nodes, name, settle):
    """Return the tracks {node index: attractor index} of the attractors of `ParameterNode`s, in order of first node."""
    tracks = [{0: candidate_index} for candidate_index in range(len(nodes[0].candidates))]
    track_dict_by_candidate = dict(enumerate(tracks))
    for node_index, (node, next_node) in enumerate(pairwise(nodes)):
        predicted_points = [
            _extrapolate_points(nodes, node_index, track_dict_by_candidate[candidate_index])
            for candidate_index in range(len(node.candidates))
        ]
        next_match_by_index = dict(_match_node_attractors(node, next_node, name, predicted_points, settle))
        next_dict_by_candidate = {}
        for candidate_index, attractor_by_node in track_dict_by_candidate.items():
            if candidate_index in next_match_by_index:
                attractor_by_node[node_index + 1] = next_match_by_index[candidate_index]
                next_dict_by_candidate[next_match_by_index[candidate_index]] = attractor_by_node
        for candidate_index in range(len(next_node.candidates)):
            if candidate_index not in next_dict_by_candidate:
                next_dict_by_candidate[candidate_index] = {node_index + 1: candidate_index}
                tracks.append(next_dict_by_candidate[candidate_index])
        track_dict_by_candidate = next_dict_by_candidate
    return tracks


def _match_node_attractors(node, next_node, name, predicted_points, settle):
    """Return the pairs (index at `node`, index at `next_node`) of matching attractors.

    predicted_points: extrapolated points of each attractor of `node`, arrays of shape (points, 2).
    """
    forward_targets = {
        candidate_index: transport.attractor_index for candidate_index, transport in node.transports[1].items()
    }
    backward_targets = {
        candidate_index: transport.attractor_index for candidate_index, transport in next_node.transports[-1].items()
    }
    mutual_pairs = [
        (index, next_index)
        for index, next_index in forward_targets.items()
        if next_index is not None and backward_targets.get(next_index) == index
    ]
    coexisting_pairs = {
        (index, next_index)
        for index, next_index in mutual_pairs
        if _coexist_between(node, next_node, name, index, next_index, settle)
    }
    matching_pairs = _resolve_mirror_pairs(
        node, next_node, [index_pair for index_pair in mutual_pairs if index_pair not in coexisting_pairs]
    )
    unmatched_indices = [
        index for index in range(len(node.candidates)) if index not in {index for index, _ in matching_pairs}
    ]
    next_unmatched_indices = [
        next_index
        for next_index in range(len(next_node.candidates))
        if next_index not in {next_index for _, next_index in matching_pairs}
    ]
    unmatched_pairs = [
        (index, next_index)
        for index in unmatched_indices
        for next_index in next_unmatched_indices
        if (index, next_index) not in coexisting_pairs
    ]
    prediction_distances = {
        (index, next_index): median_set_distance(
            predicted_points[index], next_node.candidates[next_index].attractor_fields["points"]
        )
        / next_node.scale
        for index, next_index in unmatched_pairs
    }
    for index, next_index in sorted(prediction_distances, key=lambda pair: prediction_distances[pair]):
        if (
            index in unmatched_indices
            and next_index in next_unmatched_indices
            and _is_plausible_match(
                node,
                next_node,
                index,
                next_index,
                forward_targets.get(index),
                backward_targets.get(next_index),
                prediction_distances[index, next_index],
            )
        ):
            matching_pairs.append((index, next_index))
            unmatched_indices.remove(index)
            next_unmatched_indices.remove(next_index)
    return matching_pairs


def _is_plausible_match(node, next_node, index, next_index, forward_target, backward_target, prediction_distance):
    """Return True if two attractors match although they do not lead to each other in both directions.

    If one attractor is chaotic, one direction suffices, because a chaotic motion may leave its attractor while the
    parameter changes. Two orbits match if they are near each other and do not lead to other attractors. An orbit may
    lead to no attractor if the motions approach it too slowly to be recognised.
    """
    if not (
        node.candidates[index].attractor_fields["periods"]
        and next_node.candidates[next_index].attractor_fields["periods"]
    ):
        return forward_target == next_index or backward_target == index
    return (
        prediction_distance <= MATCH_DISTANCE
        and forward_target in (next_index, None)
        and backward_target in (index, None)
    )


def _resolve_mirror_pairs(node, next_node, mutual_pairs):
    """Return pairs in which a symmetric attractor is matched only with the representative of two mirror images.

    The representative has the label that comes first, or for equal labels the lower mean x at phase 0.
    """
    resolved_pairs = []
    for index, next_index in mutual_pairs:
        if _mirror_image_index(node, index) == index and _mirror_image_index(next_node, next_index) not in (
            None,
            next_index,
        ):
            next_index = _representative_index(next_node, next_index)
        elif _mirror_image_index(next_node, next_index) == next_index and _mirror_image_index(node, index) not in (
            None,
            index,
        ):
            index = _representative_index(node, index)
        if index not in {index for index, _ in resolved_pairs} and next_index not in {
            next_index for _, next_index in resolved_pairs
        }:
            resolved_pairs.append((index, next_index))
    return resolved_pairs


def _mirror_image_index(node, index):
    """Return the index of an attractor's mirror image, None if there is none."""
    return find_mirror_index(node.candidates[index], node.candidates) if is_symmetric(node.scene) else None


def _representative_index(node, index):
    """Return the index of the representative of an attractor and its mirror image."""

    def label_and_mean_x(index):
        """Return label and mean x at phase 0."""
        attractor_fields = node.candidates[index].attractor_fields
        return attractor_fields["label"], attractor_fields["points"][:, 0].mean()

    return min(index, _mirror_image_index(node, index), key=label_and_mean_x)


def _coexist_between(node, next_node, name, index, next_index, settle):
    """Return True if two orbits that lead to each other coexist at a value in between.

    The paths in both directions are compared at each step of the parameter. At the middle one of the steps at which the
    paths differ, both motions are simulated until they settle. If they settle on the same orbit or on mirror images,
    the transition of one path was only delayed, as after a symmetry breaking. If they settle on different orbits, both
    orbits exist at this value. The result is False if a motion does not settle, or if an attractor is chaotic.
    """
    if not (
        node.candidates[index].attractor_fields["periods"]
        and next_node.candidates[next_index].attractor_fields["periods"]
    ):
        return False
    forward_path, backward_path = node.transports[1][index].path[:-1], next_node.transports[-1][next_index].path[-2::-1]
    max_state_magnitude = max(node.scale, next_node.scale)
    path_distances = np.array(
        [
            _hausdorff_distance(*(points[:, :2] for points in points_of_both_paths))
            for points_of_both_paths in zip(forward_path, backward_path, strict=True)
        ]
    )
    distinct_step_indices = np.flatnonzero(path_distances > PATH_TOLERANCE * max_state_magnitude)
    if not distinct_step_indices.size:
        return False
    step_index = distinct_step_indices[len(distinct_step_indices) // 2]
    scene_between = node.scene.replace(
        **{name: node.value + (next_node.value - node.value) * ramp_fraction(step_index + 1)}
    )
    x, v, contact = np.stack([forward_path[step_index, -1], backward_path[step_index, -1]], -1).astype(
        scene_between.dtype
    )
    state = adapt_to_moved_walls(
        scene_between, perturb_free_states(scene_between, State(x, v, np.zeros_like(x), contact), max_state_magnitude)
    )
    iterates, recurrence_periods, _ = settle_lanes(scene_between, jax.tree.map(np.asarray, state), settle)
    return bool(recurrence_periods.all()) and not _is_same_or_mirror(
        scene_between,
        *(
            _impacts_of_orbit(scene_between, iterates, lane, recurrence_periods[lane], max_state_magnitude)
            for lane in (0, 1)
        ),
    )


def _impacts_of_orbit(scene, iterates, lane, n_periods, max_state_magnitude):
    """Return the impacts of a lane that has settled on an orbit, as points of shape (impacts, 4)."""
    return impacts_as_points(
        float(scene.frequency),
        *(impact_array[-n_periods:, lane] for impact_array in (iterates.time, iterates.side, iterates.speed)),
        max_state_magnitude,
    )


def _is_same_or_mirror(scene, impact_points, other_impact_points):
    """Return True if two orbits are the same, or mirror images in a symmetric scene.

    A motion from a symmetric orbit may settle on either mirror image.
    """
    return is_same_orbit(impact_points, other_impact_points) or (
        is_symmetric(scene) and is_same_orbit(mirror_points(impact_points), other_impact_points)
    )


def _hausdorff_distance(points, other_points):
    """Return the Hausdorff distance of two sets of points."""
    distances = abs(points[:, None] - other_points).max(axis=-1)
    return max(distances.min(axis=0).max(), distances.min(axis=1).max())


def median_set_distance(points, other_points):
    """Return the median distance of the points of a set from another set, the larger value of both directions."""
    distances = np.hypot(*np.moveaxis(points[:, None] - other_points, -1, 0))
    return float(max(np.median(distances.min(axis=0)), np.median(distances.min(axis=1))))


def _extrapolate_points(nodes, node_index, attractor_by_node):
    """Return the points (points, 2) of an orbit, extrapolated linearly to the next value, or of a chaotic attractor."""
    attractor_fields = nodes[node_index].candidates[attractor_by_node[node_index]].attractor_fields
    section_points, n_periods = attractor_fields["points"], attractor_fields["periods"]
    previous_fields = (
        nodes[node_index - 1].candidates[attractor_by_node[node_index - 1]].attractor_fields
        if node_index - 1 in attractor_by_node
        else None
    )
    if not n_periods or previous_fields is None or previous_fields["periods"] != n_periods:
        return section_points
    previous_value, value, next_value = (node.value for node in nodes[node_index - 1 : node_index + 2])
    rotated_points = nearest_rotation(previous_fields["points"], section_points)
    return section_points + (section_points - rotated_points) * ((next_value - value) / (value - previous_value))


def nearest_rotation(points, other_points):
    """Return the points of an orbit (periods, 2), rotated to be nearest to the points of an orbit of equal length."""
    rotations = [np.roll(points, shift, axis=0) for shift in range(len(points))]
    return min(rotations, key=lambda rotation: abs(rotation - other_points).max())
