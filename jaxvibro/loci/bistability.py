"""Find pairs of loci between which two stable motions coexist: `coexistences`."""

from itertools import pairwise

from .loci import passes_through

STABILITY_OFFSET = 2  # points between a special point and the point at which stability is read


def coexistences(branches, loci):
    """Find pairs of loci between which a branch folds from one stable part to another.

    Two stable motions coexist between the special points at both ends of the unstable part, and hence between the loci
    of these points.

    Parameters
    ----------
    branches : sequence of Branch
        Branches of one scene.
    loci : sequence of Locus
        Loci of their special points.

    Returns
    -------
    list of tuple
        (first `Locus`, second `Locus`, text such as ``"P100 and P111"``) for each pair. Folds whose special points have
        no locus are omitted.
    """
    locus_pairs = []
    for branch in branches:
        for first_special, last_special in pairwise(
            candidate for candidate in branch.special if candidate.kind != "EP"
        ):
            label_text = _coexistence_label(
                branch, first_special.place - STABILITY_OFFSET, last_special.place + STABILITY_OFFSET
            )
            if label_text is None or not _is_fold(branch, first_special.place, last_special.place):
                continue
            locus_pair = tuple(
                next((candidate for candidate in loci if passes_through(candidate, special)), None)
                for special in (first_special, last_special)
            )
            if None not in locus_pair and not any(candidate[:2] == locus_pair for candidate in locus_pairs):
                locus_pairs.append((*locus_pair, label_text))
    return locus_pairs


def _coexistence_label(branch, index_before, index_after):
    """Name the motions at two points, or return None if a point is not stable or not a point of the branch."""
    if (
        index_before < 0
        or index_after >= len(branch)
        or not (branch.stable[index_before] and branch.stable[index_after])
    ):
        return None
    labels = [
        next(segment.label for segment in branch.segments if segment.first <= k <= segment.last)
        for k in (index_before, index_after)
    ]
    return " and ".join(dict.fromkeys(labels))


def _is_fold(branch, first_index, last_index):
    """Check that a branch is unstable between two points and reaches both from the same side of the parameter."""
    values = branch.values
    turns_back = (values[first_index] - values[first_index - STABILITY_OFFSET]) * (
        values[last_index] - values[last_index + STABILITY_OFFSET]
    ) < 0
    return bool(turns_back and last_index - first_index > 1 and not branch.stable[first_index + 1 : last_index].any())
