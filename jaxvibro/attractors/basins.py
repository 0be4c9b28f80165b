"""Compute the basins of attraction of a scene on a grid of initial states."""

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

STARTS_PER_CHUNK = 1 << 16  # initial states of a chunk
MAX_PERIODS = 2000  # drive periods after which a state is unresolved


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
    """Compute the basins of attraction on a grid of the section.

    Each initial state of the grid is simulated until it is certain which attractor it approaches.

    Parameters
    ----------
    scene : Scene
        Scene without lanes.
    x : array_like
        Positions of the initial states, increasing, at least two. Array of shape (columns,). Beyond the face of a soft
        wall the mass is inside the wall.
    v : array_like
        Velocities of the initial states, increasing, at least two. Array of shape (rows,).
    phase : float, optional
        Phase of the drive at the initial states, in rad.
    attractors : sequence of Attractor, optional
        Attractors as returned by `find_attractors`. None computes them. Unresolved entries attract no initial state.
    patience : int, optional
        Largest number of drive periods for an initial state, at least 1.
    progress : callable, optional
        Called with the number of initial states done.
    store : Store, optional
        Store that keeps labels and periods and from which the computation resumes. None keeps them in memory.
    max_seconds : float, optional
        Wall-clock time, in s, after which no chunk of initial states is started. None is no limit.

    Returns
    -------
    xarray.Dataset
        Variables on the grid (v, x): ``label``, the index of the attractor, -1 if the initial state is not certain to
        approach any, -2 beyond a rigid wall, -3 if it is not done; ``periods``, the drive periods after which the
        attractor was recognised. Along ``attractor``: ``name`` (P n p q, ``"chaotic"``, ...), ``kind``, ``mirror_of``
        (index of the mirror image, -1 for none), ``point_x`` and ``point_v`` (points on the section at the phase,
        padded with nan), ``fraction`` (of the initial states that are not beyond a rigid wall), and ``fraction_error``
        (spread between the four subgrids of every other row and column, plus the unresolved fraction). Along ``side``,
        the side of a box in cells: ``mixed``, the fraction of boxes with more than one label. Attributes: the
        parameters of the scene, ``phase``, ``basin_entropy`` and ``boundary_basin_entropy`` of boxes of 5 x 5 initial
        states, ``boundary_dimension`` and ``boundary_dimension_error``.

    Raises
    ------
    ArgumentError
        If the scene has lanes or an argument is invalid.

    See Also
    --------
    find_attractors : Find the attractors of a scene.
    fractions : Compute basin fractions along a parameter.

    Notes
    -----
    An initial state is on a periodic attractor once it is inside an ellipse that the return map takes into itself,
    which is tested on a fan of states. It is on a chaotic attractor after eight consecutive checks, eight periods
    apart, near a sample of that attractor. An attractor with an impact on a rigid wall exactly at the phase of the
    section has no such ellipse: choose another phase. Many labels -1 indicate an attractor that is missing: call
    `find_attractors` with more initial states.

    After `max_seconds`, initial states that are not done count as unresolved, and the attribute ``stopped`` gives the
    reason. A later call with the same store resumes. The errors of the store are passed on.

    References
    ----------
    Daza, Wagemakers, Georgeot, Guery-Odelin and Sanjuan, Sci. Rep. 6, 31416 (2016): basin entropy.

    Examples
    --------
    >>> attractors = jv.find_attractors(scene, starts=50)
    >>> data = jv.basins(scene, np.linspace(-0.9, 0.9, 20), np.linspace(-2.0, 2.0, 20), attractors=attractors)
    >>> data["fraction"].values.round(2).tolist()
    [0.87, 0.13]
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
    """Return the values of an axis, checked."""
    values = check.finite_array(key, values, np.float64)
    if values.ndim != 1 or len(values) < 2 or not (np.diff(values) > 0).all():
        raise check.ArgumentError(key, "must be at least two numbers in increasing order", values)
    return values


def _make_dataset(scene, phase, attractors, neighbourhoods, data):
    """Return the named result: labels, basin fractions, entropies and boundary dimension."""
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
    """Return (basin fractions, their errors), each (count,), of the starts that are not beyond a rigid wall."""

    def basin_shares(subgrid_labels):
        """Return the fraction of each attractor on a grid of labels."""
        n_inside = max(1, (subgrid_labels != OUTSIDE).sum())
        return np.array([(subgrid_labels == index).sum() for index in range(n_attractors)]) / n_inside

    subgrid_fractions = [
        basin_shares(labels[row_offset::2, column_offset::2]) for row_offset in (0, 1) for column_offset in (0, 1)
    ]
    n_starts, n_outside = labels.size, int((labels == OUTSIDE).sum())
    unresolved_share = float((labels < 0).sum() - n_outside) / max(1, n_starts - n_outside)
    return basin_shares(labels), np.std(subgrid_fractions, axis=0, ddof=1) + unresolved_share
