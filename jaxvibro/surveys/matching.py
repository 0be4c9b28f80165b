"""Match attractors between neighbouring values of a parameter.

Two attractors match if the motion carried from the first approaches the second, and returns. Between coarse values, two
coexisting attractors may also lead to each other, each at the end of the other's branch. Then both exist at a value in
between, and they remain two.
"""

from itertools import pairwise

import jax
import numpy as np

from ..attractors.derived_candidates import mirror_index
from ..attractors.transients import settle_lanes
from ..flight.wall_positions import clamp_to_walls
from ..maps.initial_conditions import initial_box
from ..orbits.orbit_comparison import impacts_as_points, is_same_orbit, mirror_points
from ..scene.state import State
from ..scene.symmetry import is_symmetric
from .attractor_transport import perturb_states, ramp_fraction

PATH_TOLERANCE = 0.01  # relative to the largest x and v: paths in both directions that are nearer at each step are one
MATCH_DISTANCE = 0.1  # relative to the same: largest distance of an orbit from the extrapolation of another


def match_attractors(nodes, name, settle):
    """Return the tracks {node index: attractor index} of the attractors of `ParameterNode`s, the first node first."""
    tracks = [{0: index} for index in range(len(nodes[0].candidates))]
    current_tracks = dict(enumerate(tracks))
    for node_index, (node, next_node) in enumerate(pairwise(nodes)):
        predicted_points = [
            _extrapolate_points(nodes, node_index, current_tracks[index]) for index in range(len(node.candidates))
        ]
        matches = dict(_match_pairs(node, next_node, name, predicted_points, settle))
        next_tracks = {}
        for index, track in current_tracks.items():
            if index in matches:
                track[node_index + 1] = matches[index]
                next_tracks[matches[index]] = track
        for index in range(len(next_node.candidates)):
            if index not in next_tracks:
                next_tracks[index] = {node_index + 1: index}
                tracks.append(next_tracks[index])
        current_tracks = next_tracks
    return tracks


def _match_pairs(node, next_node, name, predicted_points, settle):
    """Return [(index, index)] of the matching attractors of two nodes.

    predicted_points: extrapolated points of the attractors of the first node, (points, 2) each.
    """
    forward_map = {index: transport.attractor_index for index, transport in node.transports[1].items()}
    backward_map = {index: transport.attractor_index for index, transport in next_node.transports[-1].items()}
    mutual_pairs = [(i, j) for i, j in forward_map.items() if j is not None and backward_map.get(j) == i]
    distinct_pairs = {(i, j) for i, j in mutual_pairs if _coexist_between(node, next_node, name, i, j, settle)}
    pairs = _resolve_mirror_pairs(node, next_node, [pair for pair in mutual_pairs if pair not in distinct_pairs])
    unmatched = [i for i in range(len(node.candidates)) if i not in {i for i, _ in pairs}]
    next_unmatched = [j for j in range(len(next_node.candidates)) if j not in {j for _, j in pairs}]
    open_pairs = [(i, j) for i in unmatched for j in next_unmatched if (i, j) not in distinct_pairs]
    distances = {
        (i, j): median_distance(predicted_points[i], next_node.candidates[j].fields["points"]) / next_node.scale
        for i, j in open_pairs
    }
    for i, j in sorted(distances, key=lambda pair: distances[pair]):
        if (
            i in unmatched
            and j in next_unmatched
            and _is_plausible_match(node, next_node, i, j, forward_map.get(i), backward_map.get(j), distances[i, j])
        ):
            pairs.append((i, j))
            unmatched.remove(i)
            next_unmatched.remove(j)
    return pairs


def _is_plausible_match(node, next_node, i, j, forward_index, backward_index, distance):
    """Return True if two attractors that do not lead to each other in both directions are taken as one.

    For chaotic attractors, whose motion may leave for others on the way, one direction suffices. Orbits must be near
    and lead to nothing else: this includes orbits that attract too slowly to be recognised.
    """
    if not (node.candidates[i].fields["periods"] and next_node.candidates[j].fields["periods"]):
        return forward_index == j or backward_index == i
    return distance <= MATCH_DISTANCE and forward_index in (j, None) and backward_index in (i, None)


def _resolve_mirror_pairs(node, next_node, mutual_pairs):
    """Return the pairs such that a symmetric attractor continues as the first of two mirror images.

    The first is the one whose label comes first, or else whose mean x at phase 0 is lower.
    """
    pairs = []
    for i, j in mutual_pairs:
        if _image_index(node, i) == i and _image_index(next_node, j) not in (None, j):
            j = _representative(next_node, j)
        elif _image_index(next_node, j) == j and _image_index(node, i) not in (None, i):
            i = _representative(node, i)
        if i not in {i for i, _ in pairs} and j not in {j for _, j in pairs}:
            pairs.append((i, j))
    return pairs


