"""Compute basins of attraction as a `Study`, in chunks that are bands of rows of the grid."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy
import xarray as xr
from jaxtyping import Float

from ..output.units import LENGTH, SPEED
from ..scene.scene import Scene
from ..scene.scene_table import scene_toml, scene_toml_or_empty
from ..stores.engines import SerialPool
from ..stores.study_protocol import Column, Grid, fingerprint_array
from .basin_labels import OUTSIDE, UNRESOLVED, AttractorNeighbourhood, label_starts
from .trapping_region import PointCloud, TrappingEllipses

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
