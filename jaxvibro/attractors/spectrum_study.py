"""Compute Lyapunov exponents at many values as a `Study`: a block of values is a chunk."""

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

# Columns of each value: the sizes of the fields of `ExponentEstimate`, then the stored fields of `StickingPhases`.
COLUMN_SIZES = {"exponent": 2, "error": 2, "impacts": 3, "within": 2, "periods": 0, "status": 0, "count": 0}
STICKING_COLUMNS = ("rests", "rate")


@dataclass(frozen=True)
class SpectrumStudy:
    """Lyapunov exponents at the values of a parameter as a `Study`.

    Parameters
    ----------
    scene : Scene
        Scene of all values.
    name : str
        Parameter.
    values : ndarray
        Values of the parameter. Array of shape (values,).
    state : State
        Initial state at each value. Leaves of shape (values,).
    estimate_block : callable
        Function from scenes, states and settings to the `ExponentEstimate` and the `StickingPhases` of each value.
    settings : tuple
        Drive periods discarded, largest standard error, drive periods averaged at most.
    """

    scene: Scene
    name: str
    values: Float[np.ndarray, " values"]
    state: State
    estimate_block: Callable[..., Any]
    settings: tuple[int, float, int]

    @cached_property
    def grid(self) -> Grid:
        """Values, in blocks."""
        return Grid({self.name: len(self.values)}, (BLOCK_WIDTH,))

    @property
    def columns(self) -> dict[str, Column]:
        """Fields of the estimates and of the sticking phases."""
        float_type = np.dtype(np.float64)
        columns = {
            name: Column(float_type, np.nan, {}, {f"{name}_place": size} if size else {})
            for name, size in COLUMN_SIZES.items()
        }
        return columns | {name: Column(float_type, np.nan, {}) for name in STICKING_COLUMNS}

    @cached_property
    def identity(self) -> dict[str, str]:
        """Texts that identify the study."""
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
        """Dataset with the values as its coordinate."""
        return xr.Dataset(coords={self.name: self.values})

    def compute(self, number: int, frame: xr.Dataset) -> tuple[dict[str, np.ndarray], int]:
        """Return the columns of a block of values, and the number of values without an exponent."""
        (block,) = self.grid.chunk_slices(number)
        values = self.values[block]
        state = State(*(getattr(self.state, name)[block] for name in ("x", "v", "phase", "contact")))
        estimates, sticking = self.estimate_block(self.scene.replace(**{self.name: values}), state, *self.settings)
        columns = {name: np.array([getattr(record, name) for record in estimates], float) for name in COLUMN_SIZES}
        columns |= {"rests": np.array([record.count for record in sticking], float)}
        columns |= {"rate": np.array([record.growth_rate for record in sticking], float)}
        return columns, int(np.isnan(columns["exponent"][:, 0]).sum())


def estimates_from(data: xr.Dataset) -> tuple[list[ExponentEstimate], list[StickingPhases]]:
    """Return the `ExponentEstimate` and the `StickingPhases` of each value from a study's Dataset."""
    defaults = {"periods": 0, "status": -1, "count": 0}  # at a value that is not done
    integers = {name: data[name].fillna(value).values.astype(int).tolist() for name, value in defaults.items()}
    field_rows = [integers[name] if name in integers else data[name].values for name in COLUMN_SIZES]
    sticking_rows = zip(data["rests"].values, data["rate"].values, strict=True)
    sticking = [NO_STICKING._replace(count=count, growth_rate=rate) for count, rate in sticking_rows]
    return [ExponentEstimate(*row) for row in zip(*field_rows, strict=True)], sticking
