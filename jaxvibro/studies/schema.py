"""Define the tables of a scene file and the types of their keys."""

from typing import Annotated, Any, Literal

import numpy as np
from jaxtyping import Float
from msgspec import Meta, field

from ..scene.check import MAX_ORBIT_PERIODS
from ..scene.scene_table import SceneTable, StrictTable
from ..scene.state import State

MAX_COUNT = 1_000_000
MAX_LEGS = 1000
MAX_SWEEP_STATES = 20_000_000  # states kept in a sweep: a gigabyte during assembly and drawing
Count = Annotated[int, Meta(ge=1, le=MAX_COUNT)]
Seconds = Annotated[float, Meta(gt=0, le=1e9)]  # wall-clock time
Settle = Annotated[int, Meta(ge=0, le=MAX_COUNT)]
Periods = Annotated[int, Meta(ge=1, le=MAX_ORBIT_PERIODS)]
Seed = Annotated[int, Meta(ge=0, lt=2**32)]
Name = Annotated[str, Meta(min_length=1)]
LOCUS_KINDS = ("SN", "PD", "SB", "GR")  # special points that have loci
# Types whose values are checked in `validate.py`, because their rules depend on the scene or have texts of their own.
ParameterName = Annotated[str, Meta(min_length=1, description="a parameter of the scene")]
ParameterPair = tuple[ParameterName, ParameterName]
Finite = Annotated[float, Meta(description="a finite number")]
Positive = Annotated[float, Meta(description="a finite number greater than 0")]
Bounds = Annotated[tuple[float, float], Meta(description="two finite numbers, the first smaller")]
PointKinds = Annotated[tuple[Name, ...], Meta(min_length=1, description="different kinds of special points")]
# Tables of the analyses, in the order of their checks.
ANALYSES = ("sweep", "attractors", "orbits", "branch", "explore", "locus", "margin", "fit", "map", "spectrum", "basins")


class InitialStateTable(StrictTable, frozen=True):
    """Initial state at phase 0: position x, in the unit of the wall positions, and velocity v."""

    x: float
    v: float


class SweepLegTable(StrictTable, frozen=True):
    """Table [[sweep.legs]]: a leg of a sweep, from a first to a last value of the parameter."""

    name: Name
    first: Finite = field(name="from")
    last: Finite = field(name="to")
    start: InitialStateTable


class SweepTable(StrictTable, frozen=True, kw_only=True):
    """Table [sweep]: sweep of a parameter.

    Attributes
    ----------
    parameter : str
        Parameter of the sweep.
    count : int
        Number of values of each leg.
    settle : int
        Number of drive periods that are discarded at each value.
    keep : int
        Number of drive periods that are recorded at each value.
    legs : list of SweepLegTable
        Legs of the sweep.
    max_seconds : float or None
        Limit of the wall-clock time in s.
    """

    parameter: ParameterName
    count: Count
    settle: Settle = 300
    keep: Count = 100
    legs: Annotated[list[SweepLegTable], Meta(min_length=1, max_length=MAX_LEGS)]
    max_seconds: Seconds | None = None

    def values(self, leg: SweepLegTable) -> Float[np.ndarray, " count"]:
        """Return the parameter values of a leg in the order of the sweep, float64, shape (count,)."""
        with np.errstate(over="ignore", invalid="ignore"):
            return np.linspace(leg.first, leg.last, self.count)


class AttractorsTable(StrictTable, frozen=True):
    """Table [attractors]: attractors of the scene with the values in `at`, from random initial states."""

    starts: Count = 200
    seed: Seed = 0
    at: dict[str, float] = field(default_factory=dict)
    max_seconds: Seconds | None = None


class OrbitsTable(StrictTable, frozen=True):
    """Table [orbits]: stable and unstable periodic orbits of the scene with the values in `at`."""

    max_period: Periods = 4
    starts: Count = 200
    seed: Seed = 0
    at: dict[str, float] = field(default_factory=dict)


class BranchTable(StrictTable, frozen=True, kw_only=True):
    """Table [branch]: branches of periodic orbits along a parameter.

    The first branch starts at the orbit that the motion from `start` approaches in the scene with the values in `at`.
    The other branches bifurcate from the first branch, directly or indirectly.
    """

    parameter: ParameterName
    bounds: Bounds
    start: InitialStateTable = InitialStateTable(0.0, 0.0)
    at: dict[str, float] = field(default_factory=dict)
    settle: Settle = 200
    max_period: Periods = 1
    largest_step: Positive = 0.1
    max_seconds: Seconds | None = None


class ExploreTable(StrictTable, frozen=True, kw_only=True):
    """Table [explore]: branches of periodic orbits along a parameter, from initial states in its whole range.

    The scene has the values in `at`. The branches that bifurcate from these branches are continued, too.
    """

    parameter: ParameterName
    bounds: Bounds
    at: dict[str, float] = field(default_factory=dict)
    max_period: Periods = 8
    seed: Seed = 0
    budget: Count | None = None
    max_seconds: Seconds | None = None


class LocusTable(StrictTable, frozen=True, kw_only=True):
    """Table [locus]: loci in two parameters of the special points of [branch] or [explore]."""

    parameters: ParameterPair
    bounds: dict[str, tuple[float, float]]
    kinds: PointKinds = LOCUS_KINDS
    largest_step: Positive = 0.1
    max_seconds: Seconds | None = None


