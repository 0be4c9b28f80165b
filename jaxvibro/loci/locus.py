"""`locus`: a curve of special points in two parameters, with its points of codimension two."""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import jax.numpy as jnp
import msgspec
import numpy as np
import pandas as pd
import xarray as xr
from jaxtyping import Complex, Float

from continuation.limits import limits_of
from continuation.stretch import backwards, glued

from .. import __version__
from ..branches.branch import Special
from ..orbits.orbit import roots
from ..output.checksums import netcdf
from ..output.frames import frame, kinds_at, of_least, of_multipliers
from ..output.labels import name_in
from ..output.table_text import columns, headed
from ..output.units import LENGTH, SPEED, TIME, scales_in, unit_in, unit_of
from ..problem import end_in_plane
from ..problem.end import End
from ..problem.orbit_on_branch import OrbitPoint, itinerary
from ..problem.orbit_rows import OrbitRows, SpecialOrbit, row_of
from ..scene import check
from ..scene.scene import Scene, changed
from ..scene.scene_table import table_of
from .corner import outsets, track_on
from .first_point import KINDS, RESTS, impacts_of, start_of
from .track import reason

MEANINGS = {
    "CP": "cusp",
    "GPD": "generalized period doubling",
    "DSB": "degenerate symmetry breaking",
    "GR": "end on a grazing",
    "GG": "two grazings",
    "RG": "resonant grazing",
    "DG": "degenerate grazing",
    "CH": "end on a complete chatter",
    "RL": "end on a release within a rest",
    "EP": "end",
}


@dataclass(frozen=True, eq=False)
class Codim2(SpecialOrbit):
    """A special point of a locus.

    kind: CP (cusp), GPD (generalized period doubling), DSB (degenerate symmetry breaking), GR (an SN, PD or SB ends on
    a grazing), GG (two grazings), RG (resonant grazing), DG (degenerate one), SN, PD, SB (a grazing meets such a
    locus), CH, RL (a rest just is one there), EP (end). on: the kind of the locus; values: the two parameters by name;
    bounds: of each; multipliers: the larger first; place: among the locus' points; residual: the largest error left in
    the point's equations; label, itinerary: of the orbit; scene: at the values.
    """

    kind: str
    on: str
    values: dict[str, float]
    bounds: dict[str, tuple[float, float]]
    multipliers: Complex[np.ndarray, "2"]
    place: int
    residual: float
    itinerary: tuple[str, ...]
    scene: Scene = field(repr=False)
    spot: OrbitPoint = field(repr=False)


@dataclass(frozen=True, eq=False)
class Locus(OrbitRows[Codim2]):
    """A curve of special points in two parameters.

    kind: of the points, that of `special`; names: of the parameters; bounds: of each; scene: at the start; data: an
    xarray.Dataset with a row a point, in order along the curve (see `jaxvibro.locus`); special: points of codimension
    two and ends, in order; reasons: why it ends, at its first and at its last point.
    """

    kind: str
    names: tuple[str, str]
    bounds: dict[str, tuple[float, float]]
    scene: Scene = field(repr=False)
    data: xr.Dataset = field(repr=False)
    special: tuple[Codim2, ...]
    reasons: tuple[str, str]

    NOUN = "locus"

    def __repr__(self):
        ends = " ".join(one.kind for one in self.special)
        return f"Locus({self.kind} of {self.label} in {self.names[0]} and {self.names[1]}, {len(self)} points, {ends})"

    @property
    def values(self) -> Float[np.ndarray, "points 2"]:
        """The two parameters at each point, (points, 2)."""
        return np.stack([self.data[name].values for name in self.names], axis=1)

    @property
    def label(self) -> str:
        """P n p q of the orbits."""
        return self.special[0].label

    def located(self, place: int) -> tuple[Scene, OrbitPoint]:
        """(the scene at a point, its `OrbitPoint`)."""
        spot, values = _spot_of(self.data, place, self.names)
        return self.scene.replace(**values), spot

    @property
    def content(self) -> bytes:
        """The bytes of the file that `save` writes."""
        attrs = {
            "title": "jaxvibro locus",
            "source": f"jaxvibro {__version__}",
            "kind": self.kind,
            "bounds": json.dumps({name: self.bounds[name] for name in self.names}),
            "scene": msgspec.toml.encode(table_of(self.scene)).decode(),
            "special": json.dumps([[one.kind, one.place, one.residual] for one in self.special]),
            "reasons": json.dumps(self.reasons),
        }
        return netcdf(self.data.assign_attrs(attrs))

    def table(self, units: str = "scene", labels: str = "jaxvibro") -> str:
        """The special points as a text, a line each, and why the locus ends. units, labels: as in `Branch.table`.

        Raises ArgumentError for other units and labels, and where the scene has no scales.
        """
        known = [unit_in(self.scene, unit_of(name), units) for name in self.names]
        heads = [headed(name, unit, units) for name, (unit, _) in zip(self.names, known, strict=True)]
        rows: list[tuple[str, ...]] = [("kind", *heads, "orbit", "itinerary")]
        for one in self.special:
            walls = " ".join(word or "." for word in one.itinerary)
            values = [f"{value * size:.12g}" for value, (_, size) in zip(one.values.values(), known, strict=True)]
            rows.append((name_in(one.kind, labels), *values, one.label, walls))
        sizes = {name: size for name, (_, size) in zip(self.names, known, strict=True)}
        ends = [f"{end} point: {end_in_plane.scaled(why, sizes)}" for end, why in self.reason.items()]
        return "\n".join([columns(rows), *ends])

    def to_frame(self, units: str = "scene") -> pd.DataFrame:
        """A row a point, a pandas.DataFrame: kind of the point of codimension two there, if it is one, the two
        parameters, the orbit's label, the least speed before an impact and the least clearance, and the multipliers.

        units: as in `Branch.to_frame`. Raises ArgumentError for other units, and where the scene has no scales.
        """
        return frame(
            self.scene,
            {
                "kind": ("", kinds_at(self.special, len(self))),
                **{name: (unit_of(name), self.data[name].values) for name in self.names},
                "label": ("", np.repeat(self.label, len(self))),
                **of_least(self.data),
                **of_multipliers(self.multipliers),
            },
            units,
        )