def _image_index(node, index):
    """Return the index of an attractor's mirror image, None if there is none."""
    return mirror_index(node.candidates[index], node.candidates) if is_symmetric(node.scene) else None


def _representative(node, index):
    """Return the index that stands for an attractor and its mirror image."""

    def sort_key(index):
        """Return label and mean x at phase 0."""
        fields = node.candidates[index].fields
        return fields["label"], fields["points"][:, 0].mean()

    return min(index, _image_index(node, index), key=sort_key)


def _coexist_between(node, next_node, name, i, j, settle):
    """Return True if two orbits that lead to each other both exist at a value in between.

    The paths in both directions are compared at each step of the parameter. In the middle of the steps at which they
    differ both motions settle. A delayed motion, as after a symmetry breaking, approaches the other; a motion that
    settles elsewhere is another attractor.
    """
    if not (node.candidates[i].fields["periods"] and next_node.candidates[j].fields["periods"]):
        return False
    forward_path, backward_path = node.transports[1][i].path[:-1], next_node.transports[-1][j].path[-2::-1]
    scale = max(node.scale, next_node.scale)
    distances = np.array(
        [_hausdorff(*(points[:, :2] for points in pair)) for pair in zip(forward_path, backward_path, strict=True)]
    )
    distinct_steps = np.flatnonzero(distances > PATH_TOLERANCE * scale)
    if not distinct_steps.size:
        return False
    step = distinct_steps[len(distinct_steps) // 2]
    scene = node.scene.replace(**{name: node.value + (next_node.value - node.value) * ramp_fraction(step + 1)})
    x, v, contact = np.stack([forward_path[step, -1], backward_path[step, -1]], -1).astype(scene.dtype)
    state = clamp_to_walls(scene, perturb_states(scene, State(x, v, np.zeros_like(x), contact), scale))
    x_min, x_max, _ = initial_box(scene)
    iterates, periods, _ = settle_lanes(scene, jax.tree.map(np.asarray, state), settle, max(abs(x_min), abs(x_max)))
    return bool(periods.all()) and not _is_same_or_mirror(
        scene, *(_impact_points(scene, iterates, lane, periods[lane], scale) for lane in (0, 1))
    )


def _impact_points(scene, iterates, lane, periods, scale):
    """Return the impacts, as points, of a lane that has settled on an orbit."""
    return impacts_as_points(
        float(scene.frequency),
        *(record[-periods:, lane] for record in (iterates.time, iterates.side, iterates.speed)),
        scale,
    )


def _is_same_or_mirror(scene, points, other_points):
    """Return True if two orbits are the same, or mirror images in a symmetric scene.

    A symmetric motion may have led to either image.
    """
    return is_same_orbit(points, other_points) or (
        is_symmetric(scene) and is_same_orbit(mirror_points(points), other_points)
    )


def _hausdorff(points, other_points):
    """Return the Hausdorff distance of two sets of points."""
    distances = abs(points[:, None] - other_points).max(axis=-1)
    return max(distances.min(axis=0).max(), distances.min(axis=1).max())


def median_distance(points, other_points):
    """Return the median distance of points from another set, the larger of both directions."""
    distances = np.hypot(*np.moveaxis(points[:, None] - other_points, -1, 0))
    return float(max(np.median(distances.min(axis=0)), np.median(distances.min(axis=1))))


def _extrapolate_points(nodes, node_index, track):
    """Return the points (points, 2) of an attractor extrapolated linearly to the next value; chaotic ones unchanged."""
    fields = nodes[node_index].candidates[track[node_index]].fields
    points, n_periods = fields["points"], fields["periods"]
    previous_fields = (
        nodes[node_index - 1].candidates[track[node_index - 1]].fields if node_index - 1 in track else None
    )
    if not n_periods or previous_fields is None or previous_fields["periods"] != n_periods:
        return points
    previous_value, value, next_value = (node.value for node in nodes[node_index - 1 : node_index + 2])
    rotated_points = nearest_rotation(previous_fields["points"], points)
    return points + (points - rotated_points) * ((next_value - value) / (value - previous_value))


def nearest_rotation(points, other_points):
    """Return the points of an orbit (periods, 2), rotated to be nearest to the points of an orbit of equal length."""
    rotations = [np.roll(points, shift, axis=0) for shift in range(len(points))]
    return min(rotations, key=lambda rotation: abs(rotation - other_points).max())
