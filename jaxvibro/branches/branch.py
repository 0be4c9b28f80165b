"""Branches of periodic orbits along one parameter, their tables and their special points."""

import json
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import jax
import jax.numpy as jnp
import msgspec
import numpy as np
import pandas as pd
import xarray as xr
from jaxtyping import Bool, Complex, Float

from .. import __version__
from ..orbits.orbit import Orbit
from ..output.checksums import netcdf_bytes
from ..output.dataframes import make_dataframe, multiplier_columns, special_kind_per_point, speed_clearance_columns
from ..output.label_codes import translate_label
from ..output.table_text import align_columns, column_header, multipliers_text
from ..output.units import LENGTH, POWER, SPEED, unit_in_system, unit_of
from ..problem import orbit_curve
from ..problem.curve_ends import End, rescale_reason_text
from ..problem.orbit_curve import OrbitCurve, SpecialOrbit, dataset_row, parse_orbit_point
from ..problem.orbit_point import OrbitPoint, label_of_point, orbit_from_point
from ..problem.orbit_problem import make_orbit_problem
from ..scene.scene import Scene, map_scene_numbers, replace_unchecked
from ..scene.scene_table import make_scene_table
from . import normal_form as forms
from .branch_curves import Curves, make_curves
from .normal_form import NormalForm


def orbit_columns(scene, values_by_parameter, data, labels, multipliers):
    """Return ``{column: (unit, values)}`` of orbits.

    `values_by_parameter` maps parameters to arrays of shape (points,). `data` is the dataset of a branch. `labels` has
    the shape (points,), and `multipliers` has the shape (points, 2)."""
    sides, speeds, minimum_columns = data["side"].values, data["speed"].values, speed_clearance_columns(data)
    return {
        **{name: (unit_of(name), parameter_values) for name, parameter_values in values_by_parameter.items()},
        "label": ("", labels),
        "stability": ("", orbit_curve.stability_words(multipliers)),
        "x": (LENGTH, data["x"].values[:, 0]),
        "v": (SPEED, data["v"].values[:, 0]),
        "least_speed": minimum_columns["least_speed"],
        "largest_speed": (SPEED, orbit_curve.largest_speed(sides, speeds)),
        "least_clearance": minimum_columns["least_clearance"],
        "work_rate": (
            POWER,
            orbit_curve.work_rate(sides, speeds, *_work_rate_arguments(scene, values_by_parameter, data)),
        ),
        **multiplier_columns(multipliers),
    }


def _work_rate_arguments(scene, values_by_parameter, data):
    """Return the restitution of each wall at each point, nan if soft, and the duration of each orbit."""
    scenes, n_points = replace_unchecked(scene, values_by_parameter), data.sizes["point"]
    restitutions_by_wall = {
        side: np.broadcast_to(np.nan if wall.soft else scenes.parameter(f"{side}.restitution"), n_points)
        for side, wall in scenes.walls.items()
    }
    periods = np.isfinite(data["x"].values).sum(axis=1)
    return restitutions_by_wall, 2.0 * np.pi * periods / np.broadcast_to(scenes.frequency, n_points)


STEP_SETTINGS = ("first_step", "largest_step", "tolerance")  # settings that are saved

KIND_NAMES = {
    "SN": "saddle-node",
    "SB": "symmetry breaking",
    "BP": "branch point",
    "PD": "period doubling",
    "NS": "Neimark-Sacker point",
    "NSA": "neutral saddle",
    "R3": "1:3 resonance",
    "R4": "1:4 resonance",
    "GR": "grazing",
    "CH": "complete chatter",
    "RL": "release while sticking",
    "EP": "end",
}


