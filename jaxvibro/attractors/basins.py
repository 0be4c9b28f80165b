"""Compute the basins of attraction of a scene on a grid of initial states."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy
import xarray as xr
from jaxtyping import ArrayLike, Float, Real

from continuation.branch_segment import make_limits

from ..output.units import LENGTH, SPEED, scales_attributes
from ..scene import check
from ..scene.scene import Scene
from ..scene.scene_table import scene_toml, scene_toml_or_empty
from ..stores.engines import SerialPool
from ..stores.study import Column, Grid, Store, complete_study, fingerprint_array
from .basin_boundaries import BOX_SIZE, basin_entropies, boundary_dimension
from .basin_labels import (
    OUTSIDE,
    UNRESOLVED,
    AttractorNeighbourhood,
    PointCloud,
    TrappingEllipses,
    build_neighbourhoods,
    label_starts,
)
from .find import Attractor, find_attractors

MAX_INT16_PERIODS = 32_000  # largest `max_periods` whose period counts are stored in two bytes
NOT_DONE = -3  # label of an initial state whose chunk is not done


@dataclass(frozen=True)
class BasinsStudy:
    """Basins of attraction as a `Study`.

    Parameters
    ----------
    scene : Scene
        Scene without lanes.
    x : ndarray
        Positions of the initial states. Array of shape (columns,).
    v : ndarray
        Velocities of the initial states. Array of shape (rows,).
    phase : float
        Phase of the drive, in rad.
    neighbourhoods : tuple of AttractorNeighbourhood
        Neighbourhoods of the attractors.
    labels : tuple of str
        Labels of the attractors.
    max_periods : int
        Largest number of drive periods.
    chunk_size : int
        Approximate number of initial states of a chunk.
    """

    scene: Scene
    x: Float[np.ndarray, " columns"]
    v: Float[np.ndarray, " rows"]
    phase: float
    neighbourhoods: tuple[AttractorNeighbourhood, ...]
    labels: tuple[str, ...]
    max_periods: int
    chunk_size: int

    def __reduce__(self):
        """Pickle without the regions of the attractors, which may be large; workers read the regions from the store."""
        neighbourhoods = tuple(
            AttractorNeighbourhood(neighbourhood.points, None) for neighbourhood in self.neighbourhoods
        )
        return BasinsStudy, (
            self.scene,
            self.x,
            self.v,
            self.phase,
            neighbourhoods,
            self.labels,
            self.max_periods,
            self.chunk_size,
        )

    @cached_property
    def grid(self) -> Grid:
        """Grid of the initial states, divided into bands of rows."""
        n_grid_rows, n_grid_columns = len(self.v), len(self.x)
        n_row_bands = -(-n_grid_rows * n_grid_columns // self.chunk_size)
        return Grid({"v": n_grid_rows, "x": n_grid_columns}, (-(-n_grid_rows // n_row_bands), n_grid_columns))

    @property
    def columns(self) -> dict[str, Column]:
        """Columns ``label`` and ``periods``."""
        period_dtype = np.int16 if self.max_periods <= MAX_INT16_PERIODS else np.int32
        label_description = f"attractor, {UNRESOLVED} unresolved, {OUTSIDE} beyond a rigid wall"
        return {
            "label": Column(np.dtype(np.int16), NOT_DONE, {"long_name": label_description}),
            "periods": Column(np.dtype(period_dtype), 0, {"long_name": "drive periods after which it was seen"}),
        }

    @cached_property
    def identity(self) -> dict[str, str]:
        """Texts that identify the study in a store."""
        return {
            "scene": scene_toml(self.scene),
            "x": fingerprint_array(self.x),
            "v": fingerprint_array(self.v),
            "phase": repr(self.phase),
            "patience": repr(self.max_periods),
            "attractors": repr(self.labels),
            "dtype": str(self.scene.dtype),
        }

    @cached_property
    def frame(self) -> xr.Dataset:
        """Coordinates and the neighbourhoods of the attractors."""
        coords = {
            "x": ("x", self.x, {"long_name": "displacement", "units": LENGTH}),
            "v": ("v", self.v, {"long_name": "velocity", "units": SPEED}),
        }
        variables: dict[str, Any] = {}
        for attractor_index, neighbourhood in enumerate(self.neighbourhoods):
            variables[f"points_{attractor_index}"] = ((f"point_{attractor_index}", "axis"), neighbourhood.points)
            if isinstance(neighbourhood.region, TrappingEllipses):
                variables[f"lengths_{attractor_index}"] = (
                    (f"point_{attractor_index}", "side", "axis"),
                    neighbourhood.region.ellipse_matrices,
                )
            if isinstance(neighbourhood.region, PointCloud):
                variables[f"sample_{attractor_index}"] = (
                    (f"place_{attractor_index}", "axis"),
                    np.asarray(neighbourhood.region.tree.data),
                )
                variables[f"near_{attractor_index}"] = ((), neighbourhood.region.max_distance)
        return xr.Dataset(
            variables, coords, {"scene_file": scene_toml_or_empty(self.scene), "names": list(self.labels)}
        )

    def compute(self, number: int, frame: xr.Dataset) -> tuple[dict[str, np.ndarray], int]:
        """Return the columns of a band of rows, and the number of unresolved initial states in the band."""
        row_slice, column_slice = self.grid.chunk_slices(number)
        x_grid, v_grid = np.meshgrid(self.x[column_slice], self.v[row_slice])
        neighbourhoods = (
            self.neighbourhoods
            if frame is self.frame
            else [_read_neighbourhood(frame, attractor_index) for attractor_index in range(len(self.neighbourhoods))]
        )
        start_components = x_grid.ravel(), v_grid.ravel()
        labels, periods = label_starts(
            SerialPool, self.scene, *start_components, self.phase, neighbourhoods, self.max_periods
        )
        column_arrays = {
            name: array.astype(self.columns[name].dtype) for name, array in (("label", labels), ("periods", periods))
        }
        return {name: array.reshape(x_grid.shape) for name, array in column_arrays.items()}, int(
            (labels == UNRESOLVED).sum()
        )


def _read_neighbourhood(frame, attractor_index):
    """Return the `AttractorNeighbourhood` of an attractor from a store's frame."""
    attractor_points = frame[f"points_{attractor_index}"].values
    if f"lengths_{attractor_index}" in frame:
        return AttractorNeighbourhood(
            attractor_points, TrappingEllipses(attractor_points, frame[f"lengths_{attractor_index}"].values)
        )
    if f"sample_{attractor_index}" in frame:
        return AttractorNeighbourhood(
            attractor_points,
            PointCloud(
                scipy.spatial.cKDTree(frame[f"sample_{attractor_index}"].values),
                float(frame[f"near_{attractor_index}"]),
            ),
        )
    return AttractorNeighbourhood(attractor_points, None)


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
        (standard deviation over the four subgrids of every other row and column, plus the unresolved fraction). Along
        ``side``, the side of a box in cells: ``mixed``, the fraction of boxes with more than one label. Attributes: the
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
    An initial state is assigned to a periodic attractor once the motion is inside an ellipse that the return map takes
    into itself. This property of the ellipse is tested with states in many directions. An initial state is assigned to
    a chaotic attractor after eight consecutive checks, eight periods apart, at which the motion is near a sample of
    that attractor.

    A periodic attractor with an impact on a rigid wall exactly at the phase of the section has no such ellipse: choose
    another phase. Many labels -1 indicate that an attractor is missing: call `find_attractors` with more initial
    states.

    After `max_seconds`, initial states that are not done have the label -3 and count as unresolved in
    ``fraction_error``, and the attribute ``stopped`` gives the reason. A later call with the same store resumes.
    Exceptions of the store propagate.

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
    computation_limits = make_limits(None, max_seconds, None, check.ArgumentError)
    check.require_single_scene(scene)
    x, v = _check_axis("x", x), _check_axis("v", v)
    phase_angle = check.check_finite_array("phase", phase, np.float64)
    patience = check.check_whole_number("patience", patience, 1)
    attractors = find_attractors(scene) if attractors is None else tuple(attractors)
    neighbourhoods = build_neighbourhoods(scene, attractors, float(phase_angle))
    labels = tuple(attractor.label for attractor in attractors)
    basins_study = BasinsStudy(
        scene, x, v, float(phase_angle), tuple(neighbourhoods), labels, patience, STARTS_PER_CHUNK
    )
    label_data = complete_study(
        basins_study, store, progress and (lambda record: progress(record.done)), computation_limits
    )
    return _make_dataset(scene, float(phase_angle), attractors, neighbourhoods, label_data)


