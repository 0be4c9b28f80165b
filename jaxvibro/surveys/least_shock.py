"""Find the minimal fatal shock of an attractor."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
import xarray as xr
from jaxtyping import ArrayLike, Real

from continuation.branch_segment import make_limits, partial_result_reason

from ..attractors.basin_labels import build_neighbourhoods
from ..attractors.basins import MAX_PERIODS
from ..attractors.find import Attractor, find_attractors
from ..maps.initial_conditions import initial_box
from ..output.table_text import align_columns, column_header
from ..output.units import ANGLE, LENGTH, SPEED, scales_attributes, unit_in_system
from ..scene import check
from ..scene.scene import Scene
from ..scene.state import State
from .shock_search import ShockProblem, ShockResult, empty_result, points_before_shock, search_least_shock

DIRECTIONS = ("v", "xv")
N_SHOCKS = 1 << 18


@dataclass(frozen=True, eq=False)
class LeastShock:
    """Minimal fatal shock of an attractor, with the record of the search.

    Attributes
    ----------
    size : float
        Size of the shock, a speed: ``abs(dv)`` or ``hypot(dx, dv)``. inf if no shock up to `reach` leaves the basin of
        attraction.
    dx : float
        Change of position; nan if no shock leaves the basin.
    dv : float
        Change of velocity; nan if no shock leaves the basin.
    state : State
        State on the attractor just before the shock.
    phase : float
        Phase of the drive at the shock, in rad.
    place : int
        Index of the attractor in `attractors`.
    to : int
        Index of the attractor that the motion approaches after the shock; -1 if no shock leaves the basin.
    bracket : tuple of float
        Size of a shock in the same direction after which the motion returns to the attractor, and `size`.
    until : float
        Size, at most ``2 * size``, up to which all tested shocks in the same direction leave the basin. A value close
        to `size` indicates a thin strip of another basin.
    safe : float
        Size below which no shock at any of the phases leaves the basin, because a trapping region of the attractor
        contains the states after all such shocks. 0 for a chaotic attractor.
    below : int
        Number of tested shocks that are smaller than the smallest shock at the same phase that leaves the basin, summed
        over the phases.
    undecided : int
        Number of the shocks counted in `below` after which the motion approaches no attractor with certainty.
    least_undecided : float
        Size of the smallest undecided shock of all tests; inf if no shock is undecided.
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
        Reason why the search ended before it was complete, else ``""``. After an incomplete search, `size` is the size
        of the smallest tested shock that leaves the basin. Phases without a test have the size nan in `by_phase`.

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
        (length_name, length_unit_size), (speed_name, speed_unit_size) = (
            unit_in_system(self.scene, dimension, units) for dimension in (LENGTH, SPEED)
        )
        headings_and_units = (
            ("size", speed_name),
            ("dx", length_name),
            ("dv", speed_name),
            ("x", length_name),
            ("v", speed_name),
        )
        table_rows = [
            ("phase", *(column_header(name, dimension, units) for name, dimension in headings_and_units), "leads to")
        ]
        unit_size_by_column = {
            "size": speed_unit_size,
            "dx": length_unit_size,
            "dv": speed_unit_size,
            "x": length_unit_size,
            "v": speed_unit_size,
        }
        for phase_index, phase in enumerate(self.by_phase["phase"].values):
            phase_data = self.by_phase.isel(phase=phase_index)
            destination_index = int(phase_data["to"])
            destination_text = (
                f"{destination_index}: {self.attractors[destination_index].label}"
                if destination_index >= 0
                else "none found"
            )
            table_rows.append(
                (
                    f"{phase:.6g}",
                    *(f"{unit_size * float(phase_data[name]):.7g}" for name, unit_size in unit_size_by_column.items()),
                    destination_text,
                )
            )
        test_summary = (
            f"{self.below} smaller shocks tested, {self.undecided} undecided; largest size"
            f" {speed_unit_size * self.reach:.6g}"
        )
        safe_size_text = (
            f"no shock below {speed_unit_size * self.safe:.6g} leaves the trapping region of "
            f"{self.place}: {self.attractors[self.place].label}"
        )
        return "\n".join(
            [align_columns(table_rows), test_summary, safe_size_text, *([self.stopped] if self.stopped else [])]
        )


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

    The search tests evenly distributed shocks in a disc. The disc shrinks to the smallest shock that leaves the basin
    of attraction.

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
        ``hypot(dx, dv)`` in units of the scene, the square root of twice the energy of a mass on the free spring with
        displacement dx and velocity dv.
    reach : float, optional
        Largest size of a tested shock. The default reaches the whole box of initial states.
    shocks : int, optional
        Largest number of evenly distributed shocks in one disc, for each phase. The search ends if no such shock in the
        disc of the smallest shock leaves the basin.
    patience : int, optional
        Largest number of drive periods of a motion, as in `basins`.
    seed : int, optional
        Seed of the random draws.
    progress : callable, optional
        Called with the number of shocks tested.
    max_seconds : float, optional
        Wall-clock time, in s, after which the search ends. The result is then the smallest of the tested shocks, with
        the reason in ``stopped``. None is no limit.

    Returns
    -------
    LeastShock
        Smallest shock, with the record of the search.

    Raises
    ------
    ArgumentError
        If the scene has lanes, the attractor is unresolved or has no trapping region at a phase, or a number is
        invalid. An attractor with an impact at the phase has no trapping region: choose another phase.

    See Also
    --------
    basins : Compute the basins of attraction on a grid.
    fractions : Compute basin fractions, and minimal shocks, along a parameter.

    Notes
    -----
    A shock leaves the basin if the motion after the shock certainly approaches another attractor (see `basins`). A
    shock that moves the mass beyond a rigid wall is impossible and is not counted. A shock after which the motion
    approaches no known attractor is undecided and is counted separately. The result is the smallest of many tested
    shocks, not a proven minimum. No shock smaller than `safe` leaves the basin. The boundary of the basin may be
    fractal, without a gradient that leads to its nearest point. The search therefore simulates the motion after each
    shock, as `basins` does.

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
    computation_limits = make_limits(None, max_seconds, None, check.ArgumentError)
    check.require_single_scene(scene)
    if direction not in DIRECTIONS:
        raise check.ArgumentError("direction", f"must be one of {', '.join(DIRECTIONS)}", direction)
    phases = _check_phases(phase)
    shocks, patience = check.check_whole_number("shocks", shocks, 1), check.check_whole_number("patience", patience, 1)
    place, seed = check.check_whole_number("place", place, 0), check.check_whole_number("seed", seed, 0)
    max_size = None if reach is None else _check_reach(reach)
    attractors = find_attractors(scene) if attractors is None else tuple(attractors)
    if place >= len(attractors) or attractors[place].kind == "unresolved":
        valid_indices = [str(index) for index, attractor in enumerate(attractors) if attractor.kind != "unresolved"]
        raise check.ArgumentError("place", f"must be the index of an attractor ({', '.join(valid_indices)})", place)
    shock_problems = []
    for phase_angle in phases:
        neighbourhoods = build_neighbourhoods(scene, attractors, float(phase_angle))
        if neighbourhoods[place].region is None:
            phase_rule = "must be one at which the attractor has a trapping region and no impact; choose another phase"
            raise check.ArgumentError("phase", phase_rule, float(phase_angle))
        shock_problems.append(
            ShockProblem(scene, float(phase_angle), neighbourhoods, place, direction == "xv", patience)
        )
    max_size = _size_covering_box(shock_problems, *map(float, initial_box(scene))) if max_size is None else max_size
    count_shocks = _make_shock_counter(progress)
    shock_results: list[ShockResult] = []
    for shock_problem in shock_problems:
        has_time = not shock_results or not computation_limits.expired
        shock_results.append(
            search_least_shock(shock_problem, max_size, shocks, seed, count_shocks, computation_limits)
            if has_time
            else empty_result(shock_problem)
        )
    n_complete_phases = sum(shock_result.is_complete for shock_result in shock_results)
    stop_reason = (
        ""
        if n_complete_phases == len(shock_problems)
        else partial_result_reason(n_complete_phases, len(shock_problems), "phases")
    )
    return _make_result(scene, attractors, place, direction, max_size, phases, shock_results, stop_reason)


