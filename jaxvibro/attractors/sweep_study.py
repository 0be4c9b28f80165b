"""Run the lanes of a sweep as a `Study`, in chunks that are blocks of lanes over all values."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import jax
import numpy as np
import xarray as xr
from jaxtyping import Float

from ..compiled.kernel_calls import BLOCK_WIDTH
from ..scene.codes import Status
from ..scene.scene import Scene
from ..scene.scene_table import scene_toml
from ..scene.state import State
from ..stores.study_protocol import Column, Grid, fingerprint_array


@dataclass(frozen=True)
class SweepStudy:
    """Lanes of a sweep as a `Study`.

    Parameters
    ----------
    template_scene : Scene
        Scene of the first lane. It has the parameters that all lanes share.
    name : str
        Swept parameter.
    lane_inputs : tuple
        Scene with lanes, values of shape (count, lanes), and initial states.
    run_lanes : callable
        Function of scene, values, initial states, name and settings. Returns x and v of shape (count, lanes, keep) and
        status of shape (count, lanes).
    settings : tuple of int
        Drive periods discarded and recorded at each value.
    """

    template_scene: Scene
    name: str
    lane_inputs: tuple[Scene, Float[np.ndarray, "count lanes"], State]
    run_lanes: Callable[..., Any]
    settings: tuple[int, int]

    @cached_property
    def grid(self) -> Grid:
        """Grid of the lanes, divided into blocks."""
        return Grid({"lane": self.lane_inputs[1].shape[1]}, (BLOCK_WIDTH,))

    @property
    def columns(self) -> dict[str, Column]:
        """Columns x, v and status of each lane."""
        step_dims, float_dtype = {"step": len(self.lane_inputs[1])}, np.dtype(self.template_scene.dtype)
        columns = {
            name: Column(float_dtype, np.nan, {}, {**step_dims, "period": self.settings[1]}) for name in ("x", "v")
        }
        return columns | {"status": Column(np.dtype(np.int32), -1, {}, step_dims)}

    @cached_property
    def identity(self) -> dict[str, str]:
        """Texts that identify the study in a store."""
        scene, values, start_state = self.lane_inputs
        lane_values = {name: np.asarray(scene.parameter(name)) for name in scene.names if name != self.name}
        lane_values |= {
            f"start.{name}": np.asarray(getattr(start_state, name)) for name in ("x", "v", "phase", "contact")
        }
        return {
            "scene": scene_toml(self.template_scene),
            self.name: fingerprint_array(values),
            **{name: fingerprint_array(array) for name, array in lane_values.items()},
            "settings": repr(self.settings),
            "dtype": str(self.template_scene.dtype),
        }

    @property
    def frame(self) -> xr.Dataset:
        """Dataset without variables."""
        return xr.Dataset(attrs={"swept": self.name})

    def compute(self, number: int, frame: xr.Dataset) -> tuple[dict[str, np.ndarray], int]:
        """Return the columns of a block of lanes, and the number of values with a status of CAP or worse."""
        (block_slice,) = self.grid.chunk_slices(number)
        scene, values, start_state = self.lane_inputs
        block_inputs = jax.tree.map(lambda leaf: leaf[block_slice], (scene, start_state))
        x, v, status = self.run_lanes(
            block_inputs[0], values[:, block_slice], block_inputs[1], self.name, *self.settings
        )
        results = {"x": x, "v": v, "status": status}
        return {name: np.moveaxis(array, 1, 0) for name, array in results.items()}, int((status >= Status.CAP).sum())
