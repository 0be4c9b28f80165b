"""Define the tables of a scene file and the types of their keys."""

from typing import Annotated, Any, Literal

import numpy as np
from jaxtyping import Float
from msgspec import Meta, field

from ..scene.check import MAX_ORBIT_PERIODS
from ..scene.scene_table import SceneTable, Table
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


class StartTable(Table, frozen=True):
    """Initial state at phase 0: position x, in the unit of the walls, and velocity v."""

    x: float
    v: float


class LegTable(Table, frozen=True):
    """Table [[sweep.legs]]: one pass of a sweep, from a first to a last value of the parameter."""

    name: Name
    first: float = field(name="from")
    last: float = field(name="to")
    start: StartTable


class SweepTable(Table, frozen=True, kw_only=True):
    """Table [sweep]: number of values per leg, and drive periods discarded and kept at each."""

    parameter: Name
    count: Count
    settle: Settle = 300
    keep: Count = 100
    legs: Annotated[list[LegTable], Meta(min_length=1, max_length=MAX_LEGS)]
    max_seconds: Seconds | None = None

    def values(self, leg: LegTable) -> Float[np.ndarray, " count"]:
        """Return the parameter's values along a leg, in the order of the sweep: float64, shape (count,)."""
        with np.errstate(over="ignore", invalid="ignore"):
            return np.linspace(leg.first, leg.last, self.count)


class AttractorsTable(Table, frozen=True):
    """Table [attractors]: attractors of the scene, with the values in `at`, from random starts."""

    starts: Count = 200
    seed: Seed = 0
    at: dict[str, float] = field(default_factory=dict)
    max_seconds: Seconds | None = None


class OrbitsTable(Table, frozen=True):
    """Table [orbits]: periodic orbits, stable and unstable, near trajectories of the scene with the values in `at`."""

    max_period: Periods = 4
    starts: Count = 200
    seed: Seed = 0
    at: dict[str, float] = field(default_factory=dict)


class BranchTable(Table, frozen=True, kw_only=True):
    """Table [branch]: branches of periodic orbits along a parameter.

    The first branch starts at the orbit that the scene, with the values in `at`, approaches from `start`. The others
    bifurcate from it.
    """

    parameter: Name
    bounds: tuple[float, float]
    start: StartTable = StartTable(0.0, 0.0)
    at: dict[str, float] = field(default_factory=dict)
    settle: Settle = 200
    max_period: Periods = 1
    largest_step: float = 0.1
    max_seconds: Seconds | None = None


class ExploreTable(Table, frozen=True, kw_only=True):
    """Table [explore]: branches of periodic orbits along a parameter, from starts all over its range.

    The scene has the values in `at`. All branches that bifurcate from these are followed, too.
    """

    parameter: Name
    bounds: tuple[float, float]
    at: dict[str, float] = field(default_factory=dict)
    max_period: Periods = 8
    seed: Seed = 0
    budget: Count | None = None
    max_seconds: Seconds | None = None


class LocusTable(Table, frozen=True, kw_only=True):
    """Table [locus]: loci, in two parameters, of the special points of [branch] or [explore]."""

    parameters: tuple[Name, Name]
    bounds: dict[str, tuple[float, float]]
    kinds: Annotated[tuple[Name, ...], Meta(min_length=1)] = LOCUS_KINDS
    largest_step: float = 0.1
    max_seconds: Seconds | None = None


class MarginTable(Table, frozen=True, kw_only=True):
    """Table [margin]: nearest bifurcations of an orbit, in units of the free parameters.

    The orbit is the one that the scene, with the values in `at`, approaches from `start`.
    """

    free: Annotated[dict[str, float], Meta(min_length=1)]
    bounds: dict[str, tuple[float, float]] = field(default_factory=dict)
    kinds: Annotated[tuple[Name, ...], Meta(min_length=1)] = LOCUS_KINDS
    start: StartTable = StartTable(0.0, 0.0)
    at: dict[str, float] = field(default_factory=dict)
    settle: Settle = 200
    directions: Count = 128
    seed: Seed = 0
    max_seconds: Seconds | None = None