def _check_phases(phase):
    """Check the phases and return them as an array."""
    phase_angles = np.atleast_1d(check.check_finite_array("phase", phase, np.float64))
    if phase_angles.ndim != 1 or not phase_angles.size:
        raise check.ArgumentError("phase", "must be a number or a sequence of numbers", phase_angles)
    return phase_angles


def _check_reach(reach):
    """Check the largest size of a shock and return it as a float."""
    max_size = check.check_finite_array("reach", reach, np.float64)
    if max_size.shape or max_size <= 0:
        raise check.ArgumentError("reach", "must be a positive number", reach)
    return float(max_size)


def _size_covering_box(shock_problems, start_box_x_min, start_box_x_max, start_box_max_speed):
    """Return a size up to which shocks from each point of the attractor reach the whole box of initial states."""
    attractor_points = np.concatenate(
        [
            points_before_shock(shock_problem.neighbourhoods[shock_problem.attractor_index])
            for shock_problem in shock_problems
        ]
    )
    max_dv = start_box_max_speed + abs(attractor_points[:, 1]).max()
    max_dx = max(attractor_points[:, 0].max() - start_box_x_min, start_box_x_max - attractor_points[:, 0].min())
    return float(np.hypot(max_dx, max_dv) if shock_problems[0].changes_position else max_dv)


