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
from ..output.checksums import netcdf
from ..output.frames import frame, kinds_at
from ..output.labels import name_in
from ..output.table_text import columns, headed, pair
from ..output.units import unit_in, unit_of
from ..problem import stability
from ..problem.end import End, scaled
from ..problem.orbit_on_branch import OrbitPoint, described_orbit, itinerary, label_of
from ..problem.orbit_rows import OrbitRows, SpecialOrbit, row_of, spot_of
from ..scene.scene import Scene, changed, mapped
from ..scene.scene_table import table_of
from . import normal_form as forms
from .curves import Curves, curves
from .normal_form import NormalForm
from .orbit_columns import orbit_columns

NUMBERS = ("first_step", "largest_step", "tolerance")  # of the settings

MEANINGS = {
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
        given = self.kind, self.name, self.scene, self.spot, self.multipliers, self.joins
        return self.saved or forms.normal_form(*given)

    @cached_property
    def meets(self) -> tuple[Orbit, ...]:
        """The `Orbit`s that meet at a GR, each a little on from it, one for every branch that leaves the point."""
        return tuple(described_orbit(self.scene.replace(**{self.name: one.value}), one) for one in self.joins)


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
        kinds = " ".join(one.kind for one in self.special)
        return f"Branch({self.name} {extent(self, digits=6)}, {len(self)} points, {kinds})"

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
        spot = spot_of(row_of(self.data, place), self.name)
        return scene_at(self.scene, self.name, spot.value), spot

    @property
    def content(self) -> bytes:
        """The bytes of the file that `save` writes."""
        known = [
            [one.kind, one.place, one.residual, [_plain(each) for each in one.joins], one.aside] for one in self.special
        ]
        attrs = {
            "title": "jaxvibro branch",
            "source": f"jaxvibro {__version__}",
            "parameter": self.name,
            "bounds": list(self.bounds),
            "scene": msgspec.toml.encode(table_of(self.scene)).decode(),
            "special": json.dumps(known),
            "normal_forms": json.dumps([forms.plain(one.normal_form) for one in self.special]),
            "segments": json.dumps([[one.first, one.last, one.label, one.itinerary] for one in self.segments]),
            "reasons": json.dumps(self.reasons),
            "ends": json.dumps([one.name for one in self.ends]),
            "settings": json.dumps({key: self.settings[key] for key in NUMBERS}),
        }
        return netcdf(self.data.assign_attrs(attrs))

    def table(self, units: str = "scene", labels: str = "jaxvibro") -> str:
        """The special points as a text, a line each, and why the branch ends.

        units: "scene", or "physical" (Hz, N, mm, ...) of a scene that has scales; labels: what kinds are called,
        "jaxvibro", "auto" (AUTO-07p) or "matcont". stability: of the orbits before and after the point.

        Raises ArgumentError for other units and labels, and where the scene has no scales.
        """
        unit, size = unit_in(self.scene, unit_of(self.name), units)
        head = headed(self.name, unit, units)
        rows = [("kind", head, "orbit", "stability", "itinerary", "multipliers", "meets", "consequence", "normal form")]
        found = self.multipliers
        for one in self.special:
            walls = " ".join(word or "." for word in one.itinerary)
            kind, value, steady = name_in(one.kind, labels), one.value * size, stability.words_around(found, one.place)
            meets = " ".join(labels_of(one)) or "-"
            own = (kind, f"{value:.12g}", one.label, steady, walls, pair(one.multipliers), meets)
            form = one.normal_form
            rows.append((*own, *((form.consequence, str(form)) if form else ("-", "-"))))
        ends = [f"{end} point: {why if size == 1.0 else scaled(why, size)}" for end, why in self.reason.items()]
        return "\n".join([columns(rows), *ends])

    def to_frame(self, units: str = "scene") -> pd.DataFrame:
        """A row a point, a pandas.DataFrame: kind of the special point there, if it is one, the parameter, the orbit's
        label, its stability in words, x and v at phase 0, the least and largest speed before an impact, the least
        clearance, the work rate of impacts at rigid walls (the energy that they take, over time), and the multipliers.

        units: "scene", or "physical" (Hz, N, mm, m/s, W) of a scene that has scales, the columns' names then telling
        them. Raises ArgumentError for other units, and where the scene has no scales.
        """
        labels = np.repeat([one.label for one in self.segments], [one.last - one.first + 1 for one in self.segments])
        columns = orbit_columns(self.scene, {self.name: self.values}, self.data, labels, self.multipliers)
        return frame(self.scene, {"kind": ("", kinds_at(self.special, len(self))), **columns}, units)

    def curves(self, variable: str = "x") -> Curves:
        """The `Curves` of one variable, ready to plot: stable and unstable pieces, and the special points.

        variable: "x" or "v" at phase 0 of each drive period, a column each; "speed", the largest before an impact,
        "least_speed", "clearance", the least, and "peak", the largest abs x, one column. A line breaks where an impact
        crosses phase 0: the velocity jumps there, though the branch goes on.

        Raises ArgumentError for other variables.
        """
        return curves(self, variable)


def ends(branch):
    """The parameter's values at the ends of a branch, of a closed one the least and the largest."""
    values = branch.values
    return (values.min(), values.max()) if End.CLOSED in branch.ends else (values[0], values[-1])


def extent(branch, size=1.0, digits=12):
    """Describe the parameter values of a branch as a text.

    A closed branch has its range. Others have the first and the last value, and the range where they go beyond these.
    size: of the scene's unit in that of the text; digits: significant ones.
    """
    values = size * branch.values
    first, last, low, high = (f"{each:.{digits}g}" for each in (values[0], values[-1], values.min(), values.max()))
    if End.CLOSED in branch.ends:
        return f"closed, between {low} and {high}"
    return f"from {first} to {last}" + (f", between {low} and {high}" if {low, high} != {first, last} else "")


def _plain(spot):
    return [each.tolist() if isinstance(each, np.ndarray) else each for each in spot]


def labels_of(special):
    """The labels of the orbits that meet at a special point, each with the side of the parameter it is on."""
    found = []
    for one in special.joins:
        frequency = frequency_at(special.scene, special.name, one.value)
        way = ">" if one.value > special.value else "<"
        found.append(label_of(special.scene, one, itinerary(one, frequency)) + way)
    return found


def frequency_at(scene, name, value):
    """The drive's frequency where a parameter has a value."""
    return value if name == "frequency" else float(scene.frequency)


def scene_at(scene, name, value):
    """The scene where a parameter has a value that a branch came to: checked when it was followed, and not again."""
    new = changed(scene, {name: value})
    return mapped(lambda leaf: leaf if isinstance(leaf, jax.Array) else jnp.asarray(np.asarray(leaf, scene.dtype)), new)


def special_of(scene, name, bounds, place, row, kind, residual, joins=(), aside=(), saved=None):
    """The `Special` at a `row_of` a branch's data."""
    spot = spot_of(row, name)
    found = row["multiplier_real"] + 1j * row["multiplier_imag"]
    scene = scene_at(scene, name, spot.value)
    walls = itinerary(spot, float(scene.frequency))
    hit = row["side"] != 0
    slopes = np.concatenate([row["time_slope"][hit], row["speed_slope"][hit], [row["value_slope"]]])
    more = tuple(joins), tuple(aside), saved
    return Special(kind, name, spot.value, bounds, scene, walls, found, residual, place, spot, slopes, *more)
