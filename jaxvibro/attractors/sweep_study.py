"""Sweeps of very many lanes as a `Study`: some lanes, from their first value to their last, are a chunk."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import jax
import numpy as np
import xarray as xr
from jaxtyping import Float

from ..compiled.kernels import WIDTH
from ..scene.codes import Status
from ..scene.scene import Scene
from ..scene.scene_table import scene_text
from ..scene.state import State
from ..stores.study import Column, Grid, axis_text


@dataclass(frozen=True)
class SweepStudy:
    """A sweep's lanes as a `Study`. single: the scene whose numbers the lanes share, else the first lane's; lanes: the
    scene, the values (count, lanes) and the start of each; work: from these to x, v (count, lanes, keep) and status
    (count, lanes); settings: settle, keep."""

    single: Scene
    name: str
    lanes: tuple[Scene, Float[np.ndarray, "count lanes"], State]
    work: Callable[..., Any]
    settings: tuple[int, int]

    @cached_property
    def grid(self) -> Grid:
        return Grid({"lane": self.lanes[1].shape[1]}, (WIDTH,))

    @property
    def columns(self) -> dict[str, Column]:
        steps, real = {"step": len(self.lanes[1])}, np.dtype(self.single.dtype)
        kept = {name: Column(real, np.nan, {}, {**steps, "period": self.settings[1]}) for name in ("x", "v")}
        return kept | {"status": Column(np.dtype(np.int32), -1, {}, steps)}

    @cached_property
    def identity(self) -> dict[str, str]:
        scene, values, start = self.lanes
        named = {name: np.asarray(scene.parameter(name)) for name in scene.names if name != self.name}
        named |= {f"start.{name}": np.asarray(getattr(start, name)) for name in ("x", "v", "phase", "contact")}
        lanes = {name: axis_text(each) for name, each in named.items()}
        plain = {"settings": repr(self.settings), "dtype": str(self.single.dtype)}
        return {"scene": scene_text(self.single), self.name: axis_text(values), **lanes, **plain}

    @property
    def frame(self) -> xr.Dataset:
        return xr.Dataset(attrs={"swept": self.name})

    def compute(self, number: int, frame: xr.Dataset) -> tuple[dict[str, np.ndarray], int]:
        (part,) = self.grid.cut(number)
        scene, values, start = self.lanes
        some = jax.tree.map(lambda leaf: leaf[part], (scene, start))
        x, v, status = self.work(some[0], values[:, part], some[1], self.name, *self.settings)
        found = {"x": x, "v": v, "status": status}
        return {name: np.moveaxis(each, 1, 0) for name, each in found.items()}, int((status >= Status.CAP).sum())
