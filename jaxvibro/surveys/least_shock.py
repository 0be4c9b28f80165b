"""Find the minimal fatal shock of an attractor."""

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
    """Minimal fatal shock of an attractor, with the record of the search.

    Attributes
    ----------
    size : float
        Size of the shock, a speed: ``abs(dv)`` or ``hypot(dx, dv)``. inf if no shock up to `reach` leaves.
    dx : float
        Change of position; nan without a shock.
    dv : float
        Change of velocity; nan without a shock.
    state : State
        State on the attractor just before the shock.
    phase : float
        Phase of the drive at the shock, in rad.
    place : int
        Index of the attractor in `attractors`.
    to : int
        Index of the attractor that the motion approaches after the shock; -1 without a shock.
    bracket : tuple of float
        A size in the direction of the shock at which the motion stays, and `size`.
    until : float
        All tested shocks in this direction between `size` and this size, at most ``2 * size``, leave. A value close to
        `size` indicates a thin strip of a basin.
    safe : float
        No smaller shock leaves at any of the phases, since a trapping region of the attractor contains all of them. 0
        for a chaotic attractor.
    below : int
        Number of tested shocks that are smaller than the smallest that leaves at their phase, over all phases.
    undecided : int
        Number of these that do not certainly approach any attractor of the tuple.
    least_undecided : float
        Size of the smallest of all such shocks; inf without.
    direction : {"v", "xv"}
        Direction of the shocks.
    reach : float
        Largest size searched.
    attractors : tuple of Attractor
        Attractors of the scene.
    scene : Scene
        Scene.
    by_phase : xarray.Dataset
        Size, dx, dv, x, v, to, until, safe, below, undecided and least_undecided at each phase.
    stopped : str
        Reason why the search ended before it was complete, else ``""``. `size` is then the smallest shock up to then,
        nan at a phase without a test.

    Examples
    --------
    >>> shock = jv.least_shock(scene, jv.find_attractors(scene, starts=50), shocks=1000)
    >>> lower, upper = shock.bracket
    >>> lower < upper == shock.size, round(shock.safe, 3)
    (True, 0.322)
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
        """Format the result as a table with one line per phase.

        Parameters
        ----------
        units : {"scene", "physical"}, optional
            Units of the table. Physical units need a scene with scales.

        Returns
        -------
        str
            Table and a summary of the search.

        Raises
        ------
        ArgumentError
            If `units` is unknown, or physical units are requested of a scene without scales.
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
        note = f"{self.below} smaller shocks tested, {self.undecided} undecided; largest size {v_unit * self.reach:.6g}"
        safe = (
            f"no shock below {v_unit * self.safe:.6g} leaves the trapping region of "
            f"{self.place}: {self.attractors[self.place].label}"
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
    """Find the smallest shock that moves the motion from one attractor to another.

    The search draws evenly distributed shocks in a disc and shrinks the disc to the smallest shock that leaves.

    Parameters
    ----------
    scene : Scene
        Scene without lanes.
    attractors : sequence of Attractor, optional
        Attractors as returned by `find_attractors`. None computes them.
    place : int, optional
        Index of the attractor that is perturbed.
    phase : float or array_like, optional
        Phase or phases of the drive at the shock, in rad. The result is the smallest shock over all phases, and over
        all points of the attractor at a phase: n points of an orbit of n periods, or a sample of a chaotic attractor.
    direction : {"v", "xv"}, optional
        ``"v"`` changes the velocity only, in both directions. ``"xv"`` also changes the position; the size is then
        ``hypot(dx, dv)`` in units of the scene, the square root of twice its energy in the free spring.
    reach : float, optional
        Largest size searched. The default reaches the whole box of initial states.
    shocks : int, optional
        Number of consecutive smaller shocks, evenly distributed, that must stay at each phase.
    patience : int, optional
        Largest number of drive periods of a motion, as in `basins`.
    seed : int, optional
        Seed of the random draws.
    progress : callable, optional
        Called with the number of shocks tested.
    max_seconds : float, optional
        Wall-clock time, in s, after which the smallest shock up to then is returned, with the reason in ``stopped``.
        None is no limit.

    Returns
    -------
    LeastShock
        Smallest shock, with the record of the search.

    Raises
    ------
    ArgumentError
        If the scene has lanes, the attractor is unresolved or has no trapping region at a phase (an impact falls on
        that phase: choose another one), or a number is invalid.

    See Also
    --------
    basins : Compute the basins of attraction on a grid.
    fractions : Compute basin fractions, and minimal shocks, along a parameter.

    Notes
    -----
    A shock leaves if the motion after it certainly approaches another attractor (see `basins`). A shock through a rigid
    wall is impossible. A shock after which the motion approaches no known attractor does not count as leaving and is
    counted separately. The result is the smallest of many tested shocks, not a proven minimum. Below `safe` no shock
    leaves. A boundary that is fractal has no gradient that leads to it, so the search tests shocks as `basins` does.

    References
    ----------
    Halekotte and Feudel, Sci. Rep. 10, 11783 (2020): minimal fatal shocks.

    Examples
    --------
    >>> attractors = jv.find_attractors(scene, starts=50)
    >>> shock = jv.least_shock(scene, attractors, shocks=1000)
    >>> shock.direction, attractors[shock.to].label, round(shock.size, 2)
    ('v', 'P100', 4.15)
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
        raise check.ArgumentError("place", f"must be the index of an attractor ({', '.join(valid_indices)})", place)
    x_min, x_max, max_speed = (float(bound) for bound in initial_box(scene))
    problems = []
    for phase_angle in phases:
        neighbourhoods = build_neighbourhoods(
            scene, attractors, float(phase_angle), max(abs(x_min), abs(x_max), max_speed)
        )
        if neighbourhoods[place].region is None:
            rule = "must be one at which the attractor has a trapping region and no impact; choose another phase"
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
    """Return the phases as an array, checked."""
    phase_angles = np.atleast_1d(check.finite_array("phase", phase, np.float64))
    if phase_angles.ndim != 1 or not phase_angles.size:
        raise check.ArgumentError("phase", "must be a number or a sequence of numbers", phase_angles)
    return phase_angles


def _check_reach(reach):
    """Return the largest size of a shock, checked."""
    max_size = check.finite_array("reach", reach, np.float64)
    if max_size.shape or max_size <= 0:
        raise check.ArgumentError("reach", "must be a positive number", reach)
    return float(max_size)


def _box_reach(problems, x_min, x_max, max_speed):
    """Return a size within which every point of the attractor reaches the whole box."""
    points = np.concatenate([base_points(problem.neighbourhoods[problem.attractor_index]) for problem in problems])
    speed = max_speed + abs(points[:, 1]).max()
    length = max(points[:, 0].max() - x_min, x_max - points[:, 0].min())
    return float(np.hypot(length, speed) if problems[0].is_planar else speed)


def _shock_counter(progress):
    """Return a function that counts the shocks of all calls and reports the total."""
    n_tried = 0

    def count_shocks(n_new):
        nonlocal n_tried
        n_tried += n_new
        if progress is not None:
            progress(n_tried)

    return count_shocks


def _make_result(scene, attractors, index, direction, max_size, phases, results, stopped):
    """Return the `LeastShock` of the results at all phases."""
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
    """Return the results at each phase as a Dataset."""

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
