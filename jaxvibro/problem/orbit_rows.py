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
from ..output.atomic_write import whole
from ..scene.check import ArgumentError
from ..scene.scene import Scene
from .orbit_on_branch import OrbitPoint, described_orbit, label_of

Found = TypeVar("Found", bound="SpecialOrbit")  # the class of a curve's special points


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
        return described_orbit(self.scene, self.spot)


class OrbitRows(ABC, Generic[Found]):
    """A class of these has data, special and reasons; `NOUN`, what it is called; `located(place)`: (the scene at a
    point, its `OrbitPoint`); content: the bytes of its file."""

    data: xr.Dataset
    special: tuple[Found, ...]
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

    def points(self, kind: str) -> tuple[Found, ...]:
        """The special points of a kind, a tuple."""
        return tuple(one for one in self.special if one.kind == kind)

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
        with whole(path, force) as file:
            file.write(self.content)

    def orbit(self, place: int) -> Orbit:
        """The `Orbit` at one of the points, by its place.

        Raises ArgumentError for a place where there is none.
        """
        count = len(self)
        if not -count <= place < count:
            raise ArgumentError("place", f"must be a point of the {self.NOUN}, from 0 to {count - 1}", place)
        return described_orbit(*self.located(place))


def row_of(data, place):
    """The numbers of one point of a branch's, or locus', data, {name: array}."""
    return {name: each.values[place] for name, each in data.variables.items()}


def spot_of(row, name):
    """The `OrbitPoint` of a `row_of` a branch's data."""
    hit = row["side"] != 0
    columns = (row[key][hit].astype(float) for key in ("time", "speed", "side"))
    plain = (float(row[key][0]) for key in ("x", "v"))
    return OrbitPoint(float(row[name]), *columns, len(row["x"]), *plain, float(row["residual"]))