def _check_axis(axis_name, values) -> Float[np.ndarray, " numbers"]:
    """Check the values of a grid axis and return them as an array."""
    values = check.check_finite_array(axis_name, values, np.float64)
    if values.ndim != 1 or len(values) < 2 or not (np.diff(values) > 0).all():
        raise check.ArgumentError(axis_name, "must be at least two numbers in increasing order", values)
    return values


def _make_dataset(scene, phase, attractors, neighbourhoods, label_data):
    """Return the Dataset of labels, basin fractions, entropies and boundary dimension."""
    labels, max_attractor_points = (
        label_data["label"].values,
        max((len(neighbourhood.points) for neighbourhood in neighbourhoods), default=0),
    )
    padded_points = np.full((len(neighbourhoods), max_attractor_points, 2), np.nan)
    for points_of_attractor, neighbourhood in zip(padded_points, neighbourhoods, strict=True):
        points_of_attractor[: len(neighbourhood.points)] = neighbourhood.points
    fractions, fraction_errors = _basin_fractions(labels, len(neighbourhoods))
    dimension = boundary_dimension(labels)
    basin_entropy, boundary_entropy = basin_entropies(labels)
    mirror_indices = [-1 if attractor.mirror_of is None else attractor.mirror_of for attractor in attractors]
    return xr.Dataset(
        {
            "label": label_data["label"],
            "periods": label_data["periods"],
            "fraction": ("attractor", fractions, {"long_name": "share of the starts beyond no rigid wall"}),
            "fraction_error": ("attractor", fraction_errors),
            "point_x": (("attractor", "point"), padded_points[..., 0], {"units": LENGTH}),
            "point_v": (("attractor", "point"), padded_points[..., 1], {"units": SPEED}),
            "mixed": ("side", dimension.mixed_fractions, {"long_name": "share of boxes with more than one label"}),
        },
        coords={
            "x": label_data["x"],
            "v": label_data["v"],
            "name": ("attractor", [attractor.label for attractor in attractors]),
            "kind": ("attractor", [attractor.kind for attractor in attractors]),
            "mirror_of": ("attractor", np.array(mirror_indices, int)),
            "side": ("side", dimension.box_sides, {"units": "cells"}),
        },
        attrs={
            **scene.numbers,
            **scales_attributes(scene),
            **{attr_name: label_data.attrs[attr_name] for attr_name in ("stopped",) if attr_name in label_data.attrs},
            "phase": phase,
            "basin_entropy": basin_entropy,
            "boundary_basin_entropy": boundary_entropy,
            "entropy_box": BOX_SIZE,
            "boundary_dimension": float(dimension.value),
            "boundary_dimension_error": float(dimension.error),
        },
    )


def _basin_fractions(labels, n_attractors):
    """Return (basin fractions, errors of the fractions), each of shape (attractors,).

    Initial states beyond a rigid wall are not counted.
    """

    def fractions_on_grid(grid_labels):
        """Return the basin fraction of each attractor on a grid of labels."""
        n_possible_starts = max(1, (grid_labels != OUTSIDE).sum())
        return np.array([(grid_labels == index).sum() for index in range(n_attractors)]) / n_possible_starts

    subgrid_fractions = [
        fractions_on_grid(labels[row_offset::2, column_offset::2]) for row_offset in (0, 1) for column_offset in (0, 1)
    ]
    n_starts, n_beyond_walls = labels.size, int((labels == OUTSIDE).sum())
    unresolved_fraction = float((labels < 0).sum() - n_beyond_walls) / max(1, n_starts - n_beyond_walls)
    return fractions_on_grid(labels), np.std(subgrid_fractions, axis=0, ddof=1) + unresolved_fraction