@dataclass(frozen=True)
class Segment:
    """Part of a branch with one itinerary.

    The words of the itinerary change within a segment where an impact crosses phase 0. The order of the walls is
    constant.

    Attributes
    ----------
    first, last : int
        Indices of the first and the last point of the segment.
    label : str
        Label P n p q of the orbits, as in `Orbit.label`.
    itinerary : tuple of str
        Walls hit by the orbit of the first point, one word for each drive period.
    """

    first: int
    last: int
    label: str
    itinerary: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Special(SpecialOrbit):
    """Special point of a branch.

    Attributes
    ----------
    kind : str
        ``"SN"`` (saddle-node), ``"SB"`` (symmetry breaking), ``"BP"`` (other branch point), ``"PD"`` (period doubling),
        ``"NS"`` (Neimark-Sacker), ``"NSA"`` (neutral saddle, not a bifurcation), ``"R3"`` and ``"R4"`` (resonances 1:3
        and 1:4), ``"GR"`` (grazing), ``"CH"`` (complete chatter), ``"RL"`` (release inside an orbit that sticks),
        ``"EP"`` (end), or the label of a monitor.
    name : str
        Name of the parameter.
    value : float
        Value of the parameter.
    bounds : tuple of float
        Bounds of the branch.
    scene : Scene
        Scene at `value`.
    itinerary : tuple of str
        Walls hit, one word for each drive period.
    multipliers : ndarray
        Floquet multipliers, complex array of shape (2,), the larger first. Infinite at an impact with zero speed.
    residual : float
        Largest residual of the equations of the point.
    place : int
        Index among the points of the branch.
    spot : OrbitPoint
        The orbit, with the tangent of the branch.
    joins : tuple of OrbitPoint
        At a GR, CH or RL, one orbit close to the point on each branch that emanates from the point; else empty.
    aside : tuple of bool
        True for each entry of `joins` along which the branch does not continue.
    saved : NormalForm or None
        Normal form read from a file.

    Examples
    --------
    >>> special = branch.points("GR")[0]
    >>> special.kind, special.name, special.label
    ('GR', 'amplitude', 'P111')
    """

    kind: str
    name: str
    value: float
    bounds: tuple[float, float]
    scene: Scene = field(repr=False)
    itinerary: tuple[str, ...]
    multipliers: Complex[np.ndarray, "2"]
    residual: float
    place: int
    spot: OrbitPoint = field(repr=False)
    joins: tuple[OrbitPoint, ...] = field(repr=False)
    aside: tuple[bool, ...] = field(repr=False)
    saved: NormalForm | None = field(repr=False, default=None)

    @property
    def slopes(self) -> Float[np.ndarray, " unknowns"]:
        """Unit tangent of the branch: times, speeds and parameter, array of shape (2 * impacts + 1,)."""
        tangent = np.asarray(self.spot.tangent)
        time_slopes, speed_slopes, _ = self.spot.problem.impacts(tangent)
        return np.concatenate([time_slopes, speed_slopes, tangent[-1:]])

    @cached_property
    def normal_form(self) -> NormalForm | None:
        """Normal form of an SN, PD, SB or GR.

        The normal form gives the side of the parameter on which the orbits that meet at the point exist, and the
        consequence for a stable motion. The value is None for other kinds, for orbits without impacts except at a GR,
        and if the linear equations of the computation are singular.
        """
        form_arguments = self.kind, self.scene, self.spot, self.multipliers, self.joins
        return self.saved or forms.make_normal_form(*form_arguments)

    @cached_property
    def meets(self) -> tuple[Orbit, ...]:
        """Orbits close to a GR, CH or RL, one `Orbit` for each branch that emanates from the point."""
        return tuple(
            orbit_from_point(self.scene.replace(**{self.name: neighbour.value}), neighbour) for neighbour in self.joins
        )


