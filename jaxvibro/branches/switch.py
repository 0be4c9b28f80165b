"""`switch`: the other branches that leave a special point; `extend`: a branch beyond its end."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from continuation import branch_switching as crossing
from continuation import locate
from continuation.event_search import tangent
from continuation.limits import UNLIMITED, Limits, limits_of
from continuation.points import start_point

from ..problem.end import LIMITS, End, Reason
from ..problem.equations import problem
from ..problem.grazing import padded
from ..problem.orbit_on_branch import place_orbit
from ..problem.orbit_rows import row_of, spot_of
from ..problem.soft_grazing import exits
from ..problem.touches import scales
from ..scene import check
from ..scene.parameters import bounds_of, domain
from ..scene.scale import scene_length
from .assemble import START, assemble, merge
from .branch import Branch, Special
from .follow import Monitors, asking, check_settings
from .through_grazings import go_on

FIRST = 0.01  # step of a branch that leaves a point
KINDS = ("SB", "BP", "PD", "GR")


@check.host("use strobe or monodromy")
def switch(
    special: Special,
    bounds: tuple[float, float] | None = None,
    first_step: float = FIRST,
    largest_step: float = 0.1,
    tolerance: float = 1e-10,
    monitors: Monitors = (),
    stop: str | Sequence[str] = (),
    limits: Limits = UNLIMITED,
) -> tuple[Branch, ...]:
    """The branches that leave a `Special` of a branch, as the `switch` of `loci.switch` tells of it: a tuple of
    `Branch`. Raises ArgumentError for a point of another kind, and arguments that cannot be."""
    if not isinstance(special, Special):
        raise check.ArgumentError("special", "must be a special point of a branch", special)
    if special.kind not in KINDS:
        raise check.ArgumentError(
            "special", f"must be of kind {', '.join(KINDS)}: no branch leaves others", special.kind
        )
    bounds = bounds_of(special.scene, special.name, special.bounds if bounds is None else bounds)
    settings = check_settings(first_step, largest_step, tolerance, monitors, stop) | {"limits": limits}
    return tuple(branch_from(special, start, bounds, **settings) for start in starts(special))


def starts(special):
    """(`OrbitEquations`, `Point`) at the start of each branch that leaves a special point of one of the `KINDS`.

    Raises ValueError where the equations say that none cross there.
    """
    leaving = {"PD": _doubled, "GR": _grazing}.get(special.kind, _crossed)
    return leaving(special, *place_orbit(special.scene, special.name, special.spot))


def branch_from(special, start, bounds, **settings):
    """The `Branch` that leaves a special point by one of its `starts`."""
    (along, begun), scene = start, special.scene
    asked = asking(scene, special.name, bounds, scene_length(scene), (along, begun.z), **settings)
    start = End.LEFT.reason(special.value, special.kind)
    return assemble(scene, special.name, bounds, settings, None, go_on(along, begun, asked), start)


@check.host("use strobe or monodromy")
def extend(
    branch: Branch,
    bounds: tuple[float, float],
    *,
    max_points: int | None = None,
    max_seconds: float | None = None,
    progress: Callable[[int], object] | None = None,
) -> Branch:
    """The branch with wider bounds, followed on from each end that had come to its bound, or to a limit of its points
    or its time: a `Branch`.

    max_points, max_seconds, progress: as in `follow`; max_points counts the points that are added.

    Raises ArgumentError where the new bounds do not hold the old ones.
    """
    if not isinstance(branch, Branch):
        raise check.ArgumentError("branch", "must be a Branch", branch)
    limits = limits_of(max_points, max_seconds, progress, check.ArgumentError)
    wide = bounds_of(branch.scene, branch.name, bounds)
    if not (wide[0] <= branch.bounds[0] and branch.bounds[1] <= wide[1]):
        raise check.ArgumentError("bounds", f"must hold the branch's own, {branch.bounds}", bounds)
    for end in (0, -1):
        value = branch.values[end]
        if branch.ends[end] not in LIMITS and (branch.ends[end] is not End.BOUND or value in wide):
            continue
        if value in domain(branch.scene, branch.name):
            branch = _ending(branch, end, End.DOMAIN.reason(value))
            continue
        if limits.reached(1):
            reason = (End.MAX_SECONDS if limits.expired else End.MAX_POINTS).reason(value)
            branch = _ending(branch, end, reason)
            continue
        more = _onwards(branch, end, wide, limits)
        limits = limits.after(len(more) - 1)
        closes = more.ends[end] is End.CLOSED
        if len(more) > 1:
            branch = merge(branch, more) if end else merge(more, branch)
        branch = _ending(branch, end, Reason(more.ends[end], more.reasons[end]))
        if closes:  # it came to the other end
            return _within(_ending(branch, -1 - end, START), wide)
    return _within(branch, wide)


def _ending(branch, end, reason):
    """The branch with the `Reason` of one of its ends, 0 or -1."""
    ends, reasons = list(branch.ends), list(branch.reasons)
    ends[end], reasons[end] = reason
    return replace(branch, ends=tuple(ends), reasons=tuple(reasons))


def _within(branch, bounds):
    """The branch as one within these bounds."""
    return replace(branch, bounds=bounds, special=tuple(replace(one, bounds=bounds) for one in branch.special))


def _onwards(branch, end, bounds, limits):
    """The branch beyond one of its ends, 0 or -1, from there on, or, at its first point, up to there. It closes where
    it comes to the other end."""
    row, sign = row_of(branch.data, end), 1.0 if end else -1.0
    spot = spot_of(row, branch.name)
    scene = branch.scene.replace(**{branch.name: spot.value})
    along, z = place_orbit(scene, branch.name, spot)
    other = place_orbit(scene, branch.name, spot_of(row_of(branch.data, -1 - end), branch.name))
    count, rows = len(spot.times), len(along.cycle.sides)
    ahead = np.zeros(len(z))
    hit = row["side"] != 0
    if rows:
        ahead[:count], ahead[rows : rows + count] = row["time_slope"][hit], row["speed_slope"][hit]
    ahead[-1] = row["value_slope"]
    start = start_point(z, tangent(problem(along), z, scales(along, scene_length(scene)), along, sign * ahead))
    asked = asking(scene, branch.name, bounds, scene_length(scene), other, **branch.settings, limits=limits)
    done = go_on(along, start, asked)
    back, on = (done, None) if sign < 0 else (None, done)
    return replace(assemble(scene, branch.name, bounds, branch.settings, back, on), scene=branch.scene)


def _crossed(special, along, z):
    """Both directions of the branch that crosses that on which the point was found."""
    scale, rows = scales(along, scene_length(special.scene)), len(along.cycle.sides)
    count, known = len(special.spot.times), np.zeros(len(z))
    known[:count], known[rows : rows + count] = special.slopes[:count], special.slopes[count:-1]
    known[-1] = special.slopes[-1]
    both = crossing.directions(problem(along), z, scale, along)
    if special.kind == "SB":  # one branch's halves are mirror images of each other, at the same values
        both[np.argmin(abs(both[:, -1])), -1] = 0.0
    other = crossing.other(both, known, scale)
    first = np.flatnonzero(abs(other) > 0.5 * abs(other).max())[0]  # a null vector has no sign of its own
    return [(along, start_point(z, sign * np.sign(other[first]) * other)) for sign in (1.0, -1.0)]


def _doubled(special, along, z):
    """The orbit as one of twice the period, and the direction in which its two halves become different."""
    task, rows, count = problem(along), len(along.cycle.sides), len(special.spot.times)
    null = locate.null(locate.matrices(task, task.tests[0], z, along)[0])
    spot, span = special.spot, special.spot.periods * 2.0 * np.pi / float(special.scene.frequency)
    late = np.concatenate([spot.times, spot.times + span])
    twice = along._replace(cycle=along.cycle._replace(periods=np.asarray(2.0 * spot.periods)))
    if not count:  # of z = (x, v, the parameter)
        tangent = np.append(null, 0.0)
        return [(twice, start_point(z, tangent / np.linalg.norm(scales(twice, scene_length(special.scene)) * tangent)))]
    listed = zip(late, np.tile(spot.speeds, 2), np.tile(spot.sides, 2), strict=True)
    twice = twice._replace(cycle=padded(twice, list(listed)))
    wide = len(twice.cycle.sides)
    tangent = np.zeros(2 * wide + 1)
    for half in (0, 1):
        part = null[half * rows : half * rows + count]
        tangent[half * wide : half * wide + 2 * count] = np.concatenate([part, -part])
    tangent /= np.linalg.norm(scales(twice, scene_length(special.scene)) * tangent)
    start = np.concatenate([twice.cycle.times, twice.cycle.speeds, z[-1:]])
    return [(twice, start_point(start, tangent))]


def _grazing(special, along, z):
    """Each branch that leaves a grazing and is not one that the point was found on."""
    _, ways, _ = exits(along, z, scene_length(special.scene))
    if len(ways) != len(special.aside):
        raise check.ArgumentError(
            "special", "must be a grazing that this version finds alike: follow its branch anew", special
        )
    return [(way.along, way.point) for way, aside in zip(ways, special.aside, strict=True) if aside]
