"""Which loci leave a point of codimension two, and where each of them begins.

- RG: with the touch as an impact of speed s, the orbit's equations leave g = mu + phi s + kappa s^2 / 2 = 0; mu is zero
  on the GR, phi at the RG. They are singular at s = -phi / kappa (SN), and so, for the orbit gone through twice, with
  another kappa (PD; SB of a symmetric orbit): curves that are regular in s and quadratically tangent to the GR, of
  which s > 0 is real (Simpson and Ghosh, arXiv 2602.22797).
- GPD, DSB: the two halves of the orbit differ by s along the null vector, and nu + c s^2 + d s^4 = 0, c being zero at
  the point. nu is zero on the PD or SB, and the pair folds where nu = c^2 / 4 d: one SN, quadratically tangent. The
  multipliers of the pair are near 1 and det M^2 < 1, so nothing else of it is near.
- SN, PD, SB on a GR: an orbit that leaves the touch out is singular. It is on the locus of its kind where the touch
  comes free, and the other orbits of that point, the second one of the SN, the pair of the PD or SB, touch the wall
  along a curve that is quadratically tangent to that locus (Colombo and Dercole, SIAM J. Appl. Dyn. Syst. 9, 62, 2010):
  at SN it is the GR itself, to either side of the point, else another GR.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from continuation import branch_switching as crossing
from continuation import event_search, locate
from continuation.points import start_point
from continuation.rows import by_field
from continuation.stretch import Mark

from ..problem.diagnostics import diagnose
from ..problem.end import End
from ..problem.equations import problem
from ..problem.grazing import SINGULAR
from ..problem.orbit_on_branch import OrbitPoint
from ..problem.soft_grazing import is_smooth
from ..problem.touches import admissible
from ..scene import check
from .corner import outsets, track_on
from .first_point import LocusStart, backward, equations, is_half, settings, ways, weighed
from .track import LocusWay, track

ASIDE = (0.1, 0.05, 0.02, 0.01, 0.005)  # lengths along the null vector after which a pair's SN is begun
SHARES = (1.0, 0.1, 0.01)  # of the first step: after which another locus is begun
APART = 1e-4  # of the same: the points of a difference


class Outset(NamedTuple):
    """Where a locus begins that leaves a point. start; mark: of the point, as this locus calls it; on, back: ways, the
    latter None where it begins in the point; point: z of the point where the way begins a little on, else None."""

    start: LocusStart
    mark: Mark
    on: LocusWay
    back: LocusWay | None = None
    point: Float[np.ndarray, " unknowns"] | None = None


def outsets_of(point, bounds, *steps):
    """The `Outset`s of the loci that leave a `Codim2` besides that on which it was found. Raises ArgumentError."""
    given = tuple(point.values), bounds, *steps
    if point.kind in ("GPD", "DSB"):
        return [_folding(point, *given)]
    touched = LocusStart("GR", *_place(point)).touches
    own = [one for one in touched if one.own]
    if point.on == "GR":
        found, resonant, kind = [], point.kind == "RG", point.kind
    else:
        found, resonant, kind = [], any(not is_smooth(point.scene, one.side) for one in own), point.on
        found.append(_grazing(point, "RG" if resonant else kind, *given))
    if resonant:
        half = is_half(LocusStart("SN", *_place(point)), given[0])
        kinds = (kind for kind in ("SN", "SB" if half else "PD") if kind != point.on)
        return found + [_opening(point, kind, point.spot, *given) for kind in kinds]
    if point.on == "GR":
        bare = _without(point.spot, [one.row for one in own])
        found.append(_opening(point, kind, bare, *given))
    return found if kind == "SN" else [*found, _touching(point, kind, *given)]


def _place(point, spot=None):
    """What a `LocusStart` has besides its kind."""
    return next(iter(point.values)), point.scene, spot or point.spot


def _without(spot, rows):
    """An `OrbitPoint` without some of its impacts, those of no speed."""
    kept = np.delete(np.arange(len(spot.times)), rows)
    return spot._replace(times=spot.times[kept], speeds=spot.speeds[kept], sides=spot.sides[kept])


def _grazing(point, kind, names, bounds, *steps):
    """The GR through a point where a locus of another kind ends; kind: of the point, on the GR."""
    start = LocusStart("GR", *_place(point))
    return Outset(start, _mark(point, kind), *outsets(start, names, bounds, *steps))


def _mark(point, kind):
    return Mark(0, kind, point.residual)


def _opening(point, kind, spot, names, bounds, *steps):
    """The locus of a kind along which the touches of a point come free, or get a speed; spot: its orbit."""
    start = LocusStart(kind, *_place(point, spot))
    (way,) = ways(start, names, bounds, *steps)
    return _outset(start, _mark(point, "GR"), _free(way))


def _free(way):
    found = [one for one in (way, backward(way)) if one.is_free]
    if len(found) != 1:
        rule = "must be a point that a locus leaves one way; here other touches come in both ways, or in none"
        raise check.ArgumentError("special", rule, len(found))
    return found[0]


def _pair(point, kind, spot):
    """The `OrbitPoint` of an orbit whose two halves may become different."""
    if kind == "SB":
        return spot
    late = spot.periods * 2.0 * np.pi / float(point.scene.frequency)
    twice = (np.tile(each, 2) for each in (spot.speeds, spot.sides))
    return OrbitPoint(
        spot.value, np.append(spot.times, spot.times + late), *twice, 2 * spot.periods, spot.x, spot.v, spot.residual
    )


def _touching(point, kind, names, bounds, *steps):
    """The GR of the pair that leaves a PD or SB on a grazing: of two curves of its equations that which is not the GR
    of the point's own orbit, its two halves becoming different."""
    start = LocusStart("GR", *_place(point, _pair(point, kind, point.spot)))
    curve, z = equations(start, names, whole=True)[0]
    asked = weighed(curve, z, settings(point.scene, names, bounds, *steps))
    scale, rows = asked.control.scale, len(curve.cycle.sides)
    try:
        both = crossing.directions(problem(curve), z, scale, curve)
    except ValueError:
        raise check.ArgumentError("special", "must be one at which loci of GR cross; here none do", kind) from None
    speeds = both[:, rows + curve.hits]
    apart = abs(speeds - np.roll(speeds, len(curve.hits) // 2, axis=1)).max(axis=1)
    return _outset(start, _mark(point, kind), _free(LocusWay(curve, start_point(z, both[np.argmax(apart)]), asked)))


def _folding(point, names, bounds, *steps):
    """The SN of the pair that leaves a GPD or DSB."""
    spot = _pair(point, {"GPD": "PD", "DSB": "SB"}[point.kind], point.spot)
    start = LocusStart("SN", *_place(point, spot))
    ((curve, z),) = equations(start, names, whole=True)
    asked = weighed(curve, z, settings(point.scene, names, bounds, *steps))
    for near in _aside(curve, z, asked.control):
        if _is_good(curve, near, asked):
            way = LocusWay(curve, start_point(near.z, near.tangent), asked)
            return Outset(start, _mark(point, point.kind), way, point=z)
    raise check.ArgumentError("special", "must be a point beside which an SN of the pair is found", point.kind)


def _is_good(curve, near, asked):
    """Whether a `Point` is one of a locus, within its bounds."""
    inside = all(low <= value <= high for value, (low, high) in zip(near.z[-2:], asked.box, strict=True))
    return bool(near.met and inside and admissible(curve, near.z, diagnose(curve, near.z[None]))[0])


def _outset(start, mark, way):
    """The `Outset` of a way from a point. It begins a little on if it can: in the point itself the determinant of its
    equations may have no sign, as an impact has no speed or another curve crosses, and a step from there is taken for a
    jump."""
    curve, asked = way.curve, way.asked
    for share in SHARES:
        near = event_search.step(problem(curve), way.start, share * asked.first, asked.control, curve)
        if _is_good(curve, near, asked):
            beside = LocusWay(curve, start_point(near.z, near.tangent), asked)
            return Outset(start, mark, beside, point=way.start.z)
    return Outset(start, mark, way)


def _aside(curve, z, control):
    """`Point`s of the SN of a pair, a little along the null vector v of its equations: Newton's method from the pair to
    second order, u + s v + s^2 h at the point's parameters. Its matrix is as small there as s^3, its error as s^5."""
    free = 2 * len(curve.cycle.sides)
    scale = control.scale[:free]
    slopes = locate.slopes_of(problem(curve), z, curve)[:free, :free]
    v = locate.null(slopes)
    v = v / np.linalg.norm(scale * v)
    v = v * np.sign(v[np.flatnonzero(abs(v) > 0.5 * abs(v).max())[0]])
    along = np.append(v, [0.0, 0.0])
    ends = locate.slopes_at(problem(curve), z + APART * np.stack([along, -along]), curve)[:, :free, :free]
    bend = np.linalg.lstsq(slopes, -0.25 / APART * (ends[0] - ends[1]) @ v, SINGULAR)[0]
    for size in ASIDE:
        guess = z + size * along + size**2 * np.append(bend, [0.0, 0.0])
        yield event_search.step(problem(curve), start_point(guess, along), 0.0, control, curve)


def tracked(outset, steps):
    """What `locus_of` takes of an `Outset`: (its start, what was tracked on, and back)."""
    one = track(outset.on) if outset.point is None else _from(outset)
    ahead = track_on(outset.start, outset.on, steps, one._replace(marks=(outset.mark, *one.marks)))
    closes = outset.back is None or ahead[0][1].end is End.CLOSED
    return outset.start, ahead, () if closes else track_on(outset.start, outset.back, steps)


def _from(outset):
    """The `Stretch` of a way that begins a little on from its point, with that."""
    one, z = track(outset.on), outset.point
    length = np.linalg.norm(outset.on.asked.control.scale * (one.points.z[0] - z))
    first = start_point(z, (one.points.z[0] - z) / length)
    points = by_field(lambda leaf, new: np.concatenate([np.asarray(new)[None], leaf]), one.points, first)
    points.step[1] = length
    view = by_field(lambda leaf, new: np.concatenate([new, leaf]), one.view, diagnose(one.args, z[None]))
    return one._replace(
        points=points, view=view, marks=tuple(each._replace(place=each.place + 1) for each in one.marks)
    )