@dataclass(frozen=True, eq=False)
class Branch(OrbitCurve[Special]):
    """Branch of periodic orbits.

    Attributes
    ----------
    name : str
        Name of the parameter.
    bounds : tuple of float
        Lower and upper bound of the parameter.
    scene : Scene
        Scene at the start.
    data : xarray.Dataset
        One row per point, in order along the branch. `follow` describes the columns.
    segments : tuple of Segment
        Parts with one itinerary.
    special : tuple of Special
        Special points, in order along the branch.
    reasons : tuple of str
        Reasons for the ends at the first and at the last point.
    settings : dict
        Step lengths, tolerance, monitors and stops.
    ends : tuple of End
        Kinds of the two ends.

    See Also
    --------
    follow : Continue a periodic orbit in one parameter.

    Examples
    --------
    >>> branch.name, branch.bounds
    ('amplitude', (0.0, 6.0))
    >>> [special.kind for special in branch.special]
    ['EP', 'GR', 'SN', 'SB', 'EP']
    """

    name: str
    bounds: tuple[float, float]
    scene: Scene = field(repr=False)
    data: xr.Dataset = field(repr=False)
    segments: tuple[Segment, ...]
    special: tuple[Special, ...]
    reasons: tuple[str, str]
    settings: dict[str, Any]
    ends: tuple[End, End]

    NOUN = "branch"

    def __repr__(self):
        kinds = " ".join(special.kind for special in self.special)
        return f"Branch({self.name} {describe_extent(self, digits=6)}, {len(self)} points, {kinds})"

    @property
    def values(self) -> Float[np.ndarray, " points"]:
        """Value of the parameter at each point, array of shape (points,)."""
        return self.data[self.name].values

    @property
    def stable(self) -> Bool[np.ndarray, " points"]:
        """True at each point with a stable orbit, boolean array of shape (points,)."""
        return self.data["stable"].values.astype(bool)

    def located(self, place: int) -> tuple[Scene, OrbitPoint]:
        """Return the scene and the orbit at a point.

        Parameters
        ----------
        place : int
            Index of the point.

        Returns
        -------
        scene : Scene
            Scene at the point.
        orbit_point : OrbitPoint
            The orbit.
        """
        orbit_point = branch_point(self, place)
        return scene_at_value(self.scene, self.name, orbit_point.value), orbit_point

    @property
    def content(self) -> bytes:
        """Bytes of the file that `save` writes."""
        special_entries = [
            [
                entry.kind,
                entry.place,
                entry.residual,
                [_orbit_as_list(neighbour) for neighbour in entry.joins],
                entry.aside,
            ]
            for entry in self.special
        ]
        attrs = {
            "title": "jaxvibro branch",
            "source": f"jaxvibro {__version__}",
            "parameter": self.name,
            "bounds": list(self.bounds),
            "scene": msgspec.toml.encode(make_scene_table(self.scene)).decode(),
            "special": json.dumps(special_entries),
            "normal_forms": json.dumps([forms.normal_form_fields(entry.normal_form) for entry in self.special]),
            "segments": json.dumps(
                [[entry.first, entry.last, entry.label, entry.itinerary] for entry in self.segments]
            ),
            "reasons": json.dumps(self.reasons),
            "ends": json.dumps([entry.name for entry in self.ends]),
            "settings": json.dumps({key: self.settings[key] for key in STEP_SETTINGS}),
        }
        return netcdf_bytes(self.data.assign_attrs(attrs))

    def table(self, units: str = "scene", labels: str = "jaxvibro") -> str:
        """Format the special points and the reasons for the ends.

        The column ``stability`` describes the orbits before and after each point.

        Parameters
        ----------
        units : {"scene", "physical"}, optional
            Unit system. ``"physical"`` (Hz, N, mm, ...) needs a scene with scales.
        labels : {"jaxvibro", "auto", "matcont"}, optional
            Names of the kinds: those of this project, of AUTO-07p or of MatCont.

        Returns
        -------
        str
            One line per special point, then the reason for each end.

        Raises
        ------
        ArgumentError
            If `units` or `labels` is unknown, or the scene has no scales.

        Examples
        --------
        >>> print(branch.table().splitlines()[0].split()[:3])
        ['kind', 'amplitude', 'orbit']
        """
        parameter_unit, unit_factor = unit_in_system(self.scene, unit_of(self.name), units)
        parameter_header = column_header(self.name, parameter_unit, units)
        rows = [
            (
                "kind",
                parameter_header,
                "orbit",
                "stability",
                "itinerary",
                "multipliers",
                "meets",
                "consequence",
                "normal form",
            )
        ]
        multipliers = self.multipliers
        for special in self.special:
            itinerary_text = " ".join(word or "." for word in special.itinerary)
            kind, value, stability_text = (
                translate_label(special.kind, labels),
                special.value * unit_factor,
                orbit_curve.stability_around(multipliers, special.place),
            )
            neighbours = " ".join(neighbour_labels(special)) or "-"
            point_cells = (
                kind,
                f"{value:.12g}",
                special.label,
                stability_text,
                itinerary_text,
                multipliers_text(special.multipliers),
                neighbours,
            )
            normal_form = special.normal_form
            rows.append((*point_cells, *((normal_form.consequence, str(normal_form)) if normal_form else ("-", "-"))))
        end_lines = [
            f"{end_name} point: {reason_text if unit_factor == 1.0 else rescale_reason_text(reason_text, unit_factor)}"
            for end_name, reason_text in self.reason.items()
        ]
        return "\n".join([align_columns(rows), *end_lines])

    def to_frame(self, units: str = "scene") -> pd.DataFrame:
        """Convert the points to a pandas DataFrame.

        Parameters
        ----------
        units : {"scene", "physical"}, optional
            Unit system. ``"physical"`` (Hz, N, mm, m/s, W) needs a scene with scales. The units are then part of the
            column names.

        Returns
        -------
        pandas.DataFrame
            One row per point: kind of the special point if the point is one, parameter, label of the orbit, stability
            in words, x and v at phase 0, least and largest speed before an impact, least clearance, mean power that
            impacts at rigid walls dissipate, and multipliers.

        Raises
        ------
        ArgumentError
            If `units` is unknown, or the scene has no scales.

        Examples
        --------
        >>> list(branch.to_frame().columns[:4])
        ['kind', 'amplitude', 'label', 'stability']
        """
        labels = np.repeat(
            [segment.label for segment in self.segments],
            [segment.last - segment.first + 1 for segment in self.segments],
        )
        columns = orbit_columns(self.scene, {self.name: self.values}, self.data, labels, self.multipliers)
        return make_dataframe(
            self.scene, {"kind": ("", special_kind_per_point(self.special, len(self))), **columns}, units
        )

    def curves(self, variable: str = "x") -> Curves:
        """Return one variable along the branch as arrays for plotting.

        Lines of ``"x"`` and ``"v"`` break where an impact crosses phase 0, because the velocity at phase 0 jumps there
        although the branch continues. Each line also breaks where the itinerary changes and the variable jumps.

        Parameters
        ----------
        variable : {"x", "v", "clearance", "speed", "least_speed", "peak"}, optional
            ``"x"`` and ``"v"`` at phase 0 of each drive period, one column per period. The others have one column:
            the least clearance, the largest and the least speed before an impact, and the largest ``|x|``.

        Returns
        -------
        Curves
            Stable and unstable pieces, and the special points.

        Raises
        ------
        ArgumentError
            If `variable` is unknown.

        Examples
        --------
        >>> curves = branch.curves("x")
        >>> curves.pieces[0].columns.shape[1]
        1
        """
        return make_curves(self, variable)


