"""How hard a blow an attractor bears: the least shock that makes the motion leave it for another one."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
import xarray as xr
from jaxtyping import ArrayLike, Real

from continuation.limits import limits_of, partial_reason

from ..attractors.assign import homes
from ..attractors.basins import PATIENCE
from ..attractors.find import Attractor, find_attractors
from ..maps.initial_conditions import box
from ..output.table_text import columns, headed
from ..output.units import ANGLE, LENGTH, SPEED, scales_in, unit_in
from ..scene import check
from ..scene.scene import Scene
from ..scene.state import State
from .shock_search import Found, Ground, base, search, unsearched

DIRECTIONS = ("v", "xv")
SHOCKS = 1 << 18


@dataclass(frozen=True, eq=False)
class LeastShock:
    """The least shock found that makes a motion leave its attractor, and how it was looked for.

    size: abs(dv), or hypot(dx, dv), a speed; inf where no shock up to `reach` leaves. dx, dv: the shock, nan without
    one. state: just before it, on the attractor, at `phase` (rad). place: of the attractor in the tuple; to: of the one
    that the motion ends on, -1 without a shock. bracket: two sizes in this direction: one at which it was seen to stay,
    and `size`. until: up to this size, at most twice `size`, all that were tried in this direction leave; where it is
    close to `size` the shock leads into a thin strip of a basin. safe: no smaller shock leaves at any of the phases, as
    a trap of the attractor holds them all; 0 of a chaotic one. below: smaller shocks that were tried, at all phases:
    none was seen to leave, at its phase, below that phase's own least. undecided: how many shocks smaller than that
    were certain to end on no attractor of the tuple; least_undecided: the least of all such, inf without. reach: how
    large a shock was looked for. by_phase: size, dx, dv, x, v, to, until, safe, below, undecided, least_undecided, at
    each phase. stopped: why the search ended before it was complete, else ""; `size` is then the least shock so far,
    nan at a phase at which none has been tried.
    """

    size: float
    dx: float
    dv: float
    state: State
    phase: float
    place: int
    to: int
    bracket: tuple[float, float]
    until: float
    safe: float
    below: int
    undecided: int
    least_undecided: float
    direction: str
    reach: float
    attractors: tuple[Attractor, ...] = field(repr=False)
    scene: Scene = field(repr=False)
    by_phase: xr.Dataset = field(repr=False)
    stopped: str = ""

    def table(self, units: str = "scene") -> str:
        """A line for each phase, and how it was looked for. units: "scene", or "physical" of a scene that has scales.

        Raises ArgumentError for other units, and where the scene has no scales.
        """
        (length, long), (speed, fast) = (unit_in(self.scene, unit, units) for unit in (LENGTH, SPEED))
        heads = (("size", speed), ("dx", length), ("dv", speed), ("x", length), ("v", speed))
        rows = [("phase", *(headed(name, unit, units) for name, unit in heads), "leads to")]
        scales = {"size": fast, "dx": long, "dv": fast, "x": long, "v": fast}
        for k, phase in enumerate(self.by_phase["phase"].values):
            one = self.by_phase.isel(phase=k)
            to = int(one["to"])
            named = f"{to}: {self.attractors[to].label}" if to >= 0 else "none found"
            rows.append((f"{phase:.6g}", *(f"{size * float(one[name]):.7g}" for name, size in scales.items()), named))
        told = f"{self.below} smaller shocks tried, {self.undecided} of them undecided; up to {fast * self.reach:.6g}"
        safe = f"none below {fast * self.safe:.6g} leaves the trap of {self.place}: {self.attractors[self.place].label}"
        return "\n".join([columns(rows), told, safe, *([self.stopped] if self.stopped else [])])


@check.host("use strobe")
def least_shock(
    scene: Scene,
    attractors: Sequence[Attractor] | None = None,
    place: int = 0,
    phase: Real[ArrayLike, "..."] | Sequence[float] = 0.0,
    direction: str = "v",
    reach: float | None = None,
    shocks: int = SHOCKS,
    patience: int = PATIENCE,
    seed: int = 0,
    progress: Callable[[int], object] | None = None,
    *,
    max_seconds: float | None = None,
) -> LeastShock:
    """The least shock that makes the motion leave an attractor for another one: a `LeastShock`.

    scene: a single one. attractors: a tuple as from `find_attractors`, which is asked where it is None; place: in it,
    of the one that is struck. phase: of the drive at the shock, rad, one or several: the least over all of them is the
    answer, and over all points that the attractor has there: n of an orbit of n periods, of a chaotic one a sample.
    direction: "v", an impulse, which changes the velocity alone, either way; "xv", position too: its size is then
    hypot(dx, dv) in the scene's units, the square root of twice the energy that it has in the free spring. reach: the
    largest size that is looked for; by default all of `initial_conditions.box` is within it. shocks: so many in a row,
    evenly over all smaller ones, must stay, at each phase. patience: drive periods that a motion may take, as in
    `basins`. seed: of the random draws. progress: called with the number of shocks tried so far. max_seconds:
    wall-clock time, s, after which the least shock so far is returned, and `stopped` says so; None is no limit.

    A shock leaves where the motion after it ends on another attractor for certain (`basins`). One beyond a rigid wall
    cannot be; one that ends on nothing known does not count as leaving, and is counted apart. Found is the least of
    very many shocks, not proved: the minimal fatal shock of Halekotte and Feudel, Sci. Rep. 10, 11783 (2020), by
    search as basins are (no slope leads to an edge that is fractal). Below `safe` no shock leaves.

    Raises ArgumentError for a batch of scenes, an attractor that is unresolved, or that has no trap at a phase (an
    impact falls on it: take another one), and for numbers that cannot be.
    """
    limits = limits_of(None, max_seconds, None, check.ArgumentError)
    check.require_single(scene)
    if direction not in DIRECTIONS:
        raise check.ArgumentError("direction", f"must be one of {', '.join(DIRECTIONS)}", direction)
    phases = _phases(phase)
    shocks, patience = check.whole("shocks", shocks, 1), check.whole("patience", patience, 1)
    place, seed = check.whole("place", place, 0), check.whole("seed", seed, 0)
    far = None if reach is None else _reach(reach)
    attractors = find_attractors(scene) if attractors is None else tuple(attractors)
    if place >= len(attractors) or attractors[place].kind == "unresolved":
        known = [str(k) for k, one in enumerate(attractors) if one.kind != "unresolved"]
        raise check.ArgumentError("place", f"must be that of an attractor ({', '.join(known)})", place)
    left, right, fast = (float(edge) for edge in box(scene))
    grounds = []
    for angle in phases:
        found = homes(scene, attractors, float(angle), max(abs(left), abs(right), fast))
        if found[place].trap is None:
            rule = "an impact of the attractor falls on it, or it draws nothing in for certain: take another one"
            raise check.ArgumentError("phase", rule, float(angle))
        grounds.append(Ground(scene, float(angle), found, place, direction == "xv", patience))
    far = _whole_box(grounds, left, right, fast) if far is None else far
    count = _counter(progress)
    results: list[Found] = []
    for ground in grounds:
        begins = not results or not limits.expired
        results.append(search(ground, far, shocks, seed, count, limits) if begins else unsearched(ground))
    complete = sum(one.complete for one in results)
    stopped = "" if complete == len(grounds) else partial_reason(complete, len(grounds), "phases")
    return _answer(scene, attractors, place, direction, far, phases, results, stopped)


def _phases(phase):
    angles = np.atleast_1d(check.number("phase", phase, np.float64))
    if angles.ndim != 1 or not angles.size:
        raise check.ArgumentError("phase", "must be a number or a sequence of numbers", angles)
    return angles


def _reach(reach):
    far = check.number("reach", reach, np.float64)
    if far.shape or far <= 0:
        raise check.ArgumentError("reach", "must be a positive number", reach)
    return float(far)


def _whole_box(grounds, left, right, fast):
    """A size within which every point has all of the box."""
    points = np.concatenate([base(ground.homes[ground.place]) for ground in grounds])
    speed = fast + abs(points[:, 1]).max()
    length = max(points[:, 0].max() - left, right - points[:, 0].min())
    return float(np.hypot(length, speed) if grounds[0].plane else speed)


def _counter(progress):
    """What counts the shocks of all calls, and tells them."""
    tried = 0

    def count(number):
        nonlocal tried
        tried += number
        if progress is not None:
            progress(tried)

    return count


def _answer(scene, attractors, place, direction, reach, phases, results, stopped):
    data = _dataset(scene, phases, results)
    best = int(np.nanargmin([one.size for one in results]))
    least = results[best]
    return LeastShock(
        size=least.size,
        dx=float(least.change[0]),
        dv=float(least.change[1]),
        state=State(float(least.before[0]), float(least.before[1]), float(phases[best]), 0.0),
        phase=float(phases[best]),
        place=place,
        to=least.to,
        bracket=least.bracket,
        until=least.until,
        safe=min(one.safe for one in results),
        below=sum(one.below for one in results),
        undecided=sum(one.undecided for one in results),
        least_undecided=min(one.least_undecided for one in results),
        direction=direction,
        reach=reach,
        attractors=attractors,
        scene=scene,
        by_phase=data,
        stopped=stopped,
    )


def _dataset(scene, phases, results):
    def all_of(read, dtype=float, **attrs):
        return "phase", np.array([read(one) for one in results], dtype), attrs

    return xr.Dataset(
        {
            "size": all_of(lambda one: one.size, long_name="least shock that leaves", units=SPEED),
            "dx": all_of(lambda one: one.change[0], units=LENGTH),
            "dv": all_of(lambda one: one.change[1], units=SPEED),
            "x": all_of(lambda one: one.before[0], long_name="displacement before it", units=LENGTH),
            "v": all_of(lambda one: one.before[1], long_name="velocity before it", units=SPEED),
            "to": all_of(lambda one: one.to, int, long_name="attractor that it leads to, -1 none"),
            "until": all_of(lambda one: one.until, long_name="up to here all in its direction leave", units=SPEED),
            "safe": all_of(lambda one: one.safe, long_name="no smaller one leaves", units=SPEED),
            "below": all_of(lambda one: one.below, int, long_name="smaller ones tried"),
            "undecided": all_of(lambda one: one.undecided, int, long_name="smaller ones that end on nothing known"),
            "least_undecided": all_of(lambda one: one.least_undecided, long_name="the least of all such", units=SPEED),
        },
        coords={"phase": ("phase", phases, {"long_name": "of the drive", "units": ANGLE})},
        attrs={**scene.numbers, **scales_in(scene)},
    )
