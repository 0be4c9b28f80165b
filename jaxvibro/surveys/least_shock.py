"""How hard a blow an attractor bears: the least shock that makes the motion leave it for another one."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
import xarray as xr
from jaxtyping import ArrayLike, Real

from continuation.limits import limits_of, partial_reason

from ..attractors.basin_labels import build_neighbourhoods
from ..attractors.basins import MAX_PERIODS
from ..attractors.find import Attractor, find_attractors
from ..maps.initial_conditions import initial_box
from ..output.table_text import align_columns, column_header
from ..output.units import ANGLE, LENGTH, SPEED, scales_attributes, unit_in_system
from ..scene import check
from ..scene.scene import Scene
from ..scene.state import State
from .shock_search import ShockProblem, ShockResult, base_points, empty_result, search_least_shock

DIRECTIONS = ("v", "xv")
N_SHOCKS = 1 << 18


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
        (length_name, x_unit), (speed_name, v_unit) = (
            unit_in_system(self.scene, unit, units) for unit in (LENGTH, SPEED)
        )
        headings = (
            ("size", speed_name),
            ("dx", length_name),
            ("dv", speed_name),
            ("x", length_name),
            ("v", speed_name),
        )
        rows = [("phase", *(column_header(name, unit, units) for name, unit in headings), "leads to")]
        factors = {"size": v_unit, "dx": x_unit, "dv": v_unit, "x": x_unit, "v": v_unit}
        for phase_index, phase in enumerate(self.by_phase["phase"].values):
            phase_data = self.by_phase.isel(phase=phase_index)
            destination = int(phase_data["to"])
            destination_text = (
                f"{destination}: {self.attractors[destination].label}" if destination >= 0 else "none found"
            )
            rows.append(
                (
                    f"{phase:.6g}",
                    *(f"{factor * float(phase_data[name]):.7g}" for name, factor in factors.items()),
                    destination_text,
                )
            )
        note = f"{self.below} smaller shocks tried, {self.undecided} of them undecided; up to {v_unit * self.reach:.6g}"
        safe = (
            f"none below {v_unit * self.safe:.6g} leaves the trap of {self.place}: {self.attractors[self.place].label}"
        )
        return "\n".join([align_columns(rows), note, safe, *([self.stopped] if self.stopped else [])])


@check.host_only("use strobe")
def least_shock(
    scene: Scene,
    attractors: Sequence[Attractor] | None = None,
    place: int = 0,
    phase: Real[ArrayLike, "..."] | Sequence[float] = 0.0,
    direction: str = "v",
    reach: float | None = None,
    shocks: int = N_SHOCKS,
    patience: int = MAX_PERIODS,
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
    phases = _check_phases(phase)
    shocks, patience = check.whole_number("shocks", shocks, 1), check.whole_number("patience", patience, 1)
    place, seed = check.whole_number("place", place, 0), check.whole_number("seed", seed, 0)
    max_size = None if reach is None else _check_reach(reach)
    attractors = find_attractors(scene) if attractors is None else tuple(attractors)
    if place >= len(attractors) or attractors[place].kind == "unresolved":
        valid_indices = [str(index) for index, item in enumerate(attractors) if item.kind != "unresolved"]
        raise check.ArgumentError("place", f"must be that of an attractor ({', '.join(valid_indices)})", place)
    x_min, x_max, max_speed = (float(bound) for bound in initial_box(scene))
    problems = []
    for phase_angle in phases:
        neighbourhoods = build_neighbourhoods(
            scene, attractors, float(phase_angle), max(abs(x_min), abs(x_max), max_speed)
        )
        if neighbourhoods[place].region is None:
            rule = "an impact of the attractor falls on it, or it draws nothing in for certain: take another one"
            raise check.ArgumentError("phase", rule, float(phase_angle))
        problems.append(ShockProblem(scene, float(phase_angle), neighbourhoods, place, direction == "xv", patience))
    max_size = _box_reach(problems, x_min, x_max, max_speed) if max_size is None else max_size
    count_shocks = _shock_counter(progress)
    results: list[ShockResult] = []
    for problem in problems:
        may_search = not results or not limits.expired
        results.append(
            search_least_shock(problem, max_size, shocks, seed, count_shocks, limits)
            if may_search
            else empty_result(problem)
        )
    n_complete = sum(item.complete for item in results)
    stopped = "" if n_complete == len(problems) else partial_reason(n_complete, len(problems), "phases")
    return _make_result(scene, attractors, place, direction, max_size, phases, results, stopped)


def _check_phases(phase):
    phase_angles = np.atleast_1d(check.finite_array("phase", phase, np.float64))
    if phase_angles.ndim != 1 or not phase_angles.size:
        raise check.ArgumentError("phase", "must be a number or a sequence of numbers", phase_angles)
    return phase_angles


def _check_reach(reach):
    max_size = check.finite_array("reach", reach, np.float64)
    if max_size.shape or max_size <= 0:
        raise check.ArgumentError("reach", "must be a positive number", reach)
    return float(max_size)


def _box_reach(problems, x_min, x_max, max_speed):
    """A size within which every point has all of the box."""
    points = np.concatenate([base_points(problem.neighbourhoods[problem.attractor_index]) for problem in problems])
    speed = max_speed + abs(points[:, 1]).max()
    length = max(points[:, 0].max() - x_min, x_max - points[:, 0].min())
    return float(np.hypot(length, speed) if problems[0].is_planar else speed)


def _shock_counter(progress):
    """What counts the shocks of all calls, and tells them."""
    n_tried = 0

    def count_shocks(n_new):
        nonlocal n_tried
        n_tried += n_new
        if progress is not None:
            progress(n_tried)

    return count_shocks


def _make_result(scene, attractors, index, direction, max_size, phases, results, stopped):
    by_phase = _make_dataset(scene, phases, results)
    best_index = int(np.nanargmin([result.size for result in results]))
    best_result = results[best_index]
    return LeastShock(
        size=best_result.size,
        dx=float(best_result.shock[0]),
        dv=float(best_result.shock[1]),
        state=State(
            float(best_result.point_before[0]), float(best_result.point_before[1]), float(phases[best_index]), 0.0
        ),
        phase=float(phases[best_index]),
        place=index,
        to=best_result.to,
        bracket=best_result.bracket,
        until=best_result.until,
        safe=min(result.safe for result in results),
        below=sum(result.below for result in results),
        undecided=sum(result.undecided for result in results),
        least_undecided=min(result.least_undecided for result in results),
        direction=direction,
        reach=max_size,
        attractors=attractors,
        scene=scene,
        by_phase=by_phase,
        stopped=stopped,
    )


def _make_dataset(scene, phases, results):
    def variable(getter, dtype=float, **attrs):
        return "phase", np.array([getter(result) for result in results], dtype), attrs

    return xr.Dataset(
        {
            "size": variable(lambda result: result.size, long_name="least shock that leaves", units=SPEED),
            "dx": variable(lambda result: result.shock[0], units=LENGTH),
            "dv": variable(lambda result: result.shock[1], units=SPEED),
            "x": variable(lambda result: result.point_before[0], long_name="displacement before it", units=LENGTH),
            "v": variable(lambda result: result.point_before[1], long_name="velocity before it", units=SPEED),
            "to": variable(lambda result: result.to, int, long_name="attractor that it leads to, -1 none"),
            "until": variable(
                lambda result: result.until, long_name="up to here all in its direction leave", units=SPEED
            ),
            "safe": variable(lambda result: result.safe, long_name="no smaller one leaves", units=SPEED),
            "below": variable(lambda result: result.below, int, long_name="smaller ones tried"),
            "undecided": variable(
                lambda result: result.undecided, int, long_name="smaller ones that end on nothing known"
            ),
            "least_undecided": variable(
                lambda result: result.least_undecided, long_name="the least of all such", units=SPEED
            ),
        },
        coords={"phase": ("phase", phases, {"long_name": "of the drive", "units": ANGLE})},
        attrs={**scene.numbers, **scales_attributes(scene)},
    )