class FitTable(Table, frozen=True, kw_only=True):
    """Table [fit]: free parameters fitted to a record of impacts or samples, a CSV file beside the scene file."""

    record: Name
    sigma: float
    free: Annotated[dict[str, float], Meta(min_length=1)]
    bounds: dict[str, tuple[float, float]] = field(default_factory=dict)
    phase: float | Literal["unknown"] = 0.0
    sigma_v: float | None = None
    flawed: bool = True


class SpectrumTable(Table, frozen=True, kw_only=True):
    """Table [spectrum]: both Lyapunov exponents at values of a parameter, each from the same start."""

    parameter: Name
    first: float = field(name="from")
    last: float = field(name="to")
    count: Count
    start: StartTable = StartTable(0.0, 0.0)
    settle: Settle = 1000
    error: float = 2e-3

    @property
    def values(self) -> Float[np.ndarray, " count"]:
        """Values of the parameter: float64, shape (count,)."""
        with np.errstate(over="ignore", invalid="ignore"):
            return np.linspace(self.first, self.last, self.count)


class BasinsTable(Table, frozen=True, kw_only=True):
    """Table [basins]: attractor of each start of a grid, the scene having the values in `at`."""

    x: tuple[float, float]
    v: tuple[float, float]
    count: Annotated[int, Meta(ge=2, le=4001)]
    phase: float = 0.0
    starts: Count = 200
    seed: Seed = 0
    at: dict[str, float] = field(default_factory=dict)

    @property
    def grid(self) -> tuple[Float[np.ndarray, " count"], Float[np.ndarray, " count"]]:
        """Positions and velocities: float64, shape (count,) each."""
        return np.linspace(*self.x, self.count), np.linspace(*self.v, self.count)


class MapTable(Table, frozen=True, kw_only=True):
    """Table [map]: attractor of the scene, with the values in `at`, at each cell of a grid over two parameters.

    The first parameter is on the y axis, the second on the x axis. `count` gives the number of values of each. `starts`
    is the number of random starts per cell, in place of the one start.
    """

    parameters: tuple[Name, Name]
    bounds: dict[str, tuple[float, float]]
    count: tuple[Count, Count]
    quantities: tuple[Name, ...] = ("label", "exponent")
    start: StartTable = StartTable(0.0, 0.0)
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
            parameter_counts = zip(self.parameters, self.count, strict=True)
            grid = {name: np.linspace(*self.bounds[name], count) for name, count in parameter_counts}
        start = State(self.start.x, self.start.v) if self.starts is None else self.starts
        option_names = ("quantities", "along", "settle", "patience", "seed")
        return {"grid": grid, "start": start, **{name: getattr(self, name) for name in option_names}}


class ViewTable(Table, frozen=True, kw_only=True):
    """Table [[view]]: one action on the page of `jaxvibro view`, the Python line name = call(of, arguments)."""

    name: Name
    call: Name
    of: str
    arguments: dict[str, Any] = field(default_factory=dict)


class SceneFile(Table, frozen=True):
    """Content of a scene file: the scene, and the analyses that it requests."""

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
        """Table that gives branches: [branch] or [explore], None without either."""
        return self.branch or self.explore

    @property
    def has_only_map(self) -> bool:
        """True if the only analysis is a [map]."""
        study_names = (name for name in self.__struct_fields__ if name not in ("scene", "map", "panels", "view"))
        return self.map is not None and not any(getattr(self, name) for name in study_names)

    @property
    def panel_values(self) -> list[dict[str, float]]:
        """Values of the scene's parameters in each panel; [{}] without [panels]."""
        rows = zip(*self.panels.values(), strict=True) if self.panels else [()]
        return [dict(zip(self.panels, row, strict=True)) for row in rows]
