"""Basins of attraction: which attractor each start of a grid ends on."""

from collections.abc import Callable, Sequence

import numpy as np
import xarray as xr
from jaxtyping import ArrayLike, Float, Real

from continuation.limits import limits_of

from ..maps.initial_conditions import initial_box
from ..output.units import LENGTH, SPEED, scales_attributes
from ..scene import check
from ..scene.scene import Scene
from ..stores.filling import Store, complete_study
from .basin_labels import OUTSIDE, build_neighbourhoods
from .basins_study import BasinsStudy
from .find import Attractor, find_attractors
from .fractal import BOX_SIZE, basin_entropies, boundary_dimension

STARTS_PER_CHUNK = 1 << 16  # starts that are worked out together
MAX_PERIODS = 2000  # drive periods after which a start is given up


@check.host_only("use strobe")
def basins(
    scene: Scene,
    x: Real[ArrayLike, " columns"] | Sequence[float],
    v: Real[ArrayLike, " rows"] | Sequence[float],
    phase: Real[ArrayLike, ""] = 0.0,
    attractors: Sequence[Attractor] | None = None,
    patience: int = MAX_PERIODS,
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
    x, v = _check_axis("x", x), _check_axis("v", v)
    phase_angle = check.finite_array("phase", phase, np.float64)
    if phase_angle.shape:
        raise check.ArgumentError("phase", "must be a number", phase_angle)
    patience = check.whole_number("patience", patience, 1)
    attractors = find_attractors(scene) if attractors is None else tuple(attractors)
    x_min, x_max, max_speed = initial_box(scene)
    neighbourhoods = build_neighbourhoods(
        scene, attractors, float(phase_angle), float(max(abs(x_min), abs(x_max), max_speed))
    )
    labels = tuple(attractor.label for attractor in attractors)
    study = BasinsStudy(scene, x, v, float(phase_angle), tuple(neighbourhoods), labels, patience, STARTS_PER_CHUNK)
    data = complete_study(study, store, progress and (lambda record: progress(record.done)), limits)
    return _make_dataset(scene, float(phase_angle), attractors, neighbourhoods, data)


def _check_axis(key, values) -> Float[np.ndarray, " numbers"]:
    values = check.finite_array(key, values, np.float64)
    if values.ndim != 1 or len(values) < 2 or not (np.diff(values) > 0).all():
        raise check.ArgumentError(key, "must be at least two numbers in rising order", values)
    return values


def _make_dataset(scene, phase, attractors, neighbourhoods, data):
    labels, max_points = (
        data["label"].values,
        max((len(neighbourhood.points) for neighbourhood in neighbourhoods), default=0),
    )
    points = np.full((len(neighbourhoods), max_points, 2), np.nan)
    for point_row, neighbourhood in zip(points, neighbourhoods, strict=True):
        point_row[: len(neighbourhood.points)] = neighbourhood.points
    fractions, fraction_errors = _basin_fractions(labels, len(neighbourhoods))
    boundary = boundary_dimension(labels)
    entropy, boundary_entropy = basin_entropies(labels)
    mirror_indices = [-1 if attractor.mirror_of is None else attractor.mirror_of for attractor in attractors]
    return xr.Dataset(
        {
            "label": data["label"],
            "periods": data["periods"],
            "fraction": ("attractor", fractions, {"long_name": "share of the starts beyond no rigid wall"}),
            "fraction_error": ("attractor", fraction_errors),
            "point_x": (("attractor", "point"), points[..., 0], {"units": LENGTH}),
            "point_v": (("attractor", "point"), points[..., 1], {"units": SPEED}),
            "mixed": ("side", boundary.mixed_shares, {"long_name": "share of boxes with more than one label"}),
        },
        coords={
            "x": data["x"],
            "v": data["v"],
            "name": ("attractor", [attractor.label for attractor in attractors]),
            "kind": ("attractor", [attractor.kind for attractor in attractors]),
            "mirror_of": ("attractor", np.array(mirror_indices, int)),
            "side": ("side", boundary.box_sides, {"units": "cells"}),
        },
        attrs={
            **scene.numbers,
            **scales_attributes(scene),
            **{key: data.attrs[key] for key in ("stopped",) if key in data.attrs},
            "phase": phase,
            "basin_entropy": entropy,
            "boundary_basin_entropy": boundary_entropy,
            "entropy_box": BOX_SIZE,
            "boundary_dimension": float(boundary.value),
            "boundary_dimension_error": float(boundary.error),
        },
    )


def _basin_fractions(labels, n_attractors):
    """(shares of the starts beyond no rigid wall, their errors), each (count,)."""

    def basin_shares(subgrid_labels):
        n_inside = max(1, (subgrid_labels != OUTSIDE).sum())
        return np.array([(subgrid_labels == index).sum() for index in range(n_attractors)]) / n_inside

    subgrid_fractions = [
        basin_shares(labels[row_offset::2, column_offset::2]) for row_offset in (0, 1) for column_offset in (0, 1)
    ]
    n_starts, n_outside = labels.size, int((labels == OUTSIDE).sum())
    unresolved_share = float((labels < 0).sum() - n_outside) / max(1, n_starts - n_outside)
    return basin_shares(labels), np.std(subgrid_fractions, axis=0, ddof=1) + unresolved_share
