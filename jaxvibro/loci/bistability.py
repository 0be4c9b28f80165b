"""Between which loci two stable motions exist: `coexistences`, read from the folds of branches."""

from itertools import pairwise

from .loci import leads_through

BESIDE = 2  # points of a branch from a special one to where its stability is looked at


def coexistences(branches, loci):
    """(first `Locus`, second `Locus`, "P100 and P111") wherever a branch folds back from one stable stretch to another.

    The two stable motions exist together between the special points at both ends of the unstable stretch between them,
    and so between the loci of these. Left out is what has no locus.
    """
    found = []
    for branch in branches:
        for first, last in pairwise(one for one in branch.special if one.kind != "EP"):
            told = _labels(branch, first.place - BESIDE, last.place + BESIDE)
            if told is None or not _is_fold(branch, first.place, last.place):
                continue
            pair = tuple(next((one for one in loci if leads_through(one, point)), None) for point in (first, last))
            if None not in pair and not any(one[:2] == pair for one in found):
                found.append((*pair, told))
    return found


def _labels(branch, before, after):
    """What the motions at two stable points are called, None where one is not stable, or no point of the branch."""
    if before < 0 or after >= len(branch) or not (branch.stable[before] and branch.stable[after]):
        return None
    called = [next(part.label for part in branch.segments if part.first <= k <= part.last) for k in (before, after)]
    return " and ".join(dict.fromkeys(called))


def _is_fold(branch, first, last):
    """Whether a branch is unstable from one point to another, and comes to both from the same side of the parameter."""
    values = branch.values
    ways = (values[first] - values[first - BESIDE]) * (values[last] - values[last + BESIDE]) < 0
    return bool(ways and last - first > 1 and not branch.stable[first + 1 : last].any())
