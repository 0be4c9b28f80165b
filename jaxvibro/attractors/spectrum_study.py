"""The Lyapunov spectrum at very many values as a `Study`: a block of values is a chunk."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Float

from ..compiled.kernels import BLOCK_WIDTH
from ..maps.sticking_phases import NO_STICKING, StickingPhases
from ..scene.scene import Scene
from ..scene.scene_table import scene_toml
from ..scene.state import State
from ..stores.study import Column, Grid, fingerprint_axis
from .orbit_exponents import ExponentEstimate

# Of each value: the sizes of the fields of `ExponentEstimate`, then those of its `StickingPhases` that are told.
COLUMN_SIZES = {"exponent": 2, "error": 2, "impacts": 3, "within": 2, "periods": 0, "status": 0, "count": 0}
STICKING_COLUMNS = ("rests", "rate")


@dataclass(frozen=True)
class SpectrumStudy:
    """Exponents at the values of a parameter as a `Study`.

    scene: that of all values, state: that of each, (values,); estimate_block: from the scenes, the states and the
    settings to the `ExponentEstimate` and the `StickingPhases` of each value; settings: settle, error, most."""

    scene: Scene
    name: str
    values: Float[np.ndarray, " values"]
    state: State
    estimate_block: Callable[..., Any]
    settings: tuple[int, float, int]

    @cached_property
    def grid(self) -> Grid:
        return Grid({self.name: len(self.values)}, (BLOCK_WIDTH,))

    @property
    def columns(self) -> dict[str, Column]:
        float_type = np.dtype(np.float64)
        columns = {
            name: Column(float_type, np.nan, {}, {f"{name}_place": size} if size else {})
            for name, size in COLUMN_SIZES.items()
        }
        return columns | {name: Column(float_type, np.nan, {}) for name in STICKING_COLUMNS}

    @cached_property
    def identity(self) -> dict[str, str]:
        state_texts = {
            f"start.{name}": fingerprint_axis(getattr(self.state, name)) for name in ("x", "v", "phase", "contact")
        }
        setting_texts = {"settings": repr(self.settings), "dtype": str(self.scene.dtype)}
        return {
            "scene": scene_toml(self.scene),
            self.name: fingerprint_axis(self.values),
            **state_texts,
            **setting_texts,
        }

    @cached_property
    def frame(self) -> xr.Dataset:
        return xr.Dataset(coords={self.name: self.values})

    def compute(self, number: int, frame: xr.Dataset) -> tuple[dict[str, np.ndarray], int]:
        (block,) = self.grid.chunk_slices(number)
        values = self.values[block]
        state = State(*(getattr(self.state, name)[block] for name in ("x", "v", "phase", "contact")))
        estimates, sticking = self.estimate_block(self.scene.replace(**{self.name: values}), state, *self.settings)
        columns = {name: np.array([getattr(record, name) for record in estimates], float) for name in COLUMN_SIZES}
        columns |= {"rests": np.array([record.count for record in sticking], float)}
        columns |= {"rate": np.array([record.growth_rate for record in sticking], float)}
        return columns, int(np.isnan(columns["exponent"][:, 0]).sum())


def estimates_from(data: xr.Dataset) -> tuple[list[ExponentEstimate], list[StickingPhases]]:
    """The `ExponentEstimate` and the `StickingPhases` of each value from a study's Dataset."""
    defaults = {"periods": 0, "status": -1, "count": 0}  # of a value that is not done
    integers = {name: data[name].fillna(value).values.astype(int).tolist() for name, value in defaults.items()}
    field_rows = [integers[name] if name in integers else data[name].values for name in COLUMN_SIZES]
    sticking_rows = zip(data["rests"].values, data["rate"].values, strict=True)
    sticking = [NO_STICKING._replace(count=count, growth_rate=rate) for count, rate in sticking_rows]
    return [ExponentEstimate(*row) for row in zip(*field_rows, strict=True)], sticking
