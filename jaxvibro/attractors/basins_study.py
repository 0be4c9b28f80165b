"""The starts of basins as a `Study`: a grid on Sigma in bands of rows, each start labelled by what holds it."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy
import xarray as xr
from jaxtyping import Float

from ..output.units import LENGTH, SPEED
from ..scene.scene import Scene
from ..scene.scene_table import scene_text, scene_text_or_none
from ..stores.engines import ThisThread
from ..stores.study import Column, Grid, axis_text
from .assign import OUTSIDE, UNRESOLVED, Home, labelled
from .trapping_region import Cloud, Trap

MOST_SMALL = 32_000  # drive periods of patience up to which numbers of them take two bytes
NOT_DONE = -3  # label of a start whose chunk is not done


@dataclass(frozen=True)
class BasinsStudy:
    """Basins as a `Study`. x, v: of the starts; phase: rad; homes: of the attractors, which are called so;
    size: starts of a chunk, about."""

    scene: Scene
    x: Float[np.ndarray, " columns"]
    v: Float[np.ndarray, " rows"]
    phase: float
    homes: tuple[Home, ...]
    names: tuple[str, ...]
    patience: int
    size: int

    def __reduce__(self):
        """Sent to a worker without the traps, which may be large: it reads them from the store."""
        homes = tuple(Home(home.points, None) for home in self.homes)
        return BasinsStudy, (self.scene, self.x, self.v, self.phase, homes, self.names, self.patience, self.size)

    @cached_property
    def grid(self) -> Grid:
        rows, columns = len(self.v), len(self.x)
        bands = -(-rows * columns // self.size)
        return Grid({"v": rows, "x": columns}, (-(-rows // bands), columns))

    @property
    def columns(self) -> dict[str, Column]:
        whole = np.int16 if self.patience <= MOST_SMALL else np.int32
        label = f"attractor, {UNRESOLVED} unresolved, {OUTSIDE} beyond a rigid wall"
        return {
            "label": Column(np.dtype(np.int16), NOT_DONE, {"long_name": label}),
            "periods": Column(np.dtype(whole), 0, {"long_name": "drive periods after which it was seen"}),
        }

    @cached_property
    def identity(self) -> dict[str, str]:
        axes = {name: axis_text(getattr(self, name)) for name in ("x", "v")}
        plain = {"phase": repr(self.phase), "patience": repr(self.patience), "attractors": repr(self.names)}
        return {"scene": scene_text(self.scene), **axes, **plain, "dtype": str(self.scene.dtype)}

    @cached_property
    def frame(self) -> xr.Dataset:
        coords = {
            "x": ("x", self.x, {"long_name": "displacement", "units": LENGTH}),
            "v": ("v", self.v, {"long_name": "velocity", "units": SPEED}),
        }
        parts: dict[str, Any] = {}
        for k, home in enumerate(self.homes):
            parts[f"points_{k}"] = ((f"point_{k}", "axis"), home.points)
            if isinstance(home.trap, Trap):
                parts[f"lengths_{k}"] = ((f"point_{k}", "side", "axis"), home.trap.lengths)
            if isinstance(home.trap, Cloud):
                parts[f"sample_{k}"] = ((f"place_{k}", "axis"), np.asarray(home.trap.tree.data))
                parts[f"near_{k}"] = ((), home.trap.near)
        return xr.Dataset(parts, coords, {"scene_file": scene_text_or_none(self.scene), "names": list(self.names)})

    def compute(self, number: int, frame: xr.Dataset) -> tuple[dict[str, np.ndarray], int]:
        rows, columns = self.grid.cut(number)
        across, along = np.meshgrid(self.x[columns], self.v[rows])
        homes = self.homes if frame is self.frame else [_home(frame, k) for k in range(len(self.homes))]
        starts = across.ravel(), along.ravel()
        label, periods = labelled(ThisThread, self.scene, *starts, self.phase, homes, self.patience)
        found = {name: each.astype(self.columns[name].dtype) for name, each in (("label", label), ("periods", periods))}
        return {name: each.reshape(across.shape) for name, each in found.items()}, int((label == UNRESOLVED).sum())


def _home(frame, k):
    """The `Home` of an attractor as a store's frame has it."""
    points = frame[f"points_{k}"].values
    if f"lengths_{k}" in frame:
        return Home(points, Trap(points, frame[f"lengths_{k}"].values))
    if f"sample_{k}" in frame:
        return Home(points, Cloud(scipy.spatial.cKDTree(frame[f"sample_{k}"].values), float(frame[f"near_{k}"])))
    return Home(points, None)