def end_values(branch):
    """Return the parameter values at the ends of a branch.

    Parameters
    ----------
    branch : Branch
        Branch.

    Returns
    -------
    tuple of float
        First and last value; the least and the largest value of a closed branch.
    """
    values = branch.values
    return (values.min(), values.max()) if End.CLOSED in branch.ends else (values[0], values[-1])


def describe_extent(branch, unit_factor=1.0, digits=12):
    """Describe the parameter values of a branch as a text.

    The text gives the range of a closed branch. For other branches the text gives the first and the last value, and
    also the range if the range is wider.

    Parameters
    ----------
    branch : Branch
        Branch.
    unit_factor : float, optional
        Factor from the unit of the scene to the unit of the text.
    digits : int, optional
        Number of significant digits.

    Returns
    -------
    str
        Description, such as ``"from 2 to 6"``.
    """
    values = unit_factor * branch.values
    first_value, last_value, lower, upper = (
        f"{value:.{digits}g}" for value in (values[0], values[-1], values.min(), values.max())
    )
    if End.CLOSED in branch.ends:
        return f"closed, between {lower} and {upper}"
    return f"from {first_value} to {last_value}" + (
        f", between {lower} and {upper}" if {lower, upper} != {first_value, last_value} else ""
    )


def _orbit_as_list(orbit_point):
    """Convert an `OrbitPoint` to a list of plain numbers, as a file holds it."""
    impact_columns = [column.tolist() for column in orbit_point.problem.impacts(orbit_point.z)]
    state_and_residual = orbit_point.x, orbit_point.v, orbit_point.residual
    return [orbit_point.value, *impact_columns, orbit_point.periods, *state_and_residual]


