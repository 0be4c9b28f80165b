"""The tables of a scene file: what may stand in them, and the scene that they describe."""

from contextlib import contextmanager
from typing import Annotated

import numpy as np
from msgspec import Meta, Struct, field

from . import check
from .scene import SIDES, Motion, Scene, Wall, changed, known, make_scene

MOST = 1_000_000
MOST_STATES = 20_000_000  # kept in a sweep: a gigabyte while it is put together and drawn
Count = Annotated[int, Meta(ge=1, le=MOST)]
Settle = Annotated[int, Meta(ge=0, le=MOST)]
Periods = Annotated[int, Meta(ge=1, le=32)]  # half of what `trail` keeps
Seed = Annotated[int, Meta(ge=0, lt=2**32)]
Name = Annotated[str, Meta(min_length=1)]
KINDS = ("SN", "PD", "SB", "GR")  # special points that have loci


class Table(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """A table in which every key has its meaning and no other key may stand."""


class MotionTable(Table):
    """[scene.left.motion]: a `Motion`."""

    amplitude: float
    phase: float = 0.0
    harmonic: int = 1


class WallTable(Table):
    """[scene.left]: a `Wall`; without restitution it has the scene's."""

    position: float
    restitution: float | None = None
    motion: MotionTable | None = None

    def wall(self):
        """The `Wall` described, not yet checked."""
        motion = self.motion and Motion(self.motion.amplitude, self.motion.phase, self.motion.harmonic)
        return Wall(self.position, self.restitution, motion)


class SceneTable(Table):
    """[scene]: the arguments of `make_scene`; a wall without a table is not there."""

    amplitude: float
    frequency: float
    damping: float
    restitution: float
    left: WallTable | None = None
    right: WallTable | None = None

    def make(self, dtype=None):
        """The scene described, made by `make_scene`: SceneError where it breaks a rule."""
        walls = tuple(table and table.wall() for table in (self.left, self.right))
        return make_scene(self.amplitude, self.frequency, self.damping, self.restitution, walls, dtype)


class StartTable(Table):
    """Where a motion starts, at phase 0: position x in the walls' unit of length, velocity v."""

    x: float
    v: float


class LegTable(Table):
    """[[sweep.legs]]: one direction of a sweep, from a first value of the parameter to a last one."""

    name: Name
    first: float = field(name="from")
    last: float = field(name="to")
    start: StartTable


class SweepTable(Table, kw_only=True):
    """[sweep]: count values a leg; at each, settle drive periods are left out and keep are drawn."""

    parameter: Name
    count: Count
    settle: Settle = 300
    keep: Count = 100
    legs: Annotated[list[LegTable], Meta(min_length=1)]

    def values(self, leg):
        """The parameter's values along a leg, in the order of the sweep: float64, shape (count,)."""
        with np.errstate(over="ignore", invalid="ignore"):
            return np.linspace(leg.first, leg.last, self.count)


class AttractorsTable(Table):
    """[attractors]: what the scene, with the values under `at`, settles on from this many random starts."""

    starts: Count = 200
    seed: Seed = 0
    at: dict[str, float] = {}


class OrbitsTable(Table):
    """[orbits]: the periodic orbits, stable and unstable, that trajectories of the scene, with the values under `at`,
    come near."""

    max_period: Periods = 4
    starts: Count = 200
    seed: Seed = 0
    at: dict[str, float] = {}


class BranchTable(Table, kw_only=True):
    """[branch]: the periodic orbits along a parameter from that on which the scene, with the values under `at`, settles
    from a start, and the branches that leave them."""

    parameter: Name
    bounds: tuple[float, float]
    start: StartTable = StartTable(0.0, 0.0)
    at: dict[str, float] = {}
    settle: Settle = 200
    max_period: Periods = 1
    largest_step: float = 0.1


class ExploreTable(Table, kw_only=True):
    """[explore]: the periodic orbits along a parameter, found from many starts at values all over its range, the scene
    having the values under `at`, and all branches that leave them."""

    parameter: Name
    bounds: tuple[float, float]
    at: dict[str, float] = {}
    max_period: Periods = 8
    seed: Seed = 0
    budget: Count | None = None


class LocusTable(Table, kw_only=True):
    """[locus]: the curves, in two parameters, of the special points of what [branch] or [explore] gives."""

    parameters: tuple[Name, Name]
    bounds: dict[str, tuple[float, float]]
    kinds: Annotated[tuple[Name, ...], Meta(min_length=1)] = KINDS
    largest_step: float = 0.1


class SceneFile(Table):
    """All that a scene file says: the scene, and the studies that it asks for."""

    scene: SceneTable
    sweep: SweepTable | None = None
    attractors: AttractorsTable | None = None
    orbits: OrbitsTable | None = None
    branch: BranchTable | None = None
    explore: ExploreTable | None = None
    locus: LocusTable | None = None

    @property
    def followed(self):
        """What gives branches: [branch] or [explore]; None without."""
        return self.branch or self.explore

    def check(self):
        """This file, once scene and studies break no rule. Raises SceneError naming the key, dotted from the top."""
        scene = _plain(self.scene)
        if self.sweep is not None:
            _check_sweep(scene, self.sweep)
        for name in ("attractors", "orbits"):
            asked = getattr(self, name)
            if asked is not None:
                with _under(f"{name}.at."):
                    known(changed(scene, asked.at), np.float64)
        if self.branch is not None:
            _check_branch(scene, self.branch)
        if self.explore is not None:
            _check_explore(scene, self)
        if self.locus is not None:
            _check_locus(scene, self)
        return self


def table_of(scene):
    """The `SceneTable` that describes one scene. Raises SceneError for a batch."""
    if scene.shape:
        raise check.SceneError("scene", "only a single scene can be written, not a batch", f"shape {scene.shape}")

    def table(wall):
        if wall is None:
            return None
        move = wall.motion
        moving = move and MotionTable(amplitude=float(move.amplitude), phase=float(move.phase), harmonic=move.harmonic)
        own = None if wall.restitution is None else float(wall.restitution)
        return WallTable(position=float(wall.position), restitution=own, motion=moving)

    plain = {key: float(getattr(scene, key)) for key in ("amplitude", "frequency", "damping", "restitution")}
    return SceneTable(**plain, left=table(scene.left), right=table(scene.right))


def _plain(table):
    """The scene of a table in NumPy's float64, checked, whether jax has double precision on or not."""
    left, right = (wall and wall.wall() for wall in (table.left, table.right))
    with _under("scene."):
        return known(Scene(table.amplitude, table.frequency, table.damping, table.restitution, left, right), np.float64)


@contextmanager
def _under(prefix):
    """Names the keys of a scene's errors as the file does."""
    try:
        yield
    except check.SceneError as error:
        raise check.SceneError(prefix + error.key, error.rule, error.value, error.index) from None


def _check_sweep(scene, sweep):
    _check_name("sweep.parameter", scene, sweep.parameter)
    met = set()
    for place, leg in enumerate(sweep.legs):
        if leg.name in met:
            raise check.SceneError(f"sweep.legs[{place}].name", "must differ from the other legs' names", leg.name)
        met.add(leg.name)
        _check_leg(f"sweep.legs[{place}]", scene, sweep, leg)
    if sweep.count * sweep.keep * len(sweep.legs) > MOST_STATES:
        rule = f"must keep at most {MOST_STATES:,} states: count times keep times the number of legs"
        raise check.SceneError("sweep.keep", rule, sweep.keep)


def _check_leg(key, scene, sweep, leg):
    for name, value in (("from", leg.first), ("to", leg.last)):
        check.number(f"{key}.{name}", value, np.float64)
    with _under(f"{key} from {leg.first} to {leg.last}: "):
        known(changed(scene, {sweep.parameter: sweep.values(leg)}), np.float64)
    _check_start(f"{key}.start", changed(scene, {sweep.parameter: leg.first}), leg.start)


def _check_branch(scene, branch):
    scene = _check_followed("branch", scene, branch)
    low, high = branch.bounds
    value = float(scene.parameter(branch.parameter))
    if not low <= value <= high:
        if branch.parameter in branch.at:
            rule = f"must lie within branch.bounds, {low} and {high}"
            raise check.SceneError(f"branch.at.{branch.parameter}", rule, value)
        rule = f"must hold the scene's {branch.parameter}, {value}, or that in branch.at"
        raise check.SceneError("branch.bounds", rule, list(branch.bounds))
    _check_start("branch.start", scene, branch.start)
    _check_step("branch.largest_step", branch.largest_step)


def _check_explore(scene, file):
    if file.branch is not None:
        raise check.SceneError("explore", "must not stand beside [branch]", file.explore.parameter)
    _check_followed("explore", scene, file.explore)


def _check_followed(key, scene, asked):
    """The scene of a [branch] or [explore], once its parameter, bounds and values break no rule."""
    _check_name(f"{key}.parameter", scene, asked.parameter)
    _check_bounds(f"{key}.bounds", asked.bounds)
    with _under(f"{key}.at."):
        return known(changed(scene, asked.at), np.float64)


def _check_locus(scene, file):
    asked, source = file.locus, file.followed
    names = list(asked.parameters)
    if source is None:
        raise check.SceneError("locus", "must come with [branch] or [explore], whose special points it follows", names)
    for place, name in enumerate(names):
        _check_name(f"locus.parameters[{place}]", scene, name)
    if names[0] == names[1]:
        raise check.SceneError("locus.parameters", "must be two different parameters", names)
    if set(asked.bounds) != set(names):
        given = ", ".join(asked.bounds) or "none"
        raise check.SceneError("locus.bounds", f"must give [low, high] for {' and for '.join(names)}, no other", given)
    for name in names:
        _check_bounds(f"locus.bounds.{name}", asked.bounds[name])
        _check_reach(f"locus.bounds.{name}", name, asked.bounds[name], scene, file)
    for place, kind in enumerate(asked.kinds):
        if kind not in KINDS or kind in asked.kinds[:place]:
            rule = f"must be one of {', '.join(KINDS)}" if kind not in KINDS else "must differ from the others"
            raise check.SceneError(f"locus.kinds[{place}]", rule, kind)
    _check_step("locus.largest_step", asked.largest_step)


def _check_reach(key, name, bounds, scene, file):
    """Refuse bounds of a locus in which no special point of the branches can lie."""
    table, source = "branch" if file.branch is not None else "explore", file.followed
    (low, high), (least, most) = bounds, source.bounds
    if name == source.parameter:
        if high < least or most < low:
            raise check.SceneError(key, f"must overlap {table}.bounds, {least} and {most}", list(bounds))
        return
    value = float(changed(scene, source.at).parameter(name))
    if not low <= value <= high:
        raise check.SceneError(key, f"must hold the {name} of [{table}], {value}", list(bounds))


def _check_bounds(key, bounds):
    low, high = bounds
    if not (np.isfinite(bounds).all() and low < high):
        raise check.SceneError(key, "must be [low, high], two finite numbers, the first smaller", list(bounds))


def _check_step(key, step):
    step = check.number(key, step, np.float64)
    check.require(key, "must be greater than 0", step, step > 0)


def _check_name(key, scene, name):
    if name not in scene.names:
        raise check.SceneError(key, f"must be a parameter of the scene ({', '.join(scene.names)})", name)


def _check_start(key, scene, start):
    for name in ("x", "v"):
        check.number(f"{key}.{name}", getattr(start, name), np.float64)
    low, high = (_place_at_phase_0(side, getattr(scene, side)) for side in SIDES)
    rule = f"must lie between the walls, here at {low} and {high}"
    check.require(f"{key}.x", rule, start.x, low <= start.x <= high)


def _place_at_phase_0(side, wall):
    if wall is None:
        return -np.inf if side == "left" else np.inf
    if wall.motion is None:
        return float(wall.position)
    return float(wall.position + wall.motion.amplitude * np.cos(wall.motion.phase))