def _make_shock_counter(report_n_tested):
    """Return a function that counts the shocks of all calls and reports the total."""
    n_tested = 0

    def count_shocks(n_new_shocks):
        nonlocal n_tested
        n_tested += n_new_shocks
        if report_n_tested is not None:
            report_n_tested(n_tested)

    return count_shocks


def _make_result(scene, attractors, attractor_index, direction, max_size, phases, shock_results, stop_reason):
    """Return the `LeastShock` of the results at all phases."""
    by_phase = _make_dataset(scene, phases, shock_results)
    best_index = int(np.nanargmin([shock_result.size for shock_result in shock_results]))
    best_result = shock_results[best_index]
    return LeastShock(
        size=best_result.size,
        dx=float(best_result.shock[0]),
        dv=float(best_result.shock[1]),
        state=State(
            float(best_result.point_before[0]), float(best_result.point_before[1]), float(phases[best_index]), 0.0
        ),
        phase=float(phases[best_index]),
        place=attractor_index,
        to=best_result.destination_index,
        bracket=best_result.bracket,
        until=best_result.max_leaving_size,
        safe=min(shock_result.safe_size for shock_result in shock_results),
        below=sum(shock_result.n_smaller_tested for shock_result in shock_results),
        undecided=sum(shock_result.n_undecided for shock_result in shock_results),
        least_undecided=min(shock_result.least_undecided for shock_result in shock_results),
        direction=direction,
        reach=max_size,
        attractors=attractors,
        scene=scene,
        by_phase=by_phase,
        stopped=stop_reason,
    )


def _make_dataset(scene, phases, shock_results):
    """Return the results at each phase as a Dataset."""

    def make_variable(get_value, dtype=float, **attrs):
        return "phase", np.array([get_value(shock_result) for shock_result in shock_results], dtype), attrs

    return xr.Dataset(
        {
            "size": make_variable(lambda result: result.size, long_name="least shock that leaves", units=SPEED),
            "dx": make_variable(lambda result: result.shock[0], units=LENGTH),
            "dv": make_variable(lambda result: result.shock[1], units=SPEED),
            "x": make_variable(lambda result: result.point_before[0], long_name="displacement before it", units=LENGTH),
            "v": make_variable(lambda result: result.point_before[1], long_name="velocity before it", units=SPEED),
            "to": make_variable(
                lambda result: result.destination_index, int, long_name="attractor that it leads to, -1 none"
            ),
            "until": make_variable(
                lambda result: result.max_leaving_size, long_name="up to here all in its direction leave", units=SPEED
            ),
            "safe": make_variable(lambda result: result.safe_size, long_name="no smaller one leaves", units=SPEED),
            "below": make_variable(lambda result: result.n_smaller_tested, int, long_name="smaller ones tried"),
            "undecided": make_variable(
                lambda result: result.n_undecided, int, long_name="smaller ones that end on nothing known"
            ),
            "least_undecided": make_variable(
                lambda result: result.least_undecided, long_name="the least of all such", units=SPEED
            ),
        },
        coords={"phase": ("phase", phases, {"long_name": "of the drive", "units": ANGLE})},
        attrs={**scene.numbers, **scales_attributes(scene)},
    )
