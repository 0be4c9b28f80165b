"""A branch of periodic orbits along a parameter, and the special points on it."""

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
from ..output.dataframes import make_dataframe, special_kinds
from ..output.labels import translate_label
from ..output.table_text import align_columns, column_header, multipliers_text
from ..output.units import unit_in_system, unit_of
from ..problem import stability
from ..problem.end import End, rescale_reason
from ..problem.orbit_point import OrbitPoint, itinerary, label_of, orbit_from_row
from ..problem.orbit_rows import OrbitRows, SpecialOrbit, dataset_row, parse_orbit_row
from ..scene.scene import Scene, map_numbers, replace_unchecked
from ..scene.scene_table import make_scene_table
from . import normal_form as forms
from .curves import Curves, make_curves
from .normal_form import NormalForm
from .orbit_columns import orbit_columns

STEP_SETTINGS = ("first_step", "largest_step", "tolerance")  # of the settings

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
    "CH": "rest after chatter",
    "RL": "release within a rest",
    "EP": "end",
}


@dataclass(frozen=True)
class Segment:
    """A stretch of a branch with one itinerary. first, last: the places of its points; label; itinerary: at its first
    point, a word a period (where an impact crosses phase 0 the words change, not the order of the walls)."""

    first: int
    last: int
    label: str
    itinerary: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Special(SpecialOrbit):
    """A special point of a branch.

    kind: SN, SB (symmetry breaking), BP (other branch point), PD, NS (Neimark-Sacker), NSA (neutral saddle), R3, R4
    (resonances 1:3, 1:4), GR, CH (a chatter just ends in rest), RL (a wall lets go within a rest), EP (end), or a
    monitor's name. name, value: of
    the parameter. bounds: of the branch. scene: at the value. itinerary: the walls hit, a word a period. multipliers:
    the larger first, infinite at an impact without speed. residual: the largest error left in the point's equations.
    place: among the branch's points. spot: the orbit in plain numbers; slopes: its unit tangent (times, speeds, the
    parameter); joins: spots of the orbits that meet at a GR, a little on; aside: which of them the branch does not go
    on with.
    saved: the normal form as a file had it.
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
    slopes: Float[np.ndarray, " unknowns"] = field(repr=False)
    joins: tuple[OrbitPoint, ...] = field(repr=False)
    aside: tuple[bool, ...] = field(repr=False)
    saved: NormalForm | None = field(repr=False, default=None)

    @cached_property
    def normal_form(self) -> NormalForm | None:
        """The `NormalForm` of an SN, PD, SB or GR: on which side the others are, and the consequence. None of other
        kinds, of an orbit without impacts but at a GR, and where the equations are too singular to say."""
        arguments = self.kind, self.name, self.scene, self.spot, self.multipliers, self.joins
        return self.saved or forms.make_normal_form(*arguments)

    @cached_property
    def meets(self) -> tuple[Orbit, ...]:
        """The `Orbit`s that meet at a GR, each a little on from it, one for every branch that leaves the point."""
        return tuple(
            orbit_from_row(self.scene.replace(**{self.name: neighbour.value}), neighbour) for neighbour in self.joins
        )


@dataclass(frozen=True, eq=False)
class Branch(OrbitRows[Special]):
    """A branch of periodic orbits.

    name: the parameter; bounds: of it; scene: at the start; data: an xarray.Dataset with a row a point, in order along
    the branch (see `jaxvibro.follow`); segments: stretches of one itinerary; special: special points in order; reasons:
    why it ends, at its first and at its last point; settings: steps and tolerance; ends: the `End` of each reason.
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
        """The parameter's value at each point, (points,)."""
        return self.data[self.name].values

    @property
    def stable(self) -> Bool[np.ndarray, " points"]:
        """Whether each point's orbit is stable, (points,)."""
        return self.data["stable"].values.astype(bool)

    def located(self, place: int) -> tuple[Scene, OrbitPoint]:
        """(the scene at a point, its `OrbitPoint`)."""
        orbit_row = parse_orbit_row(dataset_row(self.data, place), self.name)
        return scene_at_value(self.scene, self.name, orbit_row.value), orbit_row

    @property
    def content(self) -> bytes:
        """The bytes of the file that `save` writes."""
        special_entries = [
            [
                entry.kind,
                entry.place,
                entry.residual,
                [_plain_values(neighbour) for neighbour in entry.joins],
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
        """The special points as a text, a line each, and why the branch ends.

        units: "scene", or "physical" (Hz, N, mm, ...) of a scene that has scales; labels: what kinds are called,
        "jaxvibro", "auto" (AUTO-07p) or "matcont". stability: of the orbits before and after the point.

        Raises ArgumentError for other units and labels, and where the scene has no scales.
        """
        unit, factor = unit_in_system(self.scene, unit_of(self.name), units)
        header = column_header(self.name, unit, units)
        rows = [
            ("kind", header, "orbit", "stability", "itinerary", "multipliers", "meets", "consequence", "normal form")
        ]
        multipliers = self.multipliers
        for special in self.special:
            itinerary_text = " ".join(word or "." for word in special.itinerary)
            kind, value, stability_text = (
                translate_label(special.kind, labels),
                special.value * factor,
                stability.stability_around(multipliers, special.place),
            )
            neighbours = " ".join(neighbour_labels(special)) or "-"
            point_columns = (
                kind,
                f"{value:.12g}",
                special.label,
                stability_text,
                itinerary_text,
                multipliers_text(special.multipliers),
                neighbours,
            )
            form = special.normal_form
            rows.append((*point_columns, *((form.consequence, str(form)) if form else ("-", "-"))))
        end_lines = [
            f"{end_name} point: {reason_text if factor == 1.0 else rescale_reason(reason_text, factor)}"
            for end_name, reason_text in self.reason.items()
        ]
        return "\n".join([align_columns(rows), *end_lines])

    def to_frame(self, units: str = "scene") -> pd.DataFrame:
        """A row a point, a pandas.DataFrame: kind of the special point there, if it is one, the parameter, the orbit's
        label, its stability in words, x and v at phase 0, the least and largest speed before an impact, the least
        clearance, the work rate of impacts at rigid walls (the energy that they take, over time), and the multipliers.

        units: "scene", or "physical" (Hz, N, mm, m/s, W) of a scene that has scales, the columns' names then telling
        them. Raises ArgumentError for other units, and where the scene has no scales.
        """
        labels = np.repeat(
            [segment.label for segment in self.segments],
            [segment.last - segment.first + 1 for segment in self.segments],
        )
        columns = orbit_columns(self.scene, {self.name: self.values}, self.data, labels, self.multipliers)
        return make_dataframe(self.scene, {"kind": ("", special_kinds(self.special, len(self))), **columns}, units)

    def curves(self, variable: str = "x") -> Curves:
        """The `Curves` of one variable, ready to plot: stable and unstable pieces, and the special points.

        variable: "x" or "v" at phase 0 of each drive period, a column each; "speed", the largest before an impact,
        "least_speed", "clearance", the least, and "peak", the largest abs x, one column. A line breaks where an impact
        crosses phase 0: the velocity jumps there, though the branch goes on.

        Raises ArgumentError for other variables.
        """
        return make_curves(self, variable)


def end_values(branch):
    """The parameter's values at the ends of a branch, of a closed one the least and the largest."""
    values = branch.values
    return (values.min(), values.max()) if End.CLOSED in branch.ends else (values[0], values[-1])


def describe_extent(branch, factor=1.0, digits=12):
    """Describe the parameter values of a branch as a text.

    A closed branch has its range. Others have the first and the last value, and the range where they go beyond these.
    factor: of the scene's unit in that of the text; digits: significant ones.
    """
    values = factor * branch.values
    first_value, last_value, lower, upper = (
        f"{value:.{digits}g}" for value in (values[0], values[-1], values.min(), values.max())
    )
    if End.CLOSED in branch.ends:
        return f"closed, between {lower} and {upper}"
    return f"from {first_value} to {last_value}" + (
        f", between {lower} and {upper}" if {lower, upper} != {first_value, last_value} else ""
    )


def _plain_values(orbit_row):
    return [entry.tolist() if isinstance(entry, np.ndarray) else entry for entry in orbit_row]


def neighbour_labels(special):
    """The labels of the orbits that meet at a special point, each with the side of the parameter it is on."""
    labels = []
    for neighbour in special.joins:
        frequency = frequency_at(special.scene, special.name, neighbour.value)
        direction = ">" if neighbour.value > special.value else "<"
        labels.append(label_of(special.scene, neighbour, itinerary(neighbour, frequency)) + direction)
    return labels


def frequency_at(scene, name, value):
    """The drive's frequency where a parameter has a value."""
    return value if name == "frequency" else float(scene.frequency)


def scene_at_value(scene, name, value):
    """The scene where a parameter has a value that a branch came to: checked when it was followed, and not again."""
    changed_scene = replace_unchecked(scene, {name: value})
    return map_numbers(
        lambda leaf: leaf if isinstance(leaf, jax.Array) else jnp.asarray(np.asarray(leaf, scene.dtype)), changed_scene
    )


def make_special(scene, name, bounds, index, row, kind, residual, neighbours=(), not_followed=(), saved=None):
    """The `Special` at a `dataset_row` a branch's data."""
    orbit_row = parse_orbit_row(row, name)
    multipliers = row["multiplier_real"] + 1j * row["multiplier_imag"]
    scene = scene_at_value(scene, name, orbit_row.value)
    itinerary_words = itinerary(orbit_row, float(scene.frequency))
    is_impact = row["side"] != 0
    slopes = np.concatenate([row["time_slope"][is_impact], row["speed_slope"][is_impact], [row["value_slope"]]])
    optional_fields = tuple(neighbours), tuple(not_followed), saved
    return Special(
        kind,
        name,
        orbit_row.value,
        bounds,
        scene,
        itinerary_words,
        multipliers,
        residual,
        index,
        orbit_row,
        slopes,
        *optional_fields,
    )
