"""The loci of all special points of branches, each once: `follow_loci`; whether a point lies on a locus; mirror
images."""

import numpy as np

from continuation.limits import EXPIRED_REASON, limits_of

from ..branches.branch import neighbour_labels
from ..maps.itinerary import LETTERS, is_same_itinerary, label, mirror_itinerary
from ..problem.grazing_contact import GRAZING_TOLERANCE
from ..scene.check import ArgumentError, name_tuple
from .locus import locus
from .locus_start import KINDS

ON_CURVE_TOLERANCE = 1e-6  # of a parameter's range: a point as near to a locus is on it
NODES_PER_SIDE = 4  # of its points on each side, through which a locus is interpolated


def follow_loci(branches, names, bounds, kinds=KINDS, largest_step=0.1, progress=None, max_seconds=None):
    """(the `Locus` of each special point of branches, (special point, why) of those that cannot be followed), tuples.

    branches: of one scene; names, bounds, largest_step: as in `locus`; kinds: of the points. Left out are points
    outside the bounds, and those that a locus found before leads through. progress: called with the points so far.
    max_seconds: wall-clock time, s, after which the points that are left are not followed; None is no limit.
    """
    limits = limits_of(None, max_seconds, None, ArgumentError)
    loci_found, refusals = [], []
    kinds = name_tuple("kinds", kinds)
    special_points = [
        special
        for branch in branches
        for special in branch.special
        if special.kind in kinds and _is_within(special, bounds)
    ]
    for n_processed, special in enumerate(special_points, 1):
        if limits.expired:
            refusals.append((special, EXPIRED_REASON))
        elif not any(passes_through(known_locus, special) for known_locus in loci_found):
            try:
                loci_found.append(
                    locus(special, names, bounds, largest_step=largest_step, max_seconds=limits.remaining)
                )
            except ArgumentError as error:
                refusals.append((special, error.rule))
        if progress is not None:
            progress(n_processed)
    return tuple(loci_found), tuple(refusals)


def count_points(branches, bounds, kinds=KINDS):
    """How many special points `follow_loci` looks at."""
    kinds = name_tuple("kinds", kinds)
    return sum(
        special.kind in kinds and _is_within(special, bounds) for branch in branches for special in branch.special
    )


def _is_within(special, bounds):
    return all(lower <= float(special.scene.parameter(name)) <= upper for name, (lower, upper) in bounds.items())


def passes_through(locus, special):
    """Whether a locus leads through a special point of a branch."""
    if locus.kind != special.kind or locus.label not in _possible_labels(special):
        return False
    return contains_point(locus, [float(special.scene.parameter(name)) for name in locus.names])


def _possible_labels(special):
    """The labels that a special point's locus may have: at a grazing it counts the impacts that come in, and may be
    that of one touch alone."""
    if special.kind != "GR":
        return {special.label}
    labels = {special.label, *(text.rstrip("<>") for text in neighbour_labels(special))}
    grazing_labels = {label(("",) * (special.spot.periods - 1) + (letter,)) for letter in LETTERS.values()}
    return labels | (set() if (special.spot.speeds > GRAZING_TOLERANCE).any() else grazing_labels)


def contains_point(locus, values):
    """Whether two values of its parameters are a point of a `Locus`, to a millionth of its bounds' widths.

    Between its points the locus is a polynomial through the nearest of them; where these are too far apart to tell as
    exactly, it is what they tell.
    """
    lower, upper = np.array([locus.bounds[name] for name in locus.names]).T
    curve, point = (locus.values - lower) / (upper - lower), (np.asarray(values, float) - lower) / (upper - lower)
    segment_starts, segments = curve[:-1], np.diff(curve, axis=0)
    squared_lengths = np.maximum(np.sum(segments**2, axis=1), np.finfo(float).tiny)
    fractions = np.clip(np.sum((point - segment_starts) * segments, axis=1) / squared_lengths, 0.0, 1.0)
    distances = np.linalg.norm(segment_starts + fractions[:, None] * segments - point, axis=1)
    nearest_index = int(np.argmin(distances))
    is_beyond_end = (nearest_index == 0 and fractions[0] == 0.0) or (
        nearest_index == len(fractions) - 1 and fractions[-1] == 1.0
    )
    if (
        distances[nearest_index] <= ON_CURVE_TOLERANCE
        or is_beyond_end
        or distances[nearest_index] > np.sqrt(squared_lengths[nearest_index])
    ):
        return bool(distances[nearest_index] <= ON_CURVE_TOLERANCE)
    distance, uncertainty = min(
        (_interpolated_distance(curve, nearest_index, axis, point) for axis in (0, 1)), key=lambda estimate: estimate[1]
    )
    return bool(distance <= ON_CURVE_TOLERANCE + 2.0 * uncertainty)


def _interpolated_distance(curve, segment_index, axis, point):
    """(how far a point is from a curve near a piece of it, along the other axis; how well that is known)."""
    nodes = _monotone_nodes(curve[:, axis], segment_index)
    if len(nodes) < 2:
        return np.inf, np.inf
    fine_value, coarse_value = (
        _interpolate(curve[node_subset], axis, point[axis])
        for node_subset in (nodes, _drop_farthest_node(nodes, segment_index))
    )
    return abs(fine_value - point[1 - axis]), abs(fine_value - coarse_value)


def _monotone_nodes(values, segment_index):
    """The places of a few neighbours of a piece, as far as values go on in one direction."""
    direction = np.sign(values[segment_index + 1] - values[segment_index])
    if not direction:
        return np.arange(0)
    first_node, last_node = segment_index, segment_index + 1
    while (
        first_node > 0
        and segment_index - first_node < NODES_PER_SIDE
        and (values[first_node] - values[first_node - 1]) * direction > 0
    ):
        first_node -= 1
    while (
        last_node < len(values) - 1
        and last_node - segment_index < NODES_PER_SIDE
        and (values[last_node + 1] - values[last_node]) * direction > 0
    ):
        last_node += 1
    return np.arange(first_node, last_node + 1)


def _drop_farthest_node(nodes, segment_index):
    """The nodes but for the one farthest from a piece."""
    if len(nodes) == 2:
        return nodes[:1]
    return nodes[1:] if segment_index - nodes[0] > nodes[-1] - segment_index - 1 else nodes[:-1]


def _interpolate(nodes, axis, coordinate):
    """The value of Lagrange's polynomial through nodes, of the one coordinate by the other."""
    knots = nodes[:, axis]
    knot_differences = knots[:, None] - knots
    np.fill_diagonal(knot_differences, 1.0)
    lagrange_ratios = (coordinate - knots)[None, :] / knot_differences
    np.fill_diagonal(lagrange_ratios, 1.0)
    return float(nodes[:, 1 - axis] @ np.prod(lagrange_ratios, axis=1))


def find_mirror_image(locus, other_loci):
    """The first of other `Locus` that is the mirror image of one, on the same curve, or None."""
    (itinerary, *_), middle_values = (
        (special_point.itinerary for special_point in locus.special),
        locus.values[len(locus) // 2],
    )
    for other_locus in other_loci:
        is_candidate = other_locus.kind == locus.kind and other_locus.names == locus.names and other_locus is not locus
        if (
            is_candidate
            and is_same_itinerary(mirror_itinerary(itinerary), other_locus.special[0].itinerary)
            and contains_point(other_locus, middle_values)
        ):
            return other_locus
    return None
