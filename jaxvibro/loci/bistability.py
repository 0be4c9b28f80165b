"""Find pairs of loci between which two stable motions coexist: `find_coexistence_loci`."""

from itertools import pairwise

from .loci_of_branches import passes_through_special

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
