"""Invariant manifolds of a saddle on Sigma: the curves that come from it, and those that lead into it."""

import numpy as np
import xarray as xr
from jaxtyping import ArrayLike, Real

from continuation.limits import limits_of, partial_reason

from ..maps.initial_conditions import box
from ..maps.inverse import require_reversible
from ..maps.monodromy import monodromy
from ..maps.phase_shift import shift_phase
from ..orbits.orbit import Orbit
from ..output.units import LENGTH, SPEED, scales_in
from ..scene import check
from ..scene.scene import free_between
from ..scene.state import State
from .global_manifold import Rules, gaps, levels
from .local_manifold import germ, mapped

KINDS = ("stable", "unstable")
SAME = 1e-6  # of the scene's size: two points as near are one, and a point as near to a wall is on it


@check.host("use strobe or monodromy")
def manifold(
    orbit: Orbit,
    kind: str,
    length: Real[ArrayLike, ""] = 20.0,
    phase: Real[ArrayLike, ""] | None = None,
    spacing: Real[ArrayLike, ""] = 0.01,
    angle: Real[ArrayLike, ""] = 0.05,
    fastest: Real[ArrayLike, ""] | None = None,
    most: int = 200_000,
    *,
    max_seconds: float | None = None,
) -> xr.Dataset:
    """The stable or the unstable manifold of a saddle on Sigma, both sides of each of its points: an xarray.Dataset.

    orbit: an `Orbit` with one multiplier inside the unit circle and one outside. kind: "stable" (what leads into it) or
    "unstable" (what comes from it). length: of the curve on each side of each point. phase: of Sigma, rad; None takes
    the orbit's. spacing, angle: neighbours are no further apart, and between them the curve turns no more (rad); beyond
    the speed of `initial_conditions.box` spacing grows with the speed. fastest: the speed beyond which the curve is
    left out; None takes twice that of the box. most: points of a side. max_seconds: wall-clock time, s, after which no
    further image of a piece is computed: each side then has its first piece at least, and the attribute `stopped` says
    how many sides are done; None is no limit.

    Dataset over "point": x, v; arc: length of the curve from the saddle on; side (-1, 1), origin (which of the orbit's
    points, in order), image (how often the map, or its inverse, was applied to the piece at the saddle, which has 0),
    piece. Over "piece_end", for each piece: began and ended, each "saddle"; "section": an impact on a rigid wall at the
    section's phase, the curve goes on from its wall with the speed after or before it; "grazing": a corner, where an
    impact comes or goes, of a soft wall also by being entered or left at the section's phase, the last point of one
    piece and the first of the next; "fast": what is faster is left out; "resolution": the curve is stretched more than
    rounding allows; "attractor": it ends there; "length"; "points"; "max_seconds".
    Attributes: the scene's numbers, phase, kind, label and multiplier.

    Past a soft wall the curve's points are within it. The stable manifold is grown by the certified map with time
    reversed (`backward`). A wall without restitution, and a soft one from critical damping on, has no way back.

    Raises ArgumentError for what is no saddle and for arguments that cannot be.
    """
    limits = limits_of(None, max_seconds, None, check.ArgumentError)
    if not isinstance(orbit, Orbit):
        raise check.ArgumentError("orbit", "must be an Orbit", orbit)
    if kind not in KINDS:
        raise check.ArgumentError("kind", f"must be one of {', '.join(KINDS)}", kind)
    scene, back = orbit.scene, kind == "stable"
    size, rules = _rules(scene, length, spacing, angle, fastest, check.whole("most", most, 100))
    rate, turn = _rate(orbit, kind), orbit.periods
    if back:
        require_reversible(scene)
    phase = float(check.number("phase", orbit.state.phase if phase is None else phase, np.float64))
    strands = []
    for origin, (saddle, heading) in enumerate(_saddles(orbit, phase, back)):
        start = germ(scene, saddle, heading, rate, turn, phase, back, size)
        for side in (-1, 1):
            found, reason = levels(scene, start, side, np.sign(rate), turn, phase, back, size, rules, limits)
            strands.append(_strand(scene, phase, saddle, found, reason, size, rules) | {"side": side, "origin": origin})
    numbers = {"phase": phase, "kind": kind, "label": orbit.label}
    count = sum(one["ended"][-1] != "max_seconds" for one in strands)
    numbers |= {} if count == len(strands) else {"stopped": partial_reason(count, len(strands), "sides")}
    return _dataset(scene, strands, numbers | {"multiplier": float(_multiplier(orbit, kind))})


def _rules(scene, length, spacing, angle, fastest, most):
    left, right, fast = box(scene)
    fastest = 2.0 * fast if fastest is None else fastest
    given = {"length": length, "spacing": spacing, "angle": angle, "fastest": fastest}
    numbers = {key: float(check.number(key, value, np.float64)) for key, value in given.items()}
    for key, value in numbers.items():
        if not value > 0:
            raise check.ArgumentError(key, "must be greater than 0", value)
    size = max(abs(float(left)), abs(float(right)))
    return size, Rules(least=1e-3 * numbers["spacing"], usual=float(fast), most=most, **numbers)


def _multiplier(orbit, kind):
    larger, smaller = sorted(orbit.multipliers, key=abs, reverse=True)
    if larger.imag or not abs(larger) > 1 > abs(smaller):
        raise check.ArgumentError(
            "orbit", "must be a saddle: one multiplier inside the unit circle, one outside", orbit
        )
    return (smaller if kind == "stable" else larger).real