@check.host("use strobe or monodromy")
def locus(
    special: Special,
    names: Sequence[str],
    bounds: Mapping[str, tuple[float, float]],
    first_step: float = 0.02,
    largest_step: float = 0.1,
    tolerance: float = 1e-12,
    *,
    max_points: int | None = None,
    max_seconds: float | None = None,
    progress: Callable[[int], object] | None = None,
) -> Locus:
    """The curve of a special point in two parameters of its scene: a `Locus`.

    special: a `Special` of a branch, SN, PD, SB, GR, CH or RL; names: two parameters; bounds: {name: (low, high)}.
    first_step, largest_step, tolerance: as in `follow`, lengths of (times, speeds, parameters), a stiffness
    being measured by 1 and its value at the start. max_points, max_seconds, progress: as in `follow`.

    Unknowns are the impacts' times and speeds, and both parameters; a symmetric orbit is followed by half of it. Every
    point is checked to keep to its walls; where it does not, the locus ends. Located are cusps (CP), generalized period
    doublings (GPD), degenerate symmetry breakings (DSB), ends on a grazing (GR), grazings of two impacts or walls at
    once (GG), a GR where a rest just is one (CH, RL) or its touch has no acceleration (DG), and on a GR resonant
    grazings (RG), where loci of SN and PD end, and points where the orbit without the touch is an SN, PD or SB.
    `switch` follows the loci that leave RG, GPD, DSB, SN, PD, SB and GR. The GR of a motion without impacts goes on
    from a GG along the other wall, the nearer one from there on.

    The `data` has a row a point: the parameters, time, speed and side of each impact, multiplier_real and
    multiplier_imag, least_speed, least_clearance, residual.

    Raises ArgumentError for points of other kinds and arguments that cannot be.
    """
    limits = limits_of(max_points, max_seconds, progress, check.ArgumentError)
    start, steps = start_of(special, (*KINDS, *RESTS)), (first_step, largest_step, tolerance, limits)
    on, back = outsets(start, names, bounds, *steps)
    ahead = track_on(start, on.limited(limits.halved()), steps)
    back = back.limited(limits.after(sum(len(one.points.z) - 1 for _, one in ahead)))
    return locus_of(special, ahead, () if ahead[0][1].end is End.CLOSED else track_on(start, back, steps))


