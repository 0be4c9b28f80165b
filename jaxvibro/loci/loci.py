"""Continue all special points of branches, each once: `follow_loci`. Test points against loci; find mirror images."""

import numpy as np

from continuation.limits import EXPIRED_REASON, limits_of

from ..branches.branch import neighbour_labels
from ..maps.itinerary import LETTERS, is_same_itinerary, label, mirror_itinerary
from ..problem.grazing_contact import GRAZING_TOLERANCE
from ..scene.check import ArgumentError, name_tuple
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
        Lower and upper bound of each parameter. Points outside are omitted.
    kinds : str or sequence of str, optional
        Kinds of special point.
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
        (special point, reason) for each point that cannot be continued.
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
    kinds = name_tuple("kinds", kinds)
    return sum(
        special.kind in kinds and _is_within(special, bounds) for branch in branches for special in branch.special
    )


def _is_within(special, bounds):
    return all(lower <= float(special.scene.parameter(name)) <= upper for name, (lower, upper) in bounds.items())


def passes_through(locus, special):
    """Check whether a locus passes through a special point of a branch."""
    if locus.kind != special.kind or locus.label not in _possible_labels(special):
        return False
    return contains_point(locus, [float(special.scene.parameter(name)) for name in locus.names])


def _possible_labels(special):
    """Return the labels that the locus of a special point may have.

    At a grazing the locus counts the impacts that appear, and may have the label of one contact alone.
    """
    if special.kind != "GR":
        return {special.label}
    labels = {special.label, *(text.rstrip("<>") for text in neighbour_labels(special))}
    grazing_labels = {label(("",) * (special.spot.periods - 1) + (letter,)) for letter in LETTERS.values()}
    return labels | (set() if (special.spot.speeds > GRAZING_TOLERANCE).any() else grazing_labels)


def contains_point(locus, values):
    """Check whether a point of the parameter plane lies on a `Locus`, to a millionth of the widths of its bounds.

    Between its points the locus is interpolated by a polynomial through the nearest of them. If these are too far apart
    for this accuracy, the estimated interpolation error is allowed for.
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
    """Return the distance of a point from a curve near a segment, along the other axis, and its uncertainty."""
    nodes = _monotone_nodes(curve[:, axis], segment_index)
    if len(nodes) < 2:
        return np.inf, np.inf
    fine_value, coarse_value = (
        _interpolate(curve[node_subset], axis, point[axis])
        for node_subset in (nodes, _drop_farthest_node(nodes, segment_index))
    )
    return abs(fine_value - point[1 - axis]), abs(fine_value - coarse_value)


def _monotone_nodes(values, segment_index):
    """Return the indices of a few neighbours of a segment between which values are monotone."""
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
    """Return the nodes without the farthest from a segment."""
    if len(nodes) == 2:
        return nodes[:1]
    return nodes[1:] if segment_index - nodes[0] > nodes[-1] - segment_index - 1 else nodes[:-1]


def _interpolate(nodes, axis, coordinate):
    """Evaluate the Lagrange polynomial of one coordinate as a function of the other."""
    knots = nodes[:, axis]
    knot_differences = knots[:, None] - knots
    np.fill_diagonal(knot_differences, 1.0)
    lagrange_ratios = (coordinate - knots)[None, :] / knot_differences
    np.fill_diagonal(lagrange_ratios, 1.0)
    return float(nodes[:, 1 - axis] @ np.prod(lagrange_ratios, axis=1))


def find_mirror_image(locus, other_loci):
    """Find the locus that is the mirror image of a locus on the same curve.

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