class MarginTable(StrictTable, frozen=True, kw_only=True):
    """Table [margin]: distance of an orbit to the nearest bifurcations.

    The table `free` gives the free parameters and their units. The motion from `start` in the scene with the values in
    `at` approaches the orbit.
    """

    free: Annotated[dict[str, float], Meta(min_length=1)]
    bounds: dict[str, tuple[float, float]] = field(default_factory=dict)
    kinds: PointKinds = LOCUS_KINDS
    start: InitialStateTable = InitialStateTable(0.0, 0.0)
    at: dict[str, float] = field(default_factory=dict)
    settle: Settle = 200
    directions: Count = 128
    seed: Seed = 0
    max_seconds: Seconds | None = None


class FitTable(StrictTable, frozen=True, kw_only=True):
    """Table [fit]: fit of free parameters to a measured record of impacts or samples.

    `record` is the path of the CSV file of the record, relative to the folder of the scene file.
    """

    record: Name
    sigma: float
    free: Annotated[dict[str, float], Meta(min_length=1)]
    bounds: dict[str, tuple[float, float]] = field(default_factory=dict)
    phase: float | Literal["unknown"] = 0.0
    sigma_v: float | None = None
    flawed: bool = True


class SpectrumTable(StrictTable, frozen=True, kw_only=True):
    """Table [spectrum]: both Lyapunov exponents at values of a parameter, from one initial state."""

    parameter: ParameterName
    first: Finite = field(name="from")
    last: Finite = field(name="to")
    count: Count
    start: InitialStateTable = InitialStateTable(0.0, 0.0)
    settle: Settle = 1000
    error: Positive = 2e-3

    @property
    def values(self) -> Float[np.ndarray, " count"]:
        """Values of the parameter, float64, shape (count,)."""
        with np.errstate(over="ignore", invalid="ignore"):
            return np.linspace(self.first, self.last, self.count)


class BasinsTable(StrictTable, frozen=True, kw_only=True):
    """Table [basins]: attractor of each initial state of a grid, in the scene with the values in `at`."""

    x: Bounds
    v: Bounds
    count: Annotated[int, Meta(ge=2, le=4001)]
    phase: Finite = 0.0
    starts: Count = 200
    seed: Seed = 0
    at: dict[str, float] = field(default_factory=dict)

    @property
    def grid(self) -> tuple[Float[np.ndarray, " count"], Float[np.ndarray, " count"]]:
        """Positions and velocities of the grid, float64, shape (count,) each."""
        return np.linspace(*self.x, self.count), np.linspace(*self.v, self.count)


class MapTable(StrictTable, frozen=True, kw_only=True):
    """Table [map]: attractor at each cell of a grid over two parameters, in the scene with the values in `at`.

    The first parameter is on the y axis, and the second on the x axis. `count` is the number of values of each
    parameter. `starts` is the number of random initial states per cell, which replace the initial state `start`.
    """

    parameters: ParameterPair
    bounds: dict[str, tuple[float, float]]
    count: tuple[Count, Count]
    quantities: tuple[Name, ...] = ("label", "exponent")
    start: InitialStateTable = InitialStateTable(0.0, 0.0)
    starts: Count | None = None
    seed: Seed = 0
    along: Name | None = None
    settle: Settle = 300
    patience: Count = 5000
    at: dict[str, float] = field(default_factory=dict)
    max_seconds: Seconds | None = None

    @property
    def arguments(self) -> dict[str, Any]:
        """Arguments of `map_parameters`, except for the scene."""
        with np.errstate(over="ignore", invalid="ignore"):
            names_and_counts = zip(self.parameters, self.count, strict=True)
            values_by_parameter = {name: np.linspace(*self.bounds[name], count) for name, count in names_and_counts}
        initial_states = State(self.start.x, self.start.v) if self.starts is None else self.starts
        option_fields = ("quantities", "along", "settle", "patience", "seed")
        return {
            "grid": values_by_parameter,
            "start": initial_states,
            **{name: getattr(self, name) for name in option_fields},
        }


class ViewTable(StrictTable, frozen=True, kw_only=True):
    """Table [[view]]: an action on the page of `jaxvibro view`, the Python line name = call(of, arguments)."""

    name: Name
    call: Name
    of: str
    arguments: dict[str, Any] = field(default_factory=dict)


class SceneFile(StrictTable, frozen=True):
    """Content of a scene file: the table of the scene and the tables of the analyses."""

    scene: SceneTable
    sweep: SweepTable | None = None
    attractors: AttractorsTable | None = None
    orbits: OrbitsTable | None = None
    branch: BranchTable | None = None
    explore: ExploreTable | None = None
    locus: LocusTable | None = None
    margin: MarginTable | None = None
    fit: FitTable | None = None
    map: MapTable | None = None
    spectrum: SpectrumTable | None = None
    basins: BasinsTable | None = None
    panels: dict[str, list[float]] = field(default_factory=dict)
    view: Annotated[list[ViewTable], Meta(max_length=1000)] = field(default_factory=list)

    @property
    def branch_table(self) -> BranchTable | ExploreTable | None:
        """Table of the branches, [branch] or [explore]; None if the file has neither."""
        return self.branch or self.explore

    @property
    def analyses(self) -> dict[str, StrictTable]:
        """Tables of the analyses in the file, {name: table}."""
        tables = {table_name: getattr(self, table_name) for table_name in ANALYSES}
        return {table_name: table for table_name, table in tables.items() if table is not None}

    @property
    def has_only_map(self) -> bool:
        """True if the only analysis is a [map]."""
        return list(self.analyses) == ["map"]

    @property
    def panel_values(self) -> list[dict[str, float]]:
        """Parameter values of each panel of a figure, {name: value}; [{}] if there is no table [panels]."""
        value_rows = zip(*self.panels.values(), strict=True) if self.panels else [()]
        return [dict(zip(self.panels, value_row, strict=True)) for value_row in value_rows]