def _rate(orbit, kind):
    """How much a piece is stretched on the orbit's way round, or on the way back; negative where it changes sides."""
    one = _multiplier(orbit, kind)
    if one == 0:
        raise check.ArgumentError("orbit", "must have no multiplier 0 to have a stable manifold of curves", orbit)
    return one if kind == "unstable" else 1.0 / one


def _saddles(orbit, phase, back):
    """(point, eigenvector) of each of the orbit's points on Sigma at a phase."""
    scene, state = orbit.scene, orbit.state
    lanes = State(*(np.full(1, float(each), scene.dtype) for each in (state.x, state.v, state.phase, state.contact)))
    here, _ = shift_phase(scene, lanes, phase)
    point = np.array([[here.x[0], here.v[0]]], float)
    for _ in range(orbit.periods):
        matrix = np.asarray(monodromy(scene, State(*point[0], phase), orbit.periods), float)
        if not np.isfinite(matrix).all():
            raise check.ArgumentError("phase", "must not be that of an impact or a rest", phase)
        values, vectors = np.linalg.eig(matrix)
        chosen = np.argmin(abs(values)) if back else np.argmax(abs(values))
        heading = vectors[:, chosen].real
        yield point[0], heading * np.sign(heading[np.argmax(abs(heading))])
        point, _, _ = mapped(scene, point, phase, 1, False)


def _strand(scene, phase, saddle, found, end, size, rules):
    """One side of one point, from the saddle on: a dict of arrays over its points, and of its pieces' ends."""
    walls = [place for place in free_between(scene, phase) if np.isfinite(place)]
    z, good, image, why = [saddle[None]], [[True]], [[0]], [[""]]
    for k, level in enumerate(found):
        chosen, ends = _cornered(level, _breaks(level, walls, size, rules))
        later = chosen[min(k, 1) :]  # the first point of a level is the last of the one before
        z.append(level.z[later])
        good.append(level.good[later])
        image.append(np.full(len(later), k))
        why.append(ends if k else np.append("", ends))
    z, good, image, why = map(np.concatenate, (z, good, image, why))
    piece = np.cumsum(why != "")[good]
    first = np.flatnonzero(np.append(True, np.diff(piece) != 0))
    began = why[np.flatnonzero(good)[first]]
    after = np.append(why, end)[np.flatnonzero(good)[np.append(first[1:], len(piece)) - 1] + 1]
    began[0], after[-1] = "saddle", end
    z, piece = z[good], np.repeat(np.arange(len(first)), np.diff(np.append(first, len(piece))))
    step = np.where(np.append(True, np.diff(piece) != 0), 0.0, np.hypot(*np.diff(z, axis=0, prepend=z[:1]).T))
    return {"z": z, "image": image[good], "piece": piece, "arc": np.cumsum(step), "began": began, "ended": after}


def _breaks(level, walls, size, rules):
    """Of each pair of neighbours why they are not joined, "" where they are."""
    over, joined, _ = gaps(level, size, rules)
    good = level.good[:-1] & level.good[1:]
    with np.errstate(invalid="ignore"):
        beside = [(abs(level.z[:, 0] - wall) <= SAME * size) for wall in walls]
    section = np.any([each[:-1] & each[1:] for each in beside], axis=0)
    changed = np.diff(level.count) != 0
    why = np.where(changed & (over <= 1.0), "grazing", "resolution")
    why = np.where(changed & section, "section", why)
    return np.where(joined, "", np.where(good, why, "fast"))


def _cornered(level, why):
    """(places of the points, why neighbours among them are not joined): a corner belongs to both of its pieces.

    It is the neighbour with fewer impacts. That is as near to it as the parameter tells, the other only to the root of
    this (a grazing impact's speed), and the curve between them is as straight as it is short.
    """
    before = np.flatnonzero(why == "grazing")
    corner = before + (level.count[before] > level.count[before + 1])
    chosen = np.sort(np.append(np.arange(len(level.u)), corner))
    apart = np.where(why == "grazing", "", why)[np.minimum(chosen[:-1], len(why) - 1)]
    return chosen, np.where(chosen[:-1] == chosen[1:], "grazing", apart)


def _dataset(scene, strands, attrs):
    """The strands behind each other, their pieces numbered through."""
    length, speed = {"units": LENGTH}, {"units": SPEED}
    first = np.cumsum([0, *(len(one["began"]) for one in strands)])
    sizes = [len(one["z"]) for one in strands]
    z, image, arc = (np.concatenate([one[key] for one in strands]) for key in ("z", "image", "arc"))
    piece = np.concatenate([one["piece"] + start for one, start in zip(strands, first, strict=False)])
    side, origin = (np.repeat([one[key] for one in strands], sizes) for key in ("side", "origin"))
    return xr.Dataset(
        {
            "x": ("point", z[:, 0], {"long_name": "displacement", **length}),
            "v": ("point", z[:, 1], {"long_name": "velocity", **speed}),
            "arc": ("point", arc, {"long_name": "length of the curve from the saddle on"}),
            "image": ("point", image, {"long_name": "times that the map was applied"}),
            "piece": ("point", piece),
            "side": ("point", side),
            "origin": ("point", origin),
            "began": ("piece_end", np.concatenate([one["began"] for one in strands])),
            "ended": ("piece_end", np.concatenate([one["ended"] for one in strands])),
        },
        attrs=scene.numbers | scales_in(scene) | attrs,
    )
