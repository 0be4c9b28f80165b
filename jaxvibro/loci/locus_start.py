"""Start loci at special points of branches, and follow one of their directions."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from continuation import continuation_loop
from continuation.arclength import Point, make_control, make_start_point
from continuation.branch_segment import UNLIMITED, Limits, SpecialIndex, map_fields
from continuation.continuation_loop import ContinuationTask
from continuation.event_search import unit_tangent

from ..branches.branch import Special
from ..branches.follow import check_follow_settings
from ..orbits.flight_clearance import GRAZING_TOLERANCE
from ..problem import curve_ends, soft_wall_grazing
from ..problem.curve_ends import OrbitEventDetector, convert_segment_end
from ..problem.grazing_contact import (
    ZERO_RATE,
    contact_durations_at,
    distance_growth_rate,
    find_grazing_contacts,
    scene_wall_sides,
)
from ..problem.orbit_equations import are_releases, diagnose, mark_impact_rows
from ..problem.orbit_point import is_own_mirror_image
from ..problem.orbit_problem import OrbitProblem, make_orbit_problem
from ..scene import check
from ..scene.scene import Scene
from ..scene.scene_parameters import (
    check_parameter_bounds,
    common_parameter_value,
    flatten_names,
    limit_bounds_to_domains,
)
from ..scene.scene_properties import stays_symmetric
from . import codim2_points
from .locus_equations import GrazingCondition, SingularCondition, StickingLimitCondition


class LocusDirection(NamedTuple):
    """Direction in which a locus is tracked.

    Attributes
    ----------
    kind : str
        Kind of the special points along the locus.
    scene : Scene
        Scene at the start of the locus.
    task : ContinuationTask
        Task whose ``args`` are the problem of the locus.
    start : Point
        First point. Its tangent points in the direction.
    names : tuple of str
        Names of the two parameters.
    bounds : dict of str to tuple of float
        Lower and upper bound of each parameter, by name.
    codim2_index : SpecialIndex or None
        Point of codimension two from which the locus emanates, as a special point in the first row of the segment.
    codim2_z : numpy.ndarray or None
        z of this point if `start` is at a small distance from it.
    """

    kind: str
    scene: Scene
    task: ContinuationTask
    start: Point
    names: tuple[str, str]
    bounds: dict[str, tuple[float, float]]
    codim2_index: SpecialIndex | None = None
    codim2_z: Float[np.ndarray, " unknowns"] | None = None

    @property
    def problem(self) -> OrbitProblem:
        """Problem of the locus."""
        return self.task.args

    def with_limits(self, limits: Limits) -> "LocusDirection":
        """Return the direction with other limits."""
        return self._replace(task=self.task._replace(limits=limits))

    def from_point(
        self, z: Float[np.ndarray, " unknowns"], tangent: Float[np.ndarray, " unknowns"]
    ) -> "LocusDirection":
        """Return the direction from another point of the locus, which is closed if it returns to that point."""
        return self._replace(start=make_start_point(z, tangent), task=self.task._replace(starts=(np.asarray(z),)))

    def reverse(self) -> "LocusDirection":
        """Return the opposite direction."""
        return self._replace(start=make_start_point(self.start.z, -self.start.tangent))

    @property
    def is_admissible(self) -> bool:
        """True if no other grazing contact penetrates its wall and no grazing impact loses speed in this direction."""
        problem, z, tangent = self.problem, self.start.z, self.start.tangent
        side_codes, contact_durations, n_rows = (
            scene_wall_sides(problem.scene),
            contact_durations_at(problem, z),
            len(problem.sequence.sides),
        )
        grazing_contacts = find_grazing_contacts(problem, z)
        contact_locations = [
            (
                contact.row,
                side_codes.index(contact.side),
                contact.time_since_impact - float(contact_durations[contact.row]),
            )
            for contact in grazing_contacts
            if not contact.is_impact
        ]
        speed_rates = [
            tangent[n_rows + contact.row]
            for contact in grazing_contacts
            if contact.is_impact and contact.row in problem.impact_rows
        ]
        return all(
            opening_rate > -ZERO_RATE
            for opening_rate in (
                *speed_rates,
                *(
                    distance_growth_rate(problem, z, tangent, *contact_location)
                    for contact_location in contact_locations
                ),
            )
        )


class LocusEventDetector(OrbitEventDetector):
    """Event detector of a locus: points of codimension two, and a grazing contact that ends the locus."""

    def refine_points(self, task, points, diagnostics):
        return super().refine_points(task, points._replace(residual=_newton_residuals(task, points)), diagnostics)

    def end_kind(self, z):
        """Return the kind of special point at which the orbit becomes inadmissible: GR, GG, CH or RL."""
        problem = self.problem
        if isinstance(problem.condition, StickingLimitCondition):
            return "GR" if find_grazing_contacts(problem, z) else "CH"
        return curve_ends.sticking_limit_kind(problem, z) or (
            "GG" if isinstance(problem.condition, GrazingCondition) else "GR"
        )

    def find_events(self, task, points, diagnostics, known_branch_points, termination):
        return codim2_points.locate_codim2_events(task, points, diagnostics)


def track_locus(locus_direction):
    """Track a locus in one `LocusDirection`; return its segment, from the point of codimension two if there is one."""
    segment = convert_segment_end(continuation_loop.follow_branch(locus_direction.task, locus_direction.start))
    if locus_direction.codim2_z is not None:
        segment = _prepend_point(segment, locus_direction.codim2_z, locus_direction.task.control.scale)
    if locus_direction.codim2_index is not None:
        segment = segment._replace(specials=(locus_direction.codim2_index, *segment.specials))
    return segment


def _prepend_point(segment, z, scale):
    """Return the segment with the point z, which is at a small distance from its first point, prepended."""
    origin_distance = np.linalg.norm(scale * (segment.points.z[0] - z))
    origin_point = make_start_point(z, (segment.points.z[0] - z) / origin_distance)
    points = map_fields(
        lambda leaf, first_entry: np.concatenate([np.asarray(first_entry)[None], leaf]), segment.points, origin_point
    )
    points.step[1] = origin_distance
    diagnostics = map_fields(
        lambda leaf, first_entry: np.concatenate([first_entry, leaf]),
        segment.diagnostics,
        diagnose(segment.args, z[None]),
    )
    return segment._replace(
        points=points,
        diagnostics=diagnostics,
        specials=tuple(special_record._replace(row=special_record.row + 1) for special_record in segment.specials),
    )


def _newton_residuals(task, points):
    """Return the residual of each point.

    The stored residual is that before the last step of Newton's method. If it exceeds the tolerance, the residual is
    evaluated again at the point.
    """
    residual_by_point = points.residual.copy()
    for point_index in np.flatnonzero(
        residual_by_point > task.control.tolerance * (1.0 + abs(points.z[:, -2:]).max(axis=1))
    ):
        residual_by_point[point_index] = abs(task.args.evaluate(points.z[point_index])[0]).max()
    return residual_by_point


KINDS = "SN", "PD", "SB", "GR"  # kinds that `follow_loci` continues by default
STICKING_KINDS = "CH", "RL"  # limits of a sticking phase; a CH that ends a branch has no locus


def check_special_point(special, kinds=KINDS):
    """Check that a locus may start at a special point.

    Raises ArgumentError unless it is a `Special` of one of `kinds`, and for a CH or RL without a sticking phase.
    """
    if not isinstance(special, Special) or special.kind not in kinds:
        refused_value = special.kind if isinstance(special, Special) else special
        raise check.ArgumentError("special", f"must be a special point of kind {', '.join(kinds)}", refused_value)
    if special.kind in STICKING_KINDS and not are_releases(special.spot.sides).any():
        rule = "must have a sticking phase; a chatter that ends its branch has no locus"
        raise check.ArgumentError("special", rule, f"{special.kind} at {special.value:.12g}")


def forward_locus_directions(
    kind, scene, orbit_point, names, bounds, first_step, largest_step, tolerance, limits=UNLIMITED
):
    """Return the `LocusDirection` records from an `OrbitPoint` at which a locus of a kind starts, in two parameters.

    The list has one record, or at a GR one record for each grazing contact. Each direction is that of increasing values
    of the second parameter. Raises ArgumentError if an argument is invalid.
    """
    step_settings = first_step, largest_step, tolerance
    names, bounds = check_locus_arguments(scene, names, bounds, *step_settings)
    directions = []
    for problem, z in problems_at_locus_start(kind, scene, orbit_point, names):
        task = make_locus_task(scene, problem, z, names, bounds, *step_settings, limits)
        tangent = unit_tangent(problem.equations, z, task.control.scale, problem)
        solution = problem.take_step(make_start_point(z, tangent), 0.0, task.control)
        direction = LocusDirection(kind, scene, task, make_start_point(z, tangent), names, bounds)
        directions.append(direction.from_point(solution.z if solution.converged else z, tangent))
    return directions


def check_locus_arguments(scene, names, bounds, *step_settings):
    """Check the arguments of a locus; return the pair of names and the bounds by name. Raises ArgumentError."""
    names = check_parameter_pair(scene, names)
    if not isinstance(bounds, dict) or set(bounds) != set(names):
        raise check.ArgumentError("bounds", f"must give (low, high) for {names[0]} and for {names[1]}, by name", bounds)
    bounds = {name: check_parameter_bounds(scene, name, bounds[name]) for name in names}
    check_follow_settings(*step_settings, (), ())
    return names, bounds


def make_locus_task(scene, problem, z, names, bounds, first_step, largest_step, tolerance, limits=UNLIMITED):
    """Make the `ContinuationTask` of a locus that starts at z."""
    bounds_in_domains, domain_ends = limit_bounds_to_domains(scene, names, bounds.values())
    weights = problem.weights()
    for k, name in enumerate(names, -2):
        if name.endswith(".stiffness"):  # it varies over orders of magnitude
            weights[k] = 1.0 / (1.0 + abs(z[k]))
    return ContinuationTask(
        problem.equations,
        problem,
        make_control(weights, first_step, largest_step, tolerance, bounds_in_domains[1]),
        min(first_step, largest_step),
        bounds_in_domains,
        domain_ends,
        LocusEventDetector(problem),
        starts=(z,),
        limits=limits,
    )


def check_parameter_pair(scene, names):
    """Check that names are two different parameters of a scene. Raises ArgumentError."""
    pair = tuple(names) if isinstance(names, tuple | list) else ()
    for name in pair:
        check.require_parameter(name, scene.names, name)
    if len(pair) != 2 or pair[0] == pair[1]:
        raise check.ArgumentError("names", "must be two different parameters of the scene", names)
    check.require_independent(*pair)
    return pair


def problems_at_locus_start(kind, scene, orbit_point, names, use_whole_orbit=False):
    """Set up the equations and the solution z of a special point of a kind with some parameters as unknowns.

    `scene` is the scene at the point, and `orbit_point` the orbit. An entry of `names` may be a tuple of names: several
    numbers of the scene that share one value are then one parameter. With `use_whole_orbit`, a symmetric orbit is not
    reduced to one half, except at an SB.

    Returns a list of (`OrbitProblem`, z). The list has one entry, or at a GR one entry for each grazing contact, in
    which the other contacts are omitted. The condition is a `GrazingCondition`, a `SingularCondition` or a
    `StickingLimitCondition`. Raises ArgumentError if none of these describes the point."""
    if kind != "GR" and not orbit_point.problem.n_rows:
        rule = "must belong to an orbit with impacts; without impacts only a GR has derivatives and a locus"
        raise check.ArgumentError("special", rule, f"{kind} without impacts")
    impact_entries = _impacts_and_contacts(kind, scene, orbit_point)
    values = [common_parameter_value(scene, name) for name in names]
    use_half_orbit = orbit_stays_symmetric(kind, scene, orbit_point, names)
    if kind == "SB" and not use_half_orbit:
        raise check.ArgumentError("names", "must keep the scene symmetric, as an SB requires", names)
    use_half_orbit = use_half_orbit and not (use_whole_orbit and kind != "SB")
    closure_sign, periods = (-1.0, 0.5 * orbit_point.periods) if use_half_orbit else (1.0, float(orbit_point.periods))
    if use_half_orbit:
        impact_entries = impact_entries[: len(impact_entries) // 2]
    template, z = (
        make_orbit_problem(scene, *names, periods=periods, closure_sign=closure_sign),
        np.array([0.0, 0.0, *values]),
    )
    if kind in STICKING_KINDS:
        return [_sticking_limit_problem(*template.with_impacts(z, impact_entries), kind)]
    if kind != "GR":
        condition = SingularCondition(np.asarray(1.0 if kind == "SN" else -1.0))
        problem, z = template.with_impacts(z, impact_entries)
        return [(problem._replace(condition=condition), z)]
    slack = GRAZING_TOLERANCE * template.length_scale
    grazing_indices = [
        k for k, (_, speed, side) in enumerate(impact_entries) if speed <= slack and not are_releases(side)
    ]
    if not grazing_indices:
        raise check.ArgumentError("special", "must touch a wall", orbit_point.value)
    impact_lists = (
        [impact for k, impact in enumerate(impact_entries) if k == grazing_index or k not in grazing_indices]
        for grazing_index in grazing_indices
    )
    return [_grazing_problem(*template.with_impacts(z, impacts), slack) for impacts in impact_lists]


def _sticking_limit_problem(problem, z, kind):
    """Return the problem with a `StickingLimitCondition` at the row whose sticking phase is at its limit, and z."""
    is_release = kind == "RL"
    condition = StickingLimitCondition(np.zeros(problem.n_rows), np.asarray(float(is_release)))
    problem = problem._replace(condition=condition)
    row_values_of = curve_ends.min_contact_forces if is_release else curve_ends.excess_speeds
    condition.row_mask[np.argmin(abs(row_values_of(problem, z)))] = 1.0
    return problem, z


def _grazing_problem(problem, z, slack):
    """Return the problem with a `GrazingCondition` at the impact of zero speed, and z."""
    sequence = problem.sequence
    row_mask = np.where(mark_impact_rows(sequence) & (sequence.speeds <= slack), 1.0, 0.0)
    if soft_wall_grazing.is_smooth_soft_wall(problem.scene, sequence.sides[np.argmax(row_mask)]):
        sequence = sequence._replace(grazing=row_mask)
    return problem._replace(sequence=sequence, condition=GrazingCondition(row_mask)), z


def _impacts_and_contacts(kind, scene, orbit_point):
    """Return (time, speed, side) of each impact and grazing contact in order of time.

    The times are shifted so that the first is within the first drive period.
    """
    times, speeds, sides = orbit_point.problem.impacts(orbit_point.z)
    impact_contact_entries = [((k, 0.0), contact) for k, contact in enumerate(zip(times, speeds, sides, strict=True))]
    if kind == "GR":
        for contact in find_grazing_contacts(orbit_point.problem, orbit_point.z):
            if not contact.is_impact:
                row_time = times[contact.row] if len(times) else 0.0
                impact_contact_entries.append(
                    (
                        (contact.row, contact.time_since_impact),
                        (row_time + contact.time_since_impact, 0.0, contact.side),
                    )
                )
    impact_contact_entries = [contact for _, contact in sorted(impact_contact_entries)]
    drive_period = 2.0 * np.pi / float(scene.frequency)
    time_shift = drive_period * np.floor(impact_contact_entries[0][0] / drive_period)
    return [(time - time_shift, speed, side) for time, speed, side in impact_contact_entries]


def orbit_stays_symmetric(kind, scene, orbit_point, names):
    """Check that an orbit is its own mirror image and that the parameters preserve the symmetry."""
    impact_entries = _impacts_and_contacts(kind, scene, orbit_point)
    if len(impact_entries) % 2 or not stays_symmetric(scene, *flatten_names(names)):
        return False
    return is_own_mirror_image(*orbit_point.problem.with_impacts(orbit_point.z, impact_entries))


def whole_orbit_impacts(problem, zs):
    """Return (times, speeds, sides, periods) of the whole orbits at points of a curve.

    `zs` has shape (points, unknowns). Times and speeds have shape (points, impacts), sides have shape (impacts,). If
    the equations represent one half of a symmetric orbit, the mirror image completes the orbit.
    """
    (times, speeds, sides), periods = problem.impacts(zs), float(problem.sequence.periods)
    if float(problem.sequence.closure_sign) < 0:
        mark = int(problem.parameter_marks.frequency)
        frequencies = zs[:, [problem.n_orbit_unknowns + mark - 1]] if mark else float(problem.scene.frequency)
        half_duration = periods * 2.0 * np.pi / frequencies
        times, speeds, sides = (
            np.hstack([times, times + half_duration]),
            np.hstack([speeds] * 2),
            np.append(sides, -sides),
        )
        periods *= 2
    return times, speeds, sides, int(periods)
