"""Basins of attraction: which attractor each start of a grid ends on."""

from collections.abc import Callable, Sequence

import numpy as np
import xarray as xr
from jaxtyping import ArrayLike, Float, Real

from continuation.limits import limits_of

from ..maps.initial_conditions import box
from ..output.units import LENGTH, SPEED, scales_in
from ..scene import check
from ..scene.scene import Scene
from ..stores.filling import Store, done
from .assign import OUTSIDE, homes
from .basins_study import BasinsStudy
from .find import Attractor, find_attractors
from .fractal import BOX, dimension, entropies

CHUNK = 1 << 16  # starts that are worked out together
PATIENCE = 2000  # drive periods after which a start is given up


@check.host("use strobe")
def basins(
    scene: Scene,
    x: Real[ArrayLike, " columns"] | Sequence[float],
    v: Real[ArrayLike, " rows"] | Sequence[float],
    phase: Real[ArrayLike, ""] = 0.0,
    attractors: Sequence[Attractor] | None = None,
    patience: int = PATIENCE,
    progress: Callable[[int], object] | None = None,
    store: Store | None = None,
    *,
    max_seconds: float | None = None,
) -> xr.Dataset:
    """The basins of attraction on Sigma: an xarray.Dataset.

    scene: a single one. x (columns,), v (rows,): positions and velocities of the starts, rising, at least two of each;
    past a soft wall a start is within it; phase: of the drive at the start, rad. attractors: a tuple as from
    `find_attractors`, which is asked where it is None; those that it calls unresolved take no starts. patience: drive
    periods that a start may take, a whole number from 1 on. progress: called with the number of starts that are done.
    store: a `Store` to keep labels and periods in and to go on with; None: in memory. max_seconds: wall-clock time, s,
    after which no chunk of starts is begun; None is no limit. The label of a start that is not done is -3, it
    counts as unresolved, and the attribute `stopped` says why; a later call with the same store goes on.

    Dataset: label(v, x): the attractor's place in the tuple, -1 where the start is not certain to be on any (many of
    them: another attractor, ask `find_attractors` with more starts), -2 beyond a rigid wall; periods(v, x): drive
    periods after which it was seen. Of each attractor, over the dimension "attractor": name (P n p q, "chaotic", ...),
    kind, mirror_of (place of its mirror image, -1: none), point_x and point_v on Sigma at the phase (nan where it has
    fewer), fraction: of the starts that are beyond no rigid wall, fraction_error: the spread between the four grids of
    every other row and column, and the unresolved share. mixed(side): the share of boxes, so many cells wide, with more
    than one label.
    Attributes: the scene's numbers; phase; basin_entropy and boundary_basin_entropy of boxes of 5 x 5 starts (Daza et
    al., Sci. Rep. 6, 31416, 2016); boundary_dimension and its error (`fractal.dimension`).

    A start is on a periodic attractor once it is in an ellipse that the return map takes into itself, tried on a fan of
    states (`trap`); on a chaotic one when it was near a sample of it at eight looks in a row, eight periods apart. An
    attractor with an impact on a rigid wall just at the section's phase has no such ellipse: take another phase.

    Raises ArgumentError for a batch of scenes and for numbers that cannot be, and what the store raises.
    """
    limits = limits_of(None, max_seconds, None, check.ArgumentError)
    check.require_single(scene)
    x, v = _axis("x", x), _axis("v", v)
    angle = check.number("phase", phase, np.float64)
    if angle.shape:
        raise check.ArgumentError("phase", "must be a number", angle)
    patience = check.whole("patience", patience, 1)
    attractors = find_attractors(scene) if attractors is None else tuple(attractors)
    left, right, fast = box(scene)
    found = homes(scene, attractors, float(angle), float(max(abs(left), abs(right), fast)))
    names = tuple(one.label for one in attractors)
    study = BasinsStudy(scene, x, v, float(angle), tuple(found), names, patience, CHUNK)
    seen = done(study, store, progress and (lambda one: progress(one.done)), limits)
    return _dataset(scene, float(angle), attractors, found, seen)


def _axis(key, values) -> Float[np.ndarray, " numbers"]:
    values = check.number(key, values, np.float64)
    if values.ndim != 1 or len(values) < 2 or not (np.diff(values) > 0).all():
        raise check.ArgumentError(key, "must be at least two numbers in rising order", values)
    return values


def _dataset(scene, phase, attractors, homes, seen):
    label, most = seen["label"].values, max((len(home.points) for home in homes), default=0)
    points = np.full((len(homes), most, 2), np.nan)
    for row, home in zip(points, homes, strict=True):
        row[: len(home.points)] = home.points
    fraction, error = _fractions(label, len(homes))
    size = dimension(label)
    entropy, at_boundary = entropies(label)
    mirrors = [-1 if one.mirror_of is None else one.mirror_of for one in attractors]
    return xr.Dataset(
        {
            "label": seen["label"],
            "periods": seen["periods"],
            "fraction": ("attractor", fraction, {"long_name": "share of the starts beyond no rigid wall"}),
            "fraction_error": ("attractor", error),
            "point_x": (("attractor", "point"), points[..., 0], {"units": LENGTH}),
            "point_v": (("attractor", "point"), points[..., 1], {"units": SPEED}),
            "mixed": ("side", size.mixed, {"long_name": "share of boxes with more than one label"}),
        },
        coords={
            "x": seen["x"],
            "v": seen["v"],
            "name": ("attractor", [one.label for one in attractors]),
            "kind": ("attractor", [one.kind for one in attractors]),
            "mirror_of": ("attractor", np.array(mirrors, int)),
            "side": ("side", size.sides, {"units": "cells"}),
        },
        attrs={
            **scene.numbers,
            **scales_in(scene),
            **{key: seen.attrs[key] for key in ("stopped",) if key in seen.attrs},
            "phase": phase,
            "basin_entropy": entropy,
            "boundary_basin_entropy": at_boundary,
            "entropy_box": BOX,
            "boundary_dimension": float(size.value),
            "boundary_dimension_error": float(size.error),
        },
    )


def _fractions(label, count):
    """(shares of the starts beyond no rigid wall, their errors), each (count,)."""

    def shares(part):
        inside = max(1, (part != OUTSIDE).sum())
        return np.array([(part == place).sum() for place in range(count)]) / inside

    parts = [shares(label[row::2, column::2]) for row in (0, 1) for column in (0, 1)]
    inside, outside = label.size, int((label == OUTSIDE).sum())
    unresolved = float((label < 0).sum() - outside) / max(1, inside - outside)
    return shares(label), np.std(parts, axis=0, ddof=1) + unresolved
