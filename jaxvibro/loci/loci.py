"""The loci of all special points of branches, each once: `loci`; whether a point lies on a locus; mirror images."""

import numpy as np

from continuation.limits import EXPIRED, limits_of

from ..branches.branch import labels_of
from ..maps.itinerary import LETTERS, label, mirrored, same
from ..problem.touches import TOUCH
from ..scene.check import ArgumentError, sequence
from .first_point import KINDS
from .locus import locus

NEAR = 1e-6  # of a parameter's range: a point as near to a locus is on it
NODES = 4  # of its points on each side, through which a locus is interpolated


def loci(branches, names, bounds, kinds=KINDS, largest_step=0.1, progress=None, max_seconds=None):
    """(the `Locus` of each special point of branches, (special point, why) of those that cannot be followed), tuples.

    branches: of one scene; names, bounds, largest_step: as in `locus`; kinds: of the points. Left out are points
    outside the bounds, and those that a locus found before leads through. progress: called with the points so far.
    max_seconds: wall-clock time, s, after which the points that are left are not followed; None is no limit.
    """
    limits = limits_of(None, max_seconds, None, ArgumentError)
    found, refused = [], []
    kinds = sequence("kinds", kinds)
    begun = [one for branch in branches for one in branch.special if one.kind in kinds and _is_within(one, bounds)]
    for count, one in enumerate(begun, 1):
        if limits.expired:
            refused.append((one, EXPIRED))
        elif not any(leads_through(other, one) for other in found):
            try:
                found.append(locus(one, names, bounds, largest_step=largest_step, max_seconds=limits.remaining))
            except ArgumentError as error:
                refused.append((one, error.rule))
        if progress is not None:
            progress(count)
    return tuple(found), tuple(refused)


def count(branches, bounds, kinds=KINDS):
    """How many special points `loci` looks at."""
    kinds = sequence("kinds", kinds)
    return sum(one.kind in kinds and _is_within(one, bounds) for branch in branches for one in branch.special)


def _is_within(special, bounds):
    return all(low <= float(special.scene.parameter(name)) <= high for name, (low, high) in bounds.items())


def leads_through(one, special):
    """Whether a locus leads through a special point of a branch."""
    if one.kind != special.kind or one.label not in _labels(special):
        return False
    return is_on(one, [float(special.scene.parameter(name)) for name in one.names])


def _labels(special):
    """The labels that a special point's locus may have: at a grazing it counts the impacts that come in, and may be
    that of one touch alone."""
    if special.kind != "GR":
        return {special.label}
    found = {special.label, *(each.rstrip("<>") for each in labels_of(special))}
    alone = {label(("",) * (special.spot.periods - 1) + (letter,)) for letter in LETTERS.values()}
    return found | (set() if (special.spot.speeds > TOUCH).any() else alone)


def is_on(one, values):
    """Whether two values of its parameters are a point of a `Locus`, to a millionth of its bounds' widths.

    Between its points the locus is a polynomial through the nearest of them; where these are too far apart to tell as
    exactly, it is what they tell.
    """
    low, high = np.array([one.bounds[name] for name in one.names]).T
    curve, point = (one.values - low) / (high - low), (np.asarray(values, float) - low) / (high - low)
    begin, along = curve[:-1], np.diff(curve, axis=0)
    lengths = np.maximum(np.sum(along**2, axis=1), np.finfo(float).tiny)
    shares = np.clip(np.sum((point - begin) * along, axis=1) / lengths, 0.0, 1.0)
    gaps = np.linalg.norm(begin + shares[:, None] * along - point, axis=1)
    place = int(np.argmin(gaps))
    beyond = (place == 0 and shares[0] == 0.0) or (place == len(shares) - 1 and shares[-1] == 1.0)
    if gaps[place] <= NEAR or beyond or gaps[place] > np.sqrt(lengths[place]):
        return bool(gaps[place] <= NEAR)
    gap, doubt = min((_beside(curve, place, axis, point) for axis in (0, 1)), key=lambda one: one[1])
    return bool(gap <= NEAR + 2.0 * doubt)


def _beside(curve, place, axis, point):
    """(how far a point is from a curve near a piece of it, along the other axis; how well that is known)."""
    nodes = _monotone(curve[:, axis], place)
    if len(nodes) < 2:
        return np.inf, np.inf
    fine, coarse = (_through(curve[some], axis, point[axis]) for some in (nodes, _nearer(nodes, place)))
    return abs(fine - point[1 - axis]), abs(fine - coarse)


def _monotone(values, place):
    """The places of a few neighbours of a piece, as far as values go on in one direction."""
    way = np.sign(values[place + 1] - values[place])
    if not way:
        return np.arange(0)
    first, last = place, place + 1
    while first > 0 and place - first < NODES and (values[first] - values[first - 1]) * way > 0:
        first -= 1
    while last < len(values) - 1 and last - place < NODES and (values[last + 1] - values[last]) * way > 0:
        last += 1
    return np.arange(first, last + 1)


def _nearer(nodes, place):
    """The nodes but for the one farthest from a piece."""
    if len(nodes) == 2:
        return nodes[:1]
    return nodes[1:] if place - nodes[0] > nodes[-1] - place - 1 else nodes[:-1]


def _through(nodes, axis, at):
    """The value of Lagrange's polynomial through nodes, of the one coordinate by the other."""
    knots = nodes[:, axis]
    apart = knots[:, None] - knots
    np.fill_diagonal(apart, 1.0)
    ratio = (at - knots)[None, :] / apart
    np.fill_diagonal(ratio, 1.0)
    return float(nodes[:, 1 - axis] @ np.prod(ratio, axis=1))


def image(one, others):
    """The first of other `Locus` that is the mirror image of one, on the same curve, or None."""
    (walls, *_), middle = (each.itinerary for each in one.special), one.values[len(one) // 2]
    for other in others:
        turned = other.kind == one.kind and other.names == one.names and other is not one
        if turned and same(mirrored(walls), other.special[0].itinerary) and is_on(other, middle):
            return other
    return None
