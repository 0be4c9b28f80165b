"""Continue the special points of many branches to loci, and find loci between which two stable motions coexist."""

from itertools import pairwise

import numpy as np

from continuation.branch_segment import EXPIRED_REASON, make_limits

from ..branches.branch import neighbour_labels
from ..maps.itinerary import LETTERS, format_label, is_same_itinerary, mirror_itinerary
from ..orbits.flight_clearance import GRAZING_TOLERANCE
from ..scene.check import ArgumentError, make_name_tuple
from .locus import locus
from .locus_start import KINDS

ON_CURVE_TOLERANCE = 1e-6  # relative to the range of a parameter: a point closer than this is on the locus
NODES_PER_SIDE = 4  # points on each side that interpolate a locus


def follow_loci(branches, names, bounds, kinds=KINDS, largest_step=0.1, progress=None, max_seconds=None):
    """Continue each special point of branches in two parameters, unless a locus passes through it.

    Parameters
    ----------
    branches : sequence of Branch
        Branches of one scene.
    names : sequence of str
        Names of the two parameters, as in `locus`.
    bounds : dict of str to tuple of float
        Lower and upper bound of each parameter. Special points outside the bounds are omitted.
    kinds : str or sequence of str, optional
        Kinds of special point. By default SN, PD, SB and GR.
    largest_step : float, optional
        Largest arclength step, as in `locus`.
    progress : callable, optional
        Function that is called with the number of points processed.
    max_seconds : float, optional
        Wall-clock time in s after which the remaining points are not continued. By default the time is unlimited.

    Returns
    -------
    loci : tuple of Locus
        The loci.
    refusals : tuple of tuple
        (special point, reason) for each point that cannot be continued, or that is not continued because the time
        expired.
    """
    limits = make_limits(None, max_seconds, None, ArgumentError)
    known_loci, refused_points = [], []
    kinds = make_name_tuple("kinds", kinds)
    special_points = [
        special
        for branch in branches
        for special in branch.special
        if special.kind in kinds and _is_within_bounds(special, bounds)
    ]
    for n_processed, special in enumerate(special_points, 1):
        if limits.expired:
            refused_points.append((special, EXPIRED_REASON))
        elif not any(passes_through_special(known_locus, special) for known_locus in known_loci):
            try:
                known_loci.append(
                    locus(special, names, bounds, largest_step=largest_step, max_seconds=limits.seconds_remaining)
                )
            except ArgumentError as error:
                refused_points.append((special, error.rule))
        if progress is not None:
            progress(n_processed)
    return tuple(known_loci), tuple(refused_points)


def count_points_to_follow(branches, bounds, kinds=KINDS):
    """Count the special points that `follow_loci` processes.

    Parameters
    ----------
    branches : sequence of Branch
        Branches of one scene.
    bounds : dict of str to tuple of float
        Lower and upper bound of each parameter.
    kinds : str or sequence of str, optional
        Kinds of special point.

    Returns
    -------
    int
        Number of special points of these kinds within the bounds.
    """
    kinds = make_name_tuple("kinds", kinds)
    return sum(
        special.kind in kinds and _is_within_bounds(special, bounds)
        for branch in branches
        for special in branch.special
    )


def _is_within_bounds(special, bounds):
    return all(lower <= float(special.scene.parameter(name)) <= upper for name, (lower, upper) in bounds.items())


def passes_through_special(locus, special):
    """Check whether a locus passes through a special point of a branch."""
    if locus.kind != special.kind or locus.label not in _possible_labels(special):
        return False
    return contains_point(locus, [float(special.scene.parameter(name)) for name in locus.names])


def _possible_labels(special):
    """Return the labels that the locus of a special point may have.

    The label of a locus of GR counts the grazing contact as an impact. The locus therefore has the label of the orbit
    or of a branch that meets the point. If all impacts are grazing contacts, the locus may have the label of a single
    contact.
    """
    if special.kind != "GR":
        return {special.label}
    orbit_labels = {special.label, *(neighbour_label.rstrip("<>") for neighbour_label in neighbour_labels(special))}
    grazing_labels = {format_label(("",) * (special.spot.periods - 1) + (letter,)) for letter in LETTERS.values()}
    return orbit_labels | (set() if (special.spot.speeds > GRAZING_TOLERANCE).any() else grazing_labels)


