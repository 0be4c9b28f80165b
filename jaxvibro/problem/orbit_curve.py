"""Base classes of branches and loci: orbits in the rows of a Dataset, special points, and two ends."""

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
from .orbit_conversion import orbit_from_point
from .orbit_point import OrbitPoint, label_of_point, make_orbit_point

SpecialType = TypeVar("SpecialType", bound="SpecialOrbit")  # class of the special points of a curve


class SpecialOrbit:
    """Base class of special points of a curve, which have a scene, an orbit and an itinerary.

    Attributes
    ----------
    kind : str
        Kind of the point.
    scene : Scene
        Scene at the point.
    spot : OrbitPoint
        The orbit.
    itinerary : tuple of str
        Walls hit, one word for each drive period.
    """

    kind: str
    scene: Scene
    spot: OrbitPoint
    itinerary: tuple[str, ...]

    @property
    def label(self) -> str:
        """Label P n p q of the orbit."""
        return label_of_point(self.scene, self.spot, self.itinerary)

    @cached_property
    def orbit(self) -> Orbit:
        """`Orbit` at the point. At a grazing an impact may have zero speed."""
        return orbit_from_point(self.scene, self.spot)


class OrbitCurve(ABC, Generic[SpecialType]):
    """Base class of curves of orbits.

    Subclasses define ``NOUN``, the word for the curve in messages; ``located(place)``, which returns the scene and the
    `OrbitPoint` of a point; and `content`.

    Attributes
    ----------
    data : xarray.Dataset
        One row per point.
    special : tuple
        Special points.
    reasons : tuple of str
        Reasons for the ends at the first and at the last point.
    """

    data: xr.Dataset
    special: tuple[SpecialType, ...]
    reasons: tuple[str, str]
    NOUN: str
    located: Callable[[int], tuple[Scene, OrbitPoint]]

    @property
    @abstractmethod
    def content(self) -> bytes:
        """Bytes of the file that `save` writes."""

    def __len__(self) -> int:
        return self.data.sizes["point"]

    @property
    def reason(self) -> dict[str, str]:
        """Reasons for the ends, ``{"first": ..., "last": ...}``."""
        return dict(zip(("first", "last"), self.reasons, strict=True))

    def points(self, kind: str) -> tuple[SpecialType, ...]:
        """Return the special points of a kind.

        Parameters
        ----------
        kind : str
            Kind, such as ``"PD"``.

        Returns
        -------
        tuple
            Special points, in order.
        """
        return tuple(special_point for special_point in self.special if special_point.kind == kind)

    @property
    def multipliers(self) -> Complex[np.ndarray, "points 2"]:
        """Floquet multipliers, complex array of shape (points, 2), the larger first."""
        return self.data["multiplier_real"].values + 1j * self.data["multiplier_imag"].values

    def save(self, path: str | PathLike[str], force: bool = False) -> None:
        """Write the curve to a NetCDF file.

        `load_branch`, `load_held_branch` and `load_locus` read the file without loss of digits.

        Parameters
        ----------
        path : str or path-like
            File name.
        force : bool, optional
            Replace an existing file.

        Raises
        ------
        FileExistsError
            If the file exists and `force` is False.
        OSError
            If the file cannot be written.
        ArgumentError
            If the scene has a force without a name.
        """
        with atomic_file(path, force) as file:
            file.write(self.content)

    def orbit(self, place: int) -> Orbit:
        """Return the orbit at a point.

        Parameters
        ----------
        place : int
            Index of the point. Negative indices count from the end.

        Returns
        -------
        Orbit
            The orbit.

        Raises
        ------
        ArgumentError
            If there is no such point.
        """
        n_points = len(self)
        if not -n_points <= place < n_points:
            raise ArgumentError("place", f"must be a point of the {self.NOUN}, from 0 to {n_points - 1}", place)
        return orbit_from_point(*self.located(place))


def dataset_row(curve_data, point_index):
    """Return the entries of one point in the data of a branch or a locus.

    Parameters
    ----------
    curve_data : xarray.Dataset
        Data of the curve.
    point_index : int
        Index of the point.

    Returns
    -------
    dict of str to ndarray
        Entries, by the name of the column.
    """
    return {column_name: column.values[point_index] for column_name, column in curve_data.variables.items()}


def parse_orbit_point(problem, name, point_entries, periods, tangent=None):
    """Return the orbit of one point of a branch or a locus.

    Parameters
    ----------
    problem : OrbitProblem
        Problem of an orbit without impacts of the same curve.
    name : str
        Its parameter.
    point_entries : dict of str to ndarray
        Entries from `dataset_row`.
    periods : int
        Number of drive periods.
    tangent : ndarray, optional
        Tangent, as `make_orbit_point` takes it.

    Returns
    -------
    OrbitPoint
        The orbit.
    """
    is_impact = point_entries["side"] != 0
    impact_columns = (point_entries[key][is_impact].astype(float) for key in ("time", "speed", "side"))
    state = tuple(float(point_entries[key][0]) if key in point_entries else np.nan for key in ("x", "v"))
    value, residual = float(point_entries[name]), float(point_entries["residual"])
    impacts = list(zip(*impact_columns, strict=True))
    return make_orbit_point(problem, value, impacts, periods, state, residual, tangent)


def unknowns_of_rows(curve_data, name, problem):
    """Return the unknowns of orbits with one itinerary.

    Parameters
    ----------
    curve_data : xarray.Dataset
        Data of the points.
    name : str
        Parameter of the orbits.
    problem : OrbitProblem
        Problem of the orbits.

    Returns
    -------
    ndarray
        Unknowns, array of shape (points, unknowns).
    """
    n_rows, n_impacts = problem.n_rows, problem.n_used_rows
    zs = np.zeros((curve_data.sizes["point"], problem.n_orbit_unknowns + 1))
    zs[:, -1] = curve_data[name].values
    if not n_rows:
        zs[:, 0], zs[:, 1] = curve_data["x"].values[:, 0], curve_data["v"].values[:, 0]
        return zs
    is_impact = curve_data["side"].values[0] != 0
    zs[:, :n_impacts] = curve_data["time"].values[:, is_impact]
    zs[:, n_rows : n_rows + n_impacts] = curve_data["speed"].values[:, is_impact]
    return zs
