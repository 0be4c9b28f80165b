"""The Lyapunov spectrum at very many values as a `Study`: a block of values is a chunk."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Float

from ..compiled.kernels import WIDTH
from ..maps.rests import NO_RESTS, Rests
from ..scene.scene import Scene
from ..scene.scene_table import scene_text
from ..scene.state import State
from ..stores.study import Column, Grid, axis_text
from .orbit_exponents import Rates

# Of each value: the sizes of the fields of `Rates`, then those of its `Rests` that are told.
SIZES = {"exponent": 2, "error": 2, "impacts": 3, "within": 2, "periods": 0, "status": 0, "count": 0}
RESTS = ("rests", "rate")


@dataclass(frozen=True)
class SpectrumStudy:
    """Exponents at the values of a parameter as a `Study`.

    scene: that of all values, state: that of each, (values,); work: from the scenes, the states and the settings to the
    `Rates` and the `Rests` of each value; settings: settle, error, most.
    """

    scene: Scene
    name: str
    values: Float[np.ndarray, " values"]
    state: State
    work: Callable[..., Any]
    settings: tuple[int, float, int]

    @cached_property
    def grid(self) -> Grid:
        return Grid({self.name: len(self.values)}, (WIDTH,))

    @property
    def columns(self) -> dict[str, Column]:
        real = np.dtype(np.float64)
        found = {
            name: Column(real, np.nan, {}, {f"{name}_place": size} if size else {}) for name, size in SIZES.items()
        }
        return found | {name: Column(real, np.nan, {}) for name in RESTS}

    @cached_property
    def identity(self) -> dict[str, str]:
        states = {f"start.{name}": axis_text(getattr(self.state, name)) for name in ("x", "v", "phase", "contact")}
        plain = {"settings": repr(self.settings), "dtype": str(self.scene.dtype)}
        return {"scene": scene_text(self.scene), self.name: axis_text(self.values), **states, **plain}

    @cached_property
    def frame(self) -> xr.Dataset:
        return xr.Dataset(coords={self.name: self.values})

    def compute(self, number: int, frame: xr.Dataset) -> tuple[dict[str, np.ndarray], int]:
        (part,) = self.grid.cut(number)
        values = self.values[part]
        state = State(*(getattr(self.state, name)[part] for name in ("x", "v", "phase", "contact")))
        rates, resting = self.work(self.scene.replace(**{self.name: values}), state, *self.settings)
        found = {name: np.array([getattr(one, name) for one in rates], float) for name in SIZES}
        found |= {"rests": np.array([one.count for one in resting], float)}
        found |= {"rate": np.array([one.rate for one in resting], float)}
        return found, int(np.isnan(found["exponent"][:, 0]).sum())


def rates_of(data: xr.Dataset) -> tuple[list[Rates], list[Rests]]:
    """The `Rates` and the `Rests` of each value from a study's Dataset."""
    blank = {"periods": 0, "status": -1, "count": 0}  # of a value that is not done
    whole = {name: data[name].fillna(value).values.astype(int).tolist() for name, value in blank.items()}
    parts = [whole[name] if name in whole else data[name].values for name in SIZES]
    told = zip(data["rests"].values, data["rate"].values, strict=True)
    resting = [NO_RESTS._replace(count=count, rate=rate) for count, rate in told]
    return [Rates(*row) for row in zip(*parts, strict=True)], resting
