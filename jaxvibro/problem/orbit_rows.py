"""What a branch and a locus have in common: orbits in the rows of a Dataset, special points among them, two ends."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from functools import cached_property
from os import PathLike
from typing import Generic, TypeVar

import numpy as np
import xarray as xr
from jaxtyping import Complex

from ..orbits.orbit import Orbit
from ..output.atomic_write import atomic_file
from ..scene.check import ArgumentError
from ..scene.scene import Scene
from .orbit_point import OrbitPoint, label_of, orbit_from_row

SpecialType = TypeVar("SpecialType", bound="SpecialOrbit")  # the class of a curve's special points


class SpecialOrbit:
    """A class of special points has scene, at the point; spot, the `OrbitPoint`; itinerary."""

    kind: str
    scene: Scene
    spot: OrbitPoint
    itinerary: tuple[str, ...]

    @property
    def label(self) -> str:
        """P n p q of the orbit."""
        return label_of(self.scene, self.spot, self.itinerary)

    @cached_property
    def orbit(self) -> Orbit:
        """The `Orbit` at the point. At a grazing an impact may have no speed."""
        return orbit_from_row(self.scene, self.spot)


class OrbitRows(ABC, Generic[SpecialType]):
    """A class of these has data, special and reasons; `NOUN`, what it is called; `located(place)`: (the scene at a
    point, its `OrbitPoint`); content: the bytes of its file."""

    data: xr.Dataset
    special: tuple[SpecialType, ...]
    reasons: tuple[str, str]
    NOUN: str
    located: Callable[[int], tuple[Scene, OrbitPoint]]

    @property
    @abstractmethod
    def content(self) -> bytes:
        """The bytes of the file that `save` writes."""

    def __len__(self) -> int:
        return self.data.sizes["point"]

    @property
    def reason(self) -> dict[str, str]:
        """Why each end is one: {"first": ..., "last": ...}."""
        return dict(zip(("first", "last"), self.reasons, strict=True))

    def points(self, kind: str) -> tuple[SpecialType, ...]:
        """The special points of a kind, a tuple."""
        return tuple(special for special in self.special if special.kind == kind)

    @property
    def multipliers(self) -> Complex[np.ndarray, "points 2"]:
        """Floquet's, (points, 2), complex, the larger first."""
        return self.data["multiplier_real"].values + 1j * self.data["multiplier_imag"].values

    def save(self, path: str | PathLike[str], force: bool = False) -> None:
        """Write the curve to a NetCDF file, from which `load_branch`, `load_held_branch` or `load_locus` reads the same
        numbers.

        Raises FileExistsError where the file is there already, unless force is given; OSError where it cannot be
        written; ArgumentError where the scene has a force without a name.
        """
        with atomic_file(path, force) as file:
            file.write(self.content)

    def orbit(self, place: int) -> Orbit:
        """The `Orbit` at one of the points, by its place.

        Raises ArgumentError for a place where there is none.
        """
        n_points = len(self)
        if not -n_points <= place < n_points:
            raise ArgumentError("place", f"must be a point of the {self.NOUN}, from 0 to {n_points - 1}", place)
        return orbit_from_row(*self.located(place))


def dataset_row(data, index):
    """The numbers of one point of a branch's, or locus', data, {name: array}."""
    return {name: variable.values[index] for name, variable in data.variables.items()}


def parse_orbit_row(row, name):
    """The `OrbitPoint` of a `dataset_row` a branch's data."""
    is_impact = row["side"] != 0
    impact_columns = (row[key][is_impact].astype(float) for key in ("time", "speed", "side"))
    state = (float(row[key][0]) for key in ("x", "v"))
    return OrbitPoint(float(row[name]), *impact_columns, len(row["x"]), *state, float(row["residual"]))
