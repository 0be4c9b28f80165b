"""`HeldBranch`: orbits along two parameters that share a number."""

import json
from dataclasses import dataclass, field
from functools import cached_property

import msgspec
import numpy as np
import pandas as pd
import xarray as xr
from jaxtyping import Bool, Float

from .. import __version__
from ..output.checksums import netcdf
from ..output.frames import frame
from ..output.runs import runs
from ..output.table_text import columns, headed
from ..output.units import LENGTH, SPEED, unit_in, unit_of
from ..problem import end_in_plane, stability
from ..problem.orbit_on_branch import OrbitPoint, itinerary, label_of
from ..problem.orbit_rows import OrbitRows, row_of, spot_of
from ..scene.scene import Scene
from ..scene.scene_table import table_of
from .branch import Special
from .orbit_columns import orbit_columns

UNITS = {"peak": LENGTH, "least_speed": SPEED}  # of what may be held


@dataclass(frozen=True, eq=False)
class HeldBranch(OrbitRows[Special]):
    """Orbits along two parameters that share a number.

    names: of the parameters; held, value: the number and what it is; bounds: of each; scene: at the start; data: an
    xarray.Dataset with a row a point, in order, the columns as of a `Branch`, both parameters among them; reasons: why
    it ends, at its first and at its last point; special: none is looked for.
    """

    names: tuple[str, str]
    held: str
    value: float
    bounds: dict[str, tuple[float, float]]
    scene: Scene = field(repr=False)
    data: xr.Dataset = field(repr=False)
    reasons: tuple[str, str]
    special: tuple[Special, ...] = ()

    NOUN = "branch"

    def __repr__(self):
        one, two = self.names
        return f"HeldBranch({self.held} {self.value:g} along {one} and {two}, {len(self)} points)"

    @property
    def values(self) -> Float[np.ndarray, "points 2"]:
        """The two parameters at each point, (points, 2)."""
        return np.stack([self.data[name].values for name in self.names], axis=1)

    @property
    def stable(self) -> Bool[np.ndarray, " points"]:
        """Whether each point's orbit is stable, (points,)."""
        return self.data["stable"].values.astype(bool)

    @cached_property
    def label(self) -> str:
        """P n p q of the orbits."""
        scene, spot = self.located(0)
        return label_of(scene, spot, itinerary(spot, float(scene.frequency)))

    def located(self, place: int) -> tuple[Scene, OrbitPoint]:
        """(the scene at a point, its `OrbitPoint`)."""
        row = row_of(self.data, place)
        values = {name: float(row[name]) for name in self.names}
        return self.scene.replace(**values), spot_of(row, self.names[0])

    @property
    def content(self) -> bytes:
        """The bytes of the file that `save` writes."""
        attrs = {
            "title": "jaxvibro held branch",
            "source": f"jaxvibro {__version__}",
            "held": self.held,
            "value": self.value,
            "bounds": json.dumps({name: self.bounds[name] for name in self.names}),
            "scene": msgspec.toml.encode(table_of(self.scene)).decode(),
            "reasons": json.dumps(self.reasons),
        }
        return netcdf(self.data.assign_attrs(attrs))

    def table(self, units: str = "scene") -> str:
        """What is held, a line for each stretch of one stability with the parameters at its ends, and why the curve
        ends. units: as in `Branch.table`.

        Raises ArgumentError for other units, and where the scene has no scales.
        """
        known = {name: unit_in(self.scene, unit_of(name), units) for name in self.names}
        unit, size = unit_in(self.scene, UNITS[self.held], units)
        heads = [headed(name, text, units) for name, (text, _) in known.items()]
        rows: list[tuple[str, ...]] = [("points", *heads, "orbit", "stability")]
        words = stability.words(self.multipliers)
        for first, last in runs(words):
            ends = self.values[[first, last - 1]] * [times for _, times in known.values()]
            told = [f"{one:.12g} to {other:.12g}" for one, other in ends.T]
            rows.append((f"{first} to {last - 1}", *told, self.label, words[first]))
        sizes = {name: times for name, (_, times) in known.items()}
        why = [f"{end} point: {end_in_plane.scaled(text, sizes)}" for end, text in self.reason.items()]
        return "\n".join([f"{headed(self.held, unit, units)} held at {self.value * size:.12g}", columns(rows), *why])

    def to_frame(self, units: str = "scene") -> pd.DataFrame:
        """A row a point, a pandas.DataFrame: the two parameters, what is held, and the columns of `Branch.to_frame`
        but for the kind. units: likewise.

        Raises ArgumentError for other units, and where the scene has no scales.
        """
        values = {name: self.data[name].values for name in self.names}
        labels, held = np.repeat(self.label, len(self)), (UNITS[self.held], np.full(len(self), self.value))
        found = orbit_columns(self.scene, values, self.data, labels, self.multipliers)
        front = {name: found[name] for name in self.names} | {self.held: held}
        return frame(self.scene, front | {key: each for key, each in found.items() if key not in front}, units)