def neighbour_labels(special):
    """Label the orbits that meet at a special point.

    Parameters
    ----------
    special : Special
        Special point.

    Returns
    -------
    list of str
        Label of each orbit, followed by ``">"`` or ``"<"`` for the side of the parameter on which the orbit lies.
    """
    labels = []
    for neighbour in special.joins:
        side_symbol = ">" if neighbour.value > special.value else "<"
        labels.append(label_of_point(special.scene, neighbour, neighbour.itinerary) + side_symbol)
    return labels


def scene_at_value(scene, name, value):
    """Return the scene at a parameter value of a branch without checking the value again.

    Parameters
    ----------
    scene : Scene
        Scene.
    name : str
        Name of the parameter.
    value : float
        Value of the parameter.

    Returns
    -------
    Scene
        Scene with this value.
    """
    changed_scene = replace_unchecked(scene, {name: value})
    return map_scene_numbers(
        lambda leaf: leaf if isinstance(leaf, jax.Array) else jnp.asarray(np.asarray(leaf, scene.dtype)), changed_scene
    )


def branch_point(branch, place):
    """Return the `OrbitPoint` of one point of a branch.

    Parameters
    ----------
    branch : Branch
        Branch.
    place : int
        Index of the point.

    Returns
    -------
    OrbitPoint
        The orbit, with the tangent of the branch.
    """
    template = make_orbit_problem(branch.scene, branch.name, periods=1)
    return point_of_row(template, branch.name, dataset_row(branch.data, place))


def point_of_row(problem, name, row):
    """Return the orbit of one point of a branch.

    Parameters
    ----------
    problem : OrbitProblem
        Problem of an orbit without impacts of the branch.
    name : str
        Parameter of the branch.
    row : dict of str to ndarray
        Entries from `dataset_row`.

    Returns
    -------
    OrbitPoint
        The orbit, with the tangent of the branch.
    """
    is_impact = row["side"] != 0
    tangent = np.concatenate([row["time_slope"][is_impact], row["speed_slope"][is_impact], [row["value_slope"]]])
    return parse_orbit_point(problem, name, row, len(row["x"]), tangent)


def multipliers_of_row(row):
    """Return the multipliers of one point of a branch from the entries of `dataset_row`."""
    return row["multiplier_real"] + 1j * row["multiplier_imag"]


def make_special(
    scene, name, bounds, place, orbit_point, multipliers, kind, residual, neighbours=(), is_not_followed=(), form=None
):
    """Make the `Special` at an orbit of a branch.

    Parameters
    ----------
    scene : Scene
        Scene of the branch.
    name : str
        Parameter of the branch.
    bounds : tuple of float
        Bounds of the branch.
    place : int
        Index among the points of the branch.
    orbit_point : OrbitPoint
        The orbit.
    multipliers : ndarray
        Floquet multipliers.
    kind : str
        Kind of the point.
    residual : float
        Largest residual of the equations of the point.
    neighbours : sequence of OrbitPoint, optional
        Orbits on the branches that emanate from the point.
    is_not_followed : sequence of bool, optional
        True for each neighbour along which the branch does not continue.
    form : NormalForm, optional
        Normal form read from a file.

    Returns
    -------
    Special
        The special point.
    """
    return Special(
        kind,
        name,
        orbit_point.value,
        bounds,
        scene_at_value(scene, name, orbit_point.value),
        orbit_point.itinerary,
        multipliers,
        residual,
        place,
        orbit_point,
        tuple(neighbours),
        tuple(is_not_followed),
        form,
    )
