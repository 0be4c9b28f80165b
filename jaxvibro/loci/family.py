"""`family`: the loci of a special point for values of a third parameter, tracked together."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import ArrayLike, Real

from continuation.limits import EXPIRED, Results, limits_of, partial_reason
from continuation.points import to_value

from ..branches.branch import Special
from ..problem.end import End
from ..problem.orbit_on_branch import OrbitPoint
from ..scene import check
from ..scene.parameters import values_of
from ..scene.symmetry import stays_symmetric
from .corner import outsets, track_on
from .first_point import KINDS, RESTS, LocusStart, impacts_of, named, start_of
from .locus import Locus, locus_of
from .track import together


@check.host("use strobe or monodromy")
def family(
    special: Special,
    names: Sequence[str],
    bounds: Mapping[str, tuple[float, float]],
    third: str,
    values: Real[ArrayLike, " values"] | Sequence[float],
    first_step: float = 0.02,
    largest_step: float = 0.1,
    tolerance: float = 1e-12,
    *,
    max_points: int | None = None,
    max_seconds: float | None = None,
) -> Results[Locus | None]:
    """The loci of a special point for values of a third parameter: a tuple, for each value a `Locus` or None.

    special, names, bounds, first_step, largest_step, tolerance: as in `locus`; third: a parameter of the scene other
    than these two; values: of it, a row of one at least, in any order.

    The point is carried to each value along its locus in one of names (that of its branch, or the first) and third,
    the other one fixed; where that passes the value more than once, the first time along it counts. None stands where
    it does not come to the value: it ends before, at a bound, a grazing or where the point exists no more. The loci
    of all values are then tracked as lanes of one compiled call; each is that which `locus` gives from its point.

    max_points, max_seconds: as in `locus`; max_points holds for each locus, half of it each way, max_seconds for all of
    them. The
    `reasons` of a locus say where the time was over, and the attribute `stopped` of the tuple, else "", says how many
    are done; None may then stand where the point was not carried to a value in time.

    Raises ArgumentError for points of other kinds and arguments that cannot be.
    """
    limits = limits_of(max_points, max_seconds, None, check.ArgumentError)
    start, steps = start_of(special, (*KINDS, *RESTS)), (first_step, largest_step, tolerance, limits)
    names, values = named(start.scene, names), values_of(start.scene, third, values)
    if third in names:
        raise check.ArgumentError("third", "must be none of names", third)
    if start.kind == "SB" and not stays_symmetric(start.scene, third):
        raise check.ArgumentError("third", "must keep the scene symmetric: an SB is no point of another", third)
    outsets(start, names, bounds, *steps)  # refuses what cannot be
    found = carried(start, names, bounds, third, values, *steps[:-1], replace(limits, points=None))
    late = limits.expired
    starts = [one for one in found if one is not None]
    ways = [_limited(outsets(one, names, bounds, *steps), limits) for one in starts]
    first = together([each for pair in ways for each in pair])
    both = zip(starts, ways, zip(first[::2], first[1::2], strict=True), strict=True)
    loci = iter([_locus(one, on, back, ahead, behind, steps) for one, (on, back), (ahead, behind) in both])
    curves = [None if one is None else next(loci) for one in found]
    count = sum(not late if one is None else not any(EXPIRED in each for each in one.reasons) for one in curves)
    return Results(curves, "" if count == len(curves) else partial_reason(count, len(curves), "values"))


def _limited(ways, limits):
    """The ways on and back, each with half of the points at most."""
    on, back = ways
    half = limits.halved()
    rest = None if limits.points is None else max(limits.points - half.points + 1, 1)
    return on.limited(half), back.limited(replace(limits, points=rest))


def _locus(start, on, back, ahead, behind, steps):
    """The `Locus` of ways on and back and what was tracked along each first."""
    closes = ahead.end is End.CLOSED
    return locus_of(start, track_on(start, on, steps, ahead), () if closes else track_on(start, back, steps, behind))


def carried(start, names, bounds, third, values, *steps):
    """The `first_point.LocusStart` at each value of a third parameter, None where a point's locus does not come to
    it."""
    free = start.name if start.name in names else names[0]
    own = float(start.scene.parameter(third))
    start = start._replace(scene=start.scene.replace(**{third: own}))  # a wall's restitution then is its own
    low, high = min(own, *values), max(own, *values)
    if low == high:
        return [start] * len(values)
    pair = outsets(start, (free, third), {free: bounds[free], third: (low, high)}, *steps)
    sides = [track_on(start, way, steps) for way in pair]
    return [start if value == own else _crossed(start, sides, (free, third), value) for value in values]


def _crossed(start, sides, pair, value):
    """The `first_point.LocusStart` where a locus both ways first has a value of its second parameter, None where it has
    not."""
    ahead = []
    for side in sides:
        past = 0.0
        for way, one in side:
            points = one.points
            late, level = past + np.cumsum(points.step), points.z[:, -1] - value
            for after in np.flatnonzero(level[:-1] * level[1:] <= 0):
                share = level[after] / ((level[after] - level[after + 1]) or 1.0)
                ahead.append((late[after] + share * points.step[after + 1], int(after), points, way))
            past = late[-1]
    for _, after, points, way in sorted(ahead, key=lambda one: one[0]):
        cut, there = to_value(way.task, points, after + 1, -1, value)
        if there:
            return _begun(start, way.curve, pair, cut.z[-1], float(cut.residual[-1]))
    return None


def _begun(start, curve, pair, z, residual):
    """The `first_point.LocusStart` at a point of a locus."""
    times, speeds, sides, periods = impacts_of(curve, z[None])
    scene = start.scene.replace(**dict(zip(pair, z[-2:].tolist(), strict=True)))
    spot = OrbitPoint(float(z[-2]), times[0], speeds[0], sides, periods, np.nan, np.nan, residual)
    return LocusStart(start.kind, pair[0], scene, spot)
