"""Compute Lyapunov exponents at many parameter values as a `Study`, in chunks that are blocks of values."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import jax
import numpy as np
import xarray as xr
from jaxtyping import Float

from ..compiled.kernel_calls import BLOCK_WIDTH
from ..maps.sticking_phase_intervals import NO_STICKING, StickingPhaseIntervals
from ..scene.scene import Scene
from ..scene.scene_table import scene_toml
from ..scene.state import State
from ..stores.study_protocol import Column, Grid, fingerprint_array
from .orbit_exponents import ExponentEstimate

# Columns of each value: the sizes of the fields of `ExponentEstimate`, then the stored fields of
# `StickingPhaseIntervals`.
COLUMN_SIZES = {"exponent": 2, "error": 2, "impacts": 3, "within": 2, "periods": 0, "status": 0, "count": 0}
STICKING_COLUMNS = ("rests", "rate")


@dataclass(frozen=True)
class SpectrumStudy:
    """Lyapunov exponents at the values of a parameter as a `Study`.

    Parameters
    ----------
    scene : Scene
        Scene without lanes, with the other parameters.
    name : str
        Parameter.
    values : ndarray
        Values of the parameter. Array of shape (values,).
    state : State
        Initial state at each value. Leaves of shape (values,).
    compute_block_exponents : callable
        Function of a scene with one lane per value, states and settings. Returns the `ExponentEstimate` and the
        `StickingPhaseIntervals` of each value.
    settings : tuple
        Drive periods discarded, target standard error, largest number of drive periods averaged.
    """

    scene: Scene
    name: str
    values: Float[np.ndarray, " values"]
    state: State
    compute_block_exponents: Callable[..., Any]
    settings: tuple[int, float, int]

    @cached_property
    def grid(self) -> Grid:
        """Grid of the values, divided into blocks."""
        return Grid({self.name: len(self.values)}, (BLOCK_WIDTH,))

    @property
    def columns(self) -> dict[str, Column]:
        """Columns of the fields of `ExponentEstimate` and `StickingPhaseIntervals`."""
        float_dtype = np.dtype(np.float64)
        return {
            name: Column(float_dtype, np.nan, {}, {f"{name}_place": n_components} if n_components else {})
            for name, n_components in (COLUMN_SIZES | dict.fromkeys(STICKING_COLUMNS, 0)).items()
        }

    @cached_property
    def identity(self) -> dict[str, str]:
        """Texts that identify the study in a store."""
        return {
            "scene": scene_toml(self.scene),
            self.name: fingerprint_array(self.values),
            **{
                f"start.{name}": fingerprint_array(getattr(self.state, name)) for name in ("x", "v", "phase", "contact")
            },
            "settings": repr(self.settings),
            "dtype": str(self.scene.dtype),
        }

    @cached_property
    def frame(self) -> xr.Dataset:
        """Dataset with the values as its coordinate."""
        return xr.Dataset(coords={self.name: self.values})

    def compute(self, number: int, frame: xr.Dataset) -> tuple[dict[str, np.ndarray], int]:
        """Return the columns of a block of values, and the number of values without an exponent."""
        (block_slice,) = self.grid.chunk_slices(number)
        values = self.values[block_slice]
        state = jax.tree.map(lambda leaf: leaf[block_slice], self.state)
        exponent_estimates, sticking_phases = self.compute_block_exponents(
            self.scene.replace(**{self.name: values}), state, *self.settings
        )
        columns = {
            name: np.array([getattr(record_of_value, name) for record_of_value in exponent_estimates], float)
            for name in COLUMN_SIZES
        }
        columns["rests"] = np.array([sticking_phase.count for sticking_phase in sticking_phases], float)
        columns["rate"] = np.array([sticking_phase.growth_rate for sticking_phase in sticking_phases], float)
        return columns, int(np.isnan(columns["exponent"][:, 0]).sum())


def read_estimates(data: xr.Dataset) -> tuple[list[ExponentEstimate], list[StickingPhaseIntervals]]:
    """Return the `ExponentEstimate` and the `StickingPhaseIntervals` of each value from a study's Dataset."""
    integer_defaults = {"periods": 0, "status": -1, "count": 0}  # at a value that is not done
    integer_columns = {
        name: data[name].fillna(value).values.astype(int).tolist() for name, value in integer_defaults.items()
    }
    field_columns = [integer_columns[name] if name in integer_columns else data[name].values for name in COLUMN_SIZES]
    sticking_rows = zip(data["rests"].values, data["rate"].values, strict=True)
    sticking_phases = [
        NO_STICKING._replace(count=count, growth_rate=growth_rate) for count, growth_rate in sticking_rows
    ]
    return [ExponentEstimate(*estimate_fields) for estimate_fields in zip(*field_columns, strict=True)], sticking_phases