def contains_point(locus, parameter_values):
    """Check whether a point of the parameter plane lies on a `Locus`.

    The tolerance is `ON_CURVE_TOLERANCE` times the width of the bounds, plus twice the estimated interpolation error.
    The locus is interpolated by a polynomial through the points nearest to the given point.
    """
    lower, upper = np.array([locus.bounds[name] for name in locus.names]).T
    scaled_curve, scaled_point = (
        (locus.values - lower) / (upper - lower),
        (np.asarray(parameter_values, float) - lower) / (upper - lower),
    )
    segment_starts, segment_vectors = scaled_curve[:-1], np.diff(scaled_curve, axis=0)
    squared_lengths = np.maximum(np.sum(segment_vectors**2, axis=1), np.finfo(float).tiny)
    projection_fractions = np.clip(
        np.sum((scaled_point - segment_starts) * segment_vectors, axis=1) / squared_lengths, 0.0, 1.0
    )
    distances = np.linalg.norm(segment_starts + projection_fractions[:, None] * segment_vectors - scaled_point, axis=1)
    nearest_segment = int(np.argmin(distances))
    is_beyond_end = (nearest_segment == 0 and projection_fractions[0] == 0.0) or (
        nearest_segment == len(projection_fractions) - 1 and projection_fractions[-1] == 1.0
    )
    if (
        distances[nearest_segment] <= ON_CURVE_TOLERANCE
        or is_beyond_end
        or distances[nearest_segment] > np.sqrt(squared_lengths[nearest_segment])
    ):
        return bool(distances[nearest_segment] <= ON_CURVE_TOLERANCE)
    distance, uncertainty = min(
        (_interpolated_distance(scaled_curve, nearest_segment, axis, scaled_point) for axis in (0, 1)),
        key=lambda estimate: estimate[1],
    )
    return bool(distance <= ON_CURVE_TOLERANCE + 2.0 * uncertainty)


def _interpolated_distance(scaled_curve, segment_index, abscissa_axis, scaled_point):
    """Return (distance, uncertainty) of a point from the polynomial that interpolates a curve near a segment.

    The distance is measured along the axis other than `abscissa_axis`. The uncertainty is the change of the polynomial
    at the point if the farthest node is omitted. Both are inf if the curve is not monotone at the segment.
    """
    node_indices = _monotone_nodes(scaled_curve[:, abscissa_axis], segment_index)
    if len(node_indices) < 2:
        return np.inf, np.inf
    value_from_all_nodes, value_from_fewer_nodes = (
        _interpolate_ordinate(scaled_curve[node_subset], abscissa_axis, scaled_point[abscissa_axis])
        for node_subset in (node_indices, _drop_farthest_point(node_indices, segment_index))
    )
    return abs(value_from_all_nodes - scaled_point[1 - abscissa_axis]), abs(
        value_from_all_nodes - value_from_fewer_nodes
    )


def _monotone_nodes(abscissae, segment_index):
    """Return the indices of at most `NODES_PER_SIDE` points on each side of a segment with strictly monotone values."""
    sign_of_change = np.sign(abscissae[segment_index + 1] - abscissae[segment_index])
    if not sign_of_change:
        return np.arange(0)
    first_node, last_node = segment_index, segment_index + 1
    while (
        first_node > 0
        and segment_index - first_node < NODES_PER_SIDE
        and (abscissae[first_node] - abscissae[first_node - 1]) * sign_of_change > 0
    ):
        first_node -= 1
    while (
        last_node < len(abscissae) - 1
        and last_node - segment_index < NODES_PER_SIDE
        and (abscissae[last_node + 1] - abscissae[last_node]) * sign_of_change > 0
    ):
        last_node += 1
    return np.arange(first_node, last_node + 1)


def _drop_farthest_point(node_indices, segment_index):
    """Return the nodes without the node that is farthest from a segment."""
    if len(node_indices) == 2:
        return node_indices[:1]
    return (
        node_indices[1:]
        if segment_index - node_indices[0] > node_indices[-1] - segment_index - 1
        else node_indices[:-1]
    )