def locus_of(special, on, back, left="the start"):
    """The `Locus` of what was `corner.track_on` from its start on and back, the latter empty where the first closes, or
    it begins at a point, of which `left` tells."""
    asked, parts = (
        on[0][0].asked,
        [backwards(one) for _, one in reversed(back)] + [one for _, one in on],
    )
    if back and back[0][0].curve is on[0][0].curve:
        parts[len(back) - 1 : len(back) + 1] = [glued(parts[len(back) - 1 : len(back) + 1])]
    data, found, first = [], {}, 0
    wide = max(impacts_of(part.args, part.points.z[:1])[0].shape[1] for part in parts)
    for part in parts:
        data.append(_data(asked.names, part, wide).isel(point=slice(1 if data else 0, None)))
        found |= {first + mark.place: (mark.kind, mark.residual) for mark in part.marks}
        last = first + len(part.points.z) - 1
        if part is not parts[-1] and part.args.cycle.releases is None:  # a corner
            found.setdefault(last, ("GG", float(part.points.residual[-1])))
        first = last
    data = xr.concat(data, "point", combine_attrs="override").assign_attrs(scales_in(special.scene))
    for place in (0, first):
        found.setdefault(place, ("EP", float(data["residual"].values[place])))
    given = special.scene, special.kind, asked.bounds, data
    points = tuple(codim2_of(*given, place, *found[place]) for place in sorted(found))
    reasons = (reason(*back[-1]) if back else left, reason(*on[-1]))
    return Locus(special.kind, asked.names, asked.bounds, special.scene, data, points, reasons)


def _data(names, one, wide):
    """The rows of a stretch, with as many columns of impacts as are wanted."""
    curve, z, look = one.args, one.points.z, one.view
    rows = len(curve.cycle.sides)
    times, speeds, sides, periods = impacts_of(curve, z)
    found = roots(look.trace, look.determinant)
    if float(curve.cycle.turn) < 0:  # of half the orbit
        with np.errstate(invalid="ignore"):
            found = found * found
    own = np.arange(times.shape[1]) % int(np.sum(curve.cycle.sides != 0))
    speed = np.where(np.isin(own, curve.hits), speeds, np.inf).min(axis=1)
    per_impact = {"time": (times, "since phase 0", TIME), "speed": (speeds, "abs(y- - v_b)", SPEED)}
    plain = {
        "least_speed": (speed, "of the impacts but for that which grazes", SPEED),
        "least_clearance": (look.clear.min(axis=(1, 2), initial=np.inf), "at turning points, inf: none", LENGTH),
        "residual": (one.points.residual, "largest error left in the equations", LENGTH),
    }
    columns = {
        name: ("point", z[:, 2 * rows + k], _attrs("a parameter", unit_of(name))) for k, name in enumerate(names)
    }
    columns |= {key: (("point", "impact"), each[0], _attrs(*each[1:])) for key, each in per_impact.items()}
    sides = np.broadcast_to(sides.astype(np.int8), times.shape)
    columns["side"] = (("point", "impact"), sides, _attrs("-1 left, 1 right", "1"))
    for key, part in (("real", found.real), ("imag", found.imag)):
        columns[f"multiplier_{key}"] = (("point", "multiplier"), part, _attrs("Floquet's, the larger first", "1"))
    columns |= {key: ("point", each[0], _attrs(*each[1:])) for key, each in plain.items()}
    found = xr.Dataset(columns, attrs={"periods": periods})
    more = wide - times.shape[1]
    return found.pad(impact=(0, more), constant_values={"side": 0}) if more else found


def _attrs(meaning, units):
    return {"long_name": meaning, "units": units}


def _spot_of(data, place, names):
    """(the `OrbitPoint` at a point of a locus, {name: value})."""
    row, values = row_of(data, place), {name: float(data[name].values[place]) for name in names}
    hit = row["side"] != 0
    rows = (row[key][hit].astype(float) for key in ("time", "speed", "side"))
    return OrbitPoint(values[names[0]], *rows, data.attrs["periods"], np.nan, np.nan, float(row["residual"])), values


def codim2_of(scene, on, bounds, data, place, kind, residual):
    """The `Codim2` of a kind at a place among the points of a locus of the kind `on`, which starts at the scene."""
    row, (spot, values) = row_of(data, place), _spot_of(data, place, tuple(bounds))
    there = {name: jnp.asarray(value, scene.dtype) for name, value in values.items()}
    scene = changed(scene, there)  # in its domain: not checked again
    found = row["multiplier_real"] + 1j * row["multiplier_imag"]
    walls = itinerary(spot, float(scene.frequency))
    return Codim2(kind, on, values, bounds, found, place, residual, walls, scene, spot)
