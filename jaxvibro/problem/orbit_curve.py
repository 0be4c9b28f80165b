"""Base classes of branches and loci: orbits in the rows of a Dataset, special points, ends, and stability in words.

Compute the loads of impacts on walls: speeds and energies. A rigid wall takes the energy (1 - R^2) u^2 / 2 in the frame
of the wall, where u is the relative speed before the impact. Before the mass sticks, the impacts after the last
recorded impact take the remaining energy (R u)^2 / 2. Energies have the unit K length^2, and powers have the unit K
length^2 w0, where K is the stiffness of the spring and w0 is the natural frequency.
"""

import json
import re
from abc import ABC, abstractmethod
from collections.abc import Callable
from functools import cached_property
from os import PathLike
from typing import Generic, TypeVar

import msgspec
import numpy as np
import xarray as xr
from jaxtyping import Complex, Float

from .. import __version__
from ..maps.wall_loads import impact_energy_loss
from ..orbits.orbit import Orbit
from ..output.atomic_files import atomic_file
from ..output.checksums import netcdf_bytes
from ..output.units import unit_in_system, unit_of
from ..scene.check import ArgumentError
from ..scene.scene import Scene
from ..scene.scene_table import make_scene_table
from ..scene.state import Contact
from .curve_ends import End
from .orbit_point import OrbitPoint, label_of_point, make_orbit_point, orbit_from_point
from .orbit_problem import make_orbit_problem

SIDE_SIGNS = {"left": -1, "right": 1}


def largest_speed(sides, speeds):
    """Return the largest speed before an impact at each point.

    Parameters
    ----------
    sides : ndarray
        Sides as in the data of a branch, array of shape (points, impacts).
    speeds : ndarray
        Speeds relative to the wall, array of shape (points, impacts).

    Returns
    -------
    ndarray
        Array of shape (points,), 0 without impacts.
    """
    return np.max(speeds, axis=1, initial=0.0, where=_are_impacts(sides))


def work_rate(sides, speeds, restitutions, orbit_duration):
    """Return the mean power that the walls take at impacts, for each point.

    Parameters
    ----------
    sides : ndarray
        Sides as in the data of a branch, array of shape (points, impacts).
    speeds : ndarray
        Speeds relative to the wall, array of shape (points, impacts).
    restitutions : dict of str to ndarray
        Restitution of each wall, arrays of shape (points,), nan for soft walls.
    orbit_duration : ndarray
        Duration of each orbit, array of shape (points,).

    Returns
    -------
    ndarray
        Array of shape (points,), nan if an impact is on a soft wall, because the energy loss does not follow
        from the speed and the restitution.
    """
    restitution = np.zeros(sides.shape)
    for side, wall_sign in SIDE_SIGNS.items():
        if side in restitutions:
            restitution = np.where(np.sign(sides) == wall_sign, restitutions[side][:, None], restitution)
    return (
        np.where(_are_impacts(sides), impact_energy_loss(speeds, restitution, _are_last_impacts(sides)), 0.0).sum(
            axis=1
        )
        / orbit_duration
    )


def _are_impacts(sides):
    return abs(sides) == Contact.LANDED


def _are_last_impacts(sides):
    """Mark the last recorded impacts before the mass sticks."""
    is_last_before_sticking = np.zeros(sides.shape, bool)
    for side_pattern in np.unique(sides, axis=0):
        impact_column_indices = np.flatnonzero(side_pattern)
        last_impact_indices = impact_column_indices[
            abs(np.roll(side_pattern[impact_column_indices], -1)) >= Contact.STUCK
        ]
        is_last_before_sticking[np.ix_((sides == side_pattern).all(axis=1), last_impact_indices)] = True
    return is_last_before_sticking & _are_impacts(sides)


CIRCLE_TOLERANCE = 1e-6  # rounding of a multiplier that is on the unit circle at a special point
STABILITY_WORDS = ("stable", "neutral", "saddle", "flip saddle", "repelling")


def stability_words(multipliers):
    """Describe the stability of orbits in words.

    Parameters
    ----------
    multipliers : array_like
        Pairs of multipliers, array of shape (points, 2). Infinite multipliers, which occur at impacts with zero speed,
        count as outside the unit circle.

    Returns
    -------
    ndarray
        Array of shape (points,): ``"stable"``, ``"saddle"`` (only one multiplier outside the unit circle, above 1),
        ``"flip saddle"`` (only one outside, below -1), ``"repelling"`` (both outside) or ``"neutral"`` (no multiplier
        outside, at least one on the unit circle).
    """
    multiplier_pairs = np.asarray(multipliers)
    with np.errstate(invalid="ignore"):
        moduli = abs(multiplier_pairs)
    is_outside, is_on_circle = moduli > 1.0 + CIRCLE_TOLERANCE, abs(moduli - 1.0) <= CIRCLE_TOLERANCE
    has_flip_multiplier = (is_outside & (multiplier_pairs.real < 0)).any(axis=1)
    word_conditions = [
        is_outside.all(axis=1),
        is_outside.any(axis=1) & has_flip_multiplier,
        is_outside.any(axis=1),
        is_on_circle.any(axis=1),
    ]
    return np.select(word_conditions, ["repelling", "flip saddle", "saddle", "neutral"], "stable")