def _interpolate_ordinate(node_points, abscissa_axis, abscissa):
    """Evaluate the Lagrange polynomial of one coordinate as a function of the other."""
    node_abscissae = node_points[:, abscissa_axis]
    abscissa_differences = node_abscissae[:, None] - node_abscissae
    np.fill_diagonal(abscissa_differences, 1.0)
    lagrange_factors = (abscissa - node_abscissae)[None, :] / abscissa_differences
    np.fill_diagonal(lagrange_factors, 1.0)
    return float(node_points[:, 1 - abscissa_axis] @ np.prod(lagrange_factors, axis=1))


def find_mirror_locus(locus, other_loci):
    """Find the locus of the mirror-image orbits that lies on the same curve as a locus.

    Parameters
    ----------
    locus : Locus
        The locus.
    other_loci : sequence of Locus
        Candidates.

    Returns
    -------
    Locus or None
        The first candidate that is the mirror image, or None.
    """
    (itinerary, *_), middle_point = (
        (locus_special_point.itinerary for locus_special_point in locus.special),
        locus.values[len(locus) // 2],
    )
    for other_locus in other_loci:
        is_candidate = other_locus.kind == locus.kind and other_locus.names == locus.names and other_locus is not locus
        if (
            is_candidate
            and is_same_itinerary(mirror_itinerary(itinerary), other_locus.special[0].itinerary)
            and contains_point(other_locus, middle_point)
        ):
            return other_locus
    return None


STABILITY_OFFSET = 2  # points between a special point and the point at which stability is read


def find_coexistence_loci(branches, loci):
    """Find pairs of loci between which a branch folds from one stable part to another.

    Two stable motions coexist between the special points at the two ends of the unstable part. They therefore coexist
    between the loci of these points.

    Parameters
    ----------
    branches : sequence of Branch
        Branches of one scene.
    loci : sequence of Locus
        Loci of their special points.

    Returns
    -------
    list of tuple
        (first `Locus`, second `Locus`, labels of the two stable motions, such as ``"P100 and P111"``) for each pair.
        Pairs of special points of which one has no locus in `loci` are omitted.
    """
    coexistence_entries = []
    for branch in branches:
        for first_special, last_special in pairwise(
            candidate for candidate in branch.special if candidate.kind != "EP"
        ):
            motion_labels = _stable_motion_labels(
                branch, first_special.place - STABILITY_OFFSET, last_special.place + STABILITY_OFFSET
            )
            if motion_labels is None or not _is_unstable_fold_back(branch, first_special.place, last_special.place):
                continue
            locus_pair = tuple(
                next((candidate for candidate in loci if passes_through_special(candidate, special)), None)
                for special in (first_special, last_special)
            )
            if None not in locus_pair and not any(candidate[:2] == locus_pair for candidate in coexistence_entries):
                coexistence_entries.append((*locus_pair, motion_labels))
    return coexistence_entries


def _stable_motion_labels(branch, row_before, row_after):
    """Return the labels of the stable motions at two points, or None if a point is unstable or beyond the branch."""
    if row_before < 0 or row_after >= len(branch) or not (branch.stable[row_before] and branch.stable[row_after]):
        return None
    labels = [
        next(
            branch_segment.label
            for branch_segment in branch.segments
            if branch_segment.first <= row <= branch_segment.last
        )
        for row in (row_before, row_after)
    ]
    return " and ".join(dict.fromkeys(labels))


def _is_unstable_fold_back(branch, first_row, last_row):
    """Check that a branch is unstable between two points, and runs in the same direction before and after them.

    The direction is that of the parameter. The branch then turns back at both points or at neither.
    """
    parameter_values = branch.values
    turns_back = (parameter_values[first_row] - parameter_values[first_row - STABILITY_OFFSET]) * (
        parameter_values[last_row] - parameter_values[last_row + STABILITY_OFFSET]
    ) < 0
    return bool(turns_back and last_row - first_row > 1 and not branch.stable[first_row + 1 : last_row].any())