def stability_around(multipliers, point_index):
    """Describe the stability before and after a point of a branch, such as ``"saddle to stable"``.

    At the first and at the last point of the branch, the description is the stability of the orbit itself. If a
    multiplier of a neighbour is on the unit circle, the mean trace and determinant of the two points decide.

    Parameters
    ----------
    multipliers : array_like
        Pairs of multipliers along the branch, array of shape (points, 2).
    point_index : int
        Index of the point.

    Returns
    -------
    str
        Description of the stability.
    """
    multiplier_pairs = np.asarray(multipliers)
    if point_index in (0, len(multiplier_pairs) - 1):
        return str(stability_words(multiplier_pairs[point_index : point_index + 1])[0])
    return " to ".join(
        dict.fromkeys(
            _stability_between(multiplier_pairs, point_index, neighbour_index)
            for neighbour_index in (point_index - 1, point_index + 1)
        )
    )


def _stability_between(multiplier_pairs, point_index, neighbour_index):
    """Describe the stability between a point and its neighbour."""
    stability_word = str(stability_words(multiplier_pairs[neighbour_index : neighbour_index + 1])[0])
    if stability_word != "neutral" or not np.isfinite(multiplier_pairs[point_index]).all():
        return stability_word
    both_pairs = multiplier_pairs[[point_index, neighbour_index]]
    trace, determinant = both_pairs.sum(axis=1).real.mean(), both_pairs.prod(axis=1).real.mean()
    return str(stability_words(np.roots([1.0, -trace, determinant])[None])[0])


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


REASON_TEXTS = {
    End.BOUND: "{name} reached its bound {value:.12g}",
    End.DOMAIN: "the domain of {name} ends at {value:.12g}",
    End.CLOSED: "it closes: the curve came back to its start",
    End.STEP: "the step became too small: Newton's method does not converge there",
    End.GRAZE: "an impact loses its speed there, a flight touches a wall, or a rest ends",
    End.POINTS: "it has too many points",
    End.MAX_POINTS: "max_points reached",
    End.MAX_SECONDS: "max_seconds reached",
}


class PlaneCurve(OrbitCurve[SpecialType]):
    """Base class of curves in the plane of two parameters.

    Attributes
    ----------
    names : tuple of str
        Names of the two parameters.
    bounds : dict of str to tuple of float
        Bounds of each parameter.
    scene : Scene
        Scene at the start.
    """

    names: tuple[str, str]
    bounds: dict[str, tuple[float, float]]
    scene: Scene

    @property
    def values(self) -> Float[np.ndarray, "points 2"]:
        """Values of the two parameters at each point, array of shape (points, 2)."""
        return np.stack([self.data[name].values for name in self.names], axis=1)

    @property
    @abstractmethod
    def label(self) -> str:
        """Label P n p q of the orbits."""

    def located(self, place: int) -> tuple[Scene, OrbitPoint]:
        """Return the scene and the orbit at a point.

        Parameters
        ----------
        place : int
            Index of the point.

        Returns
        -------
        scene : Scene
            Scene with the values of the two parameters at the point.
        orbit_point : OrbitPoint
            The orbit.
        """
        row = dataset_row(self.data, place)
        scene = self.scene.replace(**{name: float(row[name]) for name in self.names})
        return scene, point_of_plane_row(scene, self.names[0], self.data, row)

    def _file_content(self, title, own_attributes, further_attributes):
        """Return the bytes of the file that `save` writes, with attributes of the class in two places."""
        attributes = {
            "title": title,
            "source": f"jaxvibro {__version__}",
            **own_attributes,
            "bounds": json.dumps({name: self.bounds[name] for name in self.names}),
            "scene": msgspec.toml.encode(make_scene_table(self.scene)).decode(),
            **further_attributes,
            "reasons": json.dumps(self.reasons),
        }
        return netcdf_bytes(self.data.assign_attrs(attributes))

    def _end_lines(self, units):
        """Return the lines of a table that state the reasons for the ends."""
        unit_factors = {name: unit_in_system(self.scene, unit_of(name), units)[1] for name in self.names}
        return [f"{end_name} point: {rescale_end_text(text, unit_factors)}" for end_name, text in self.reason.items()]


def point_of_plane_row(scene, name, data, row):
    """Return the orbit of one point of a curve, as an orbit along its first parameter.

    Parameters
    ----------
    scene : Scene
        Scene at the point.
    name : str
        First parameter.
    data : xarray.Dataset
        Data of the curve.
    row : dict of str to ndarray
        Entries from `dataset_row`.

    Returns
    -------
    OrbitPoint
        The orbit.
    """
    periods = len(row["x"]) if "x" in row else data.attrs["periods"]
    return parse_orbit_point(make_orbit_problem(scene, name, periods=1), name, row, periods)


def describe_segment_end(segment, names):
    """Describe the end of a segment of a curve in the plane of two parameters.

    Parameters
    ----------
    segment : BranchSegment
        Segment, whose end is an `End`.
    names : tuple of str
        Names of the two parameters.

    Returns
    -------
    str
        Text for display.
    """
    reason_text = REASON_TEXTS.get(segment.end, REASON_TEXTS[End.STEP])
    return reason_text.format(name=names[segment.end_param_index], value=segment.end_value)


def rescale_end_text(text: str, unit_factors: dict[str, float]) -> str:
    """Convert the parameter value in a text to another unit.

    Parameters
    ----------
    text : str
        Text from `describe_segment_end`.
    unit_factors : dict of str to float
        For each parameter the value of the old unit in the new unit.

    Returns
    -------
    str
        Text with the value multiplied by the factor of the parameter.
    """
    text_match = re.fullmatch(r"(?:the domain of )?(\S+) (?:reached its bound|ends at) (\S+)", text)
    unit_factor = unit_factors.get(text_match[1], 1.0) if text_match else 1.0
    return (
        f"{text[: text_match.start(2)]}{float(text_match[2]) * unit_factor:.12g}"
        if text_match and unit_factor != 1.0
        else text
    )
