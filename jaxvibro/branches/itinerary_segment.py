"""Follow segments of a branch, orbits with one itinerary each, through grazings and changes of sticking phases.

Continue a branch past a CH or RL, at which the sticking phases of its orbits change. The orbits on the two sides differ
in the bounces before a release. The number of bounces grows without bound towards a CH. The orbit on the other side is
found by simulation from the point. A motion that sticks does not depend on its past, so the simulated motion settles on
the orbit that continues the branch. Close to the CH the bounces would be lost in rounding, and a small interval of the
parameter is skipped.
"""

import warnings

import numpy as np

from continuation import continuation_loop, event_search
from continuation.arclength import make_start_point
from continuation.branch_segment import UNLIMITED, SlowProgressWarning, SpecialIndex, first_rows, insert_row, row_at
from continuation.continuation_loop import Termination

from ..flight.wall_positions import adapt_to_moved_walls
from ..orbits.find import find_orbit
from ..orbits.orbit import OrbitError, is_same_orbit
from ..problem import curve_ends, grazing_inside_wall, soft_wall_grazing
from ..problem.curve_ends import End, OrbitEventDetector, convert_segment_end, truncate_at_grazing
from ..problem.grazing_contact import BranchFromGrazing, GrazingPoint, are_admissible, is_pressed_on_wall
from ..problem.orbit_equations import diagnose, scene_at, sides_with_release_codes
from ..problem.orbit_point import comparison_points, equivalent_unknowns, impacts_since_phase_0, is_repeated
from ..scene.state import State
from .user_monitors import locate_crossings, locate_neimark_sacker, locate_resonances

VALUE_OFFSETS = (
    1e-7,
    1e-6,
    1e-5,
    1e-4,
    1e-3,
)  # relative to 1 + abs(parameter); distances from the point at which the next orbit is searched for
STATE_TOLERANCE = 0.05  # relative to the largest x and v at the section; largest distance of the next orbit
SETTLING_PERIODS = 60  # drive periods
MIN_HOP_MARGIN = (
    0.05  # `ChatterOutcome.hop_margin`; below it the first of the last bounces becomes too long for the series
)
SLOW_SPEED = 1e-6  # scene's lengths per t; below it the flights between impacts are lost in rounding


def has_very_slow_impact(problem, z, grazing_contacts=(), max_speed=SLOW_SPEED):
    """Test whether an orbit has an impact so slow that many more follow before the mass sticks.

    Impacts among the `grazing_contacts` are ignored.
    """
    contact_rows = [contact.row for contact in grazing_contacts if contact.is_impact]
    speeds = z[len(problem.sequence.sides) :][np.setdiff1d(problem.impact_rows, contact_rows)]
    return bool(((speeds > 0) & (speeds < max_speed * problem.length_scale)).any())


def find_sticking_exits(problem, z, parameter_sign, limits=UNLIMITED):
    """Return the list of `BranchFromGrazing` records of a CH or RL, None if the time limit is reached.

    The exits lead to orbits on the other side: towards greater values of the parameter if `parameter_sign` is 1.
    """
    toggled_lift_off_problem = curve_ends.toggle_early_lift_off(problem, z)
    if toggled_lift_off_problem is not None:
        return [_make_exit_towards(toggled_lift_off_problem, z, parameter_sign)]
    for value_offset in VALUE_OFFSETS:
        if limits.expired:
            return None
        settled_orbit = _settled_orbit(problem, z, z[-1] + parameter_sign * value_offset * (1.0 + abs(z[-1])))
        if settled_orbit is not None and not has_very_slow_impact(*settled_orbit):
            return [_make_exit_towards(*settled_orbit, parameter_sign)]
    return []


def reselect_bounce_rows(problem, z, parameter_sign):
    """Return the `BranchFromGrazing` of the same orbit with other bounces as rows, None if the present rows are
    adequate."""
    if problem.sequence.releases is None or diagnose(problem, z[None]).hop_margin.min() > MIN_HOP_MARGIN:
        return None
    settled_orbit = _settled_orbit(problem, z, z[-1])
    return None if settled_orbit is None else _make_exit_towards(*settled_orbit, parameter_sign)


def _make_exit_towards(problem, z, parameter_sign):
    """Make the `BranchFromGrazing` from a regular point, towards greater values of the parameter if `parameter_sign` is
    1."""
    exit_tangent = problem.tangent(z)
    return _make_exit(problem, z, parameter_sign * np.sign(exit_tangent[-1]) * exit_tangent, z)


def locate_nearby_chatter(problem, z, parameter_sign, limits=UNLIMITED):
    """Find the CH close to a grazing.

    Returns the `BranchFromGrazing` from the CH and the largest residual there, if orbits that stick exist on one of its
    sides. Returns None if no such orbits are found, or the time limit is reached. `parameter_sign` is the sign of the
    change of the parameter along the branch before the grazing.
    """
    for value_offset in VALUE_OFFSETS:
        for search_sign in (parameter_sign, -parameter_sign):
            if limits.expired:
                return None
            value = z[-1] + search_sign * value_offset * (1.0 + abs(z[-1]))
            settled_orbit = _settled_orbit(problem, z, value)
            if settled_orbit is None or _count_sticking_phases(settled_orbit[0]) <= _count_sticking_phases(problem):
                continue
            sticking_problem, nearby_z = settled_orbit
            chatter_point = _nearest_chatter_limit(sticking_problem, nearby_z, z[-1], value)
            if chatter_point is not None:
                exit_tangent = sticking_problem.tangent(chatter_point.z)
                tangent_sign = np.sign(nearby_z[-1] - chatter_point.z[-1]) * np.sign(exit_tangent[-1])
                return _make_exit(
                    sticking_problem, chatter_point.z, tangent_sign * exit_tangent, nearby_z
                ), chatter_point.residual
    return None


def _count_sticking_phases(problem):
    """Return the number of sticking phases of an orbit."""
    return 0 if problem.sequence.releases is None else np.count_nonzero(problem.sequence.releases)


def _nearest_chatter_limit(problem, z, value, orbit_value):
    """Locate the CH, among those of all sticking phases of an orbit, that is nearest to the orbit.

    `orbit_value` is the parameter value of the orbit, and `value` that of the grazing. A CH is ignored if it is more
    than twice as far from `value` as the orbit.
    """
    sticking_rows = np.flatnonzero(np.isfinite(diagnose(problem, z[None]).sticking_time[0]))
    candidates = [
        curve_ends.locate_sticking_limit(problem, z, int(row), curve_ends.excess_speeds) for row in sticking_rows
    ]
    candidates = [
        candidate
        for candidate in candidates
        if candidate.z is not None and abs(candidate.z[-1] - value) <= 2.0 * abs(orbit_value - value)
    ]
    return min(candidates, key=lambda candidate: abs(candidate.z[-1] - orbit_value), default=None)


def _make_exit(problem, z, exit_tangent, nearby_z):
    """Make a `BranchFromGrazing` without grazing contacts."""
    return BranchFromGrazing(
        problem, make_start_point(z, exit_tangent), nearby_z, diagnose(problem, nearby_z[None]), ()
    )


def _settled_orbit(problem, z, value):
    """Return the equations and z of the orbit on which a motion from z settles, None if no such orbit is close to z."""
    scene = scene_at(problem, np.append(z[:-1], value))
    start_diagnostics, periods = diagnose(problem, z[None]), int(problem.sequence.periods)
    state = adapt_to_moved_walls(scene, State(float(start_diagnostics.x[0, 0]), float(start_diagnostics.v[0, 0])))
    try:
        orbit = find_orbit(scene, State(float(state.x), float(state.v)), periods=periods, settle=SETTLING_PERIODS)
        impacts, _ = impacts_since_phase_0(orbit)
    except (OrbitError, ValueError):
        return None
    if orbit.periods != periods or not impacts:
        return None
    new_problem, new_z = problem.with_impacts(np.append(z[:-1], value), impacts)
    point = new_problem.solve_at(new_z, -1, value, 1.0)
    new_diagnostics = diagnose(new_problem, point.z[None])
    max_distance = STATE_TOLERANCE * max(abs(start_diagnostics.x).max(), abs(start_diagnostics.v).max())
    state_distance = max(
        abs(new_diagnostics.x - start_diagnostics.x).max(), abs(new_diagnostics.v - start_diagnostics.v).max()
    )
    return (
        (new_problem, point.z)
        if point.converged
        and are_admissible(new_problem, point.z, new_diagnostics)[0]
        and state_distance < max_distance
        else None
    )


def follow_itinerary(task, problem, start):
    """Follow orbits with one itinerary.

    Parameters
    ----------
    task : ContinuationTask
        Task of the branch, whose detector is a `BranchEventDetector`; its problem is replaced.
    problem : OrbitProblem
        Problem of the orbits.
    start : Point
        First point, with the tangent.

    Returns
    -------
    BranchSegment
        Points and special points; `end` is an `End`.
    """
    task = task._replace(
        problem=problem.equations,
        args=problem,
        control=task.control._replace(scale=problem.weights()),
        detector=BranchEventDetector(problem, task.detector.monitors),
    )
    return convert_segment_end(continuation_loop.follow_branch(task, start))


class BranchEventDetector(OrbitEventDetector):
    """Event detector for orbits along one parameter.

    The detector locates the special points of `follow`, including sign changes of user-defined monitors. It also
    detects repeated shorter orbits, and returns to the orbits that close the branch, whose first impact may then be
    another one.
    """

    def __init__(self, problem, monitors):
        super().__init__(problem)
        self.monitors = monitors

    def is_past_singularity(self, points):
        """Mark points past a zero speed of a soft contact, where the determinant changes sign."""
        return soft_wall_grazing.has_passed_zero_speed(self.problem, points.z)

    def find_early_end(self, task, points):
        """Return the `Termination` at the next zero of the speed of a soft contact, or grazing in contact, or None.

        A zero is located before rounding affects the speed.
        """
        problem, n_rows = self.problem, self.problem.n_rows
        if not problem.scene.soft_sides:
            return None
        for k in range(1, len(points.z)):
            z, tangent = points.z[k], points.tangent[k]
            slow_rows = [row for row in soft_wall_grazing.slow_contact_rows(problem, z) if tangent[n_rows + row] < 0]
            slow_rows = [row for row in slow_rows if not grazing_inside_wall.is_pressed_into_wall(problem, z, row)]
            grazing_solution = soft_wall_grazing.locate_soft_grazing(problem, z, slow_rows) if slow_rows else None
            if grazing_solution is None or grazing_solution.z is None:
                continue
            expected_arclength = -z[n_rows + slow_rows[0]] / tangent[n_rows + slow_rows[0]]
            arclength = float(np.sum(task.control.scale**2 * tangent * (grazing_solution.z - z)))
            if abs(arclength - expected_arclength) < 0.5 * expected_arclength:
                point = row_at(points, k)._replace(z=grazing_solution.z, step=np.float64(arclength))
                points = insert_row(first_rows(points, k + 1), k + 1, point)
                grazing_point = soft_wall_grazing.find_all_exits(problem, grazing_solution.z)
                return _end_at_grazing(points, "GR", float(grazing_solution.residual), grazing_point)
        return self.find_grazing_in_contact(task, points)

    def find_grazing_in_contact(self, task, points):
        """Return the `Termination` at a grazing within a contact phase in a soft wall.

        At this grazing a short flight within the contact phase appears or disappears.
        """
        upcoming_grazing = grazing_inside_wall.find_upcoming_grazing(self.problem, points, task.control)
        if upcoming_grazing is None:
            return None
        row_before, (z, arclength, residual, grazing_point) = upcoming_grazing
        point = row_at(points, row_before)._replace(z=z, step=np.float64(arclength))
        points = insert_row(first_rows(points, row_before + 1), row_before + 1, point)
        return _end_at_grazing(points, "GR", residual, grazing_point)

    def find_boundary_end(self, task, points, diagnostics, first_bad):
        """Return the `Termination` at the grazing or sticking limit before the first inadmissible point."""
        problem = self.problem
        points, residual = truncate_at_grazing(task, points, diagnostics, first_bad)
        if residual is None:
            return None
        z = points.z[-1]
        sticking_kind = curve_ends.sticking_limit_kind(problem, z)
        if sticking_kind:
            parameter_sign = np.sign(points.tangent[-1, -1])
            grazing_exits = find_sticking_exits(problem, z, parameter_sign, task.limits)
            if grazing_exits is None:
                return None
            return _end_at_grazing(points, sticking_kind, residual, GrazingPoint((), tuple(grazing_exits), True))
        grazing_point = soft_wall_grazing.find_all_exits(problem, z)
        is_pressed = len(grazing_point.exits) < 2 and is_pressed_on_wall(problem, z, grazing_point.grazing_contacts)
        kind = "CH" if is_pressed else "GR"
        ends_in_sticking = kind == "CH" and problem.sequence.releases is None
        return _end_at_grazing(points, kind, residual, grazing_point)._replace(
            end=End.REST if ends_in_sticking else End.GRAZE
        )

    def find_events(self, task, points, diagnostics, known_branch_points, termination):
        """Locate special points.

        Every test function vanishes at a grazing of a soft wall at the end of the segment. There each test function
        is given the sign that follows from the multipliers before the grazing.
        """
        n_rows, tangent = self.problem.n_rows, points.tangent
        flip_test = diagnostics.flip_test if n_rows else 1.0 + diagnostics.trace + diagnostics.determinant
        if termination is not None and soft_wall_grazing.has_singular_contact(
            self.problem, termination.special.detector_details.grazing_contacts
        ):
            end_flip_values, last_fold_values = (
                1.0 + sign * diagnostics.trace[-2:] + diagnostics.determinant[-2:] for sign in (1.0, -1.0)
            )
            flip_test = np.append(flip_test[:-1], flip_test[-2] * _sign_change_factor(*end_flip_values))
            tangent = np.vstack([tangent[:-1], tangent[-2] * _sign_change_factor(*last_fold_values)])
        can_double = (n_rows or self.problem.scene.force is not None) and self.problem.sequence.releases is None
        test_values = {"PD": flip_test} if can_double else {}  # linear free motion and sticking orbits have no PD
        events = event_search.locate_events(
            task.problem, points._replace(tangent=tangent), test_values, task.control, task.args, known_branch_points
        )
        events += [*locate_neimark_sacker(task, points, diagnostics), *locate_resonances(task, points, diagnostics)]
        for kind, monitor in self.monitors.items():
            events += locate_crossings(task, points, diagnostics, kind, monitor)
        return events

    def equivalent_points(self, target, near_z):
        """Yield unknowns near `near_z` that describe the orbit of a target (`OrbitProblem`, z)."""
        return equivalent_unknowns(self.problem, *target, near_z)

    def end_at_special_point(self, z, kind):
        return End.HALVED if kind == "BP" and is_repeated(self.problem, z) else None


def _end_at_grazing(points, kind, residual, grazing_point):
    """Return the `Termination` at the last point, which is a special point with a `GrazingPoint` as its details."""
    return Termination(points, SpecialIndex(0, kind, residual, grazing_point), End.GRAZE)


def _sign_change_factor(value_before, value_after):
    """Return -1 if two values differ in sign, else 1."""
    return -1.0 if value_before * value_after < 0 else 1.0


MAX_SEGMENTS = 200
CROWD_SIZE, CROWD_WIDTH = (
    16,
    1e-5,
)  # consecutive grazings within this width, relative to 1 + abs(parameter), give a warning
CHATTER_SPEED = 1e-2  # scene's lengths per t; without an exit, a slower impact indicates chatter
VALUE_TOLERANCE, IMPACT_TOLERANCE = 1e-7, 1e-6  # largest differences of identical grazings


def continue_through_grazings(task, start):
    """Follow a branch in one direction, from one itinerary to the next.

    Parameters
    ----------
    task : ContinuationTask
        Task of the branch, as `follow.make_branch_task` makes it.
    start : Point
        First point; the branch is followed along its tangent.

    Returns
    -------
    segments : list of BranchSegment
        Segments in order from the start.
    reason : EndReason
        Reason for the end of the last segment.
    """
    problem, segments, known_grazings, chatter_specials = task.args, [], [], ()
    while True:
        segment = follow_itinerary(task, problem, start)
        segment = segment._replace(specials=(*chatter_specials, *segment.specials))
        grazing_exit, chatter_specials = None, ()
        task = task._replace(limits=task.limits.after_points(len(segment.points.z)))
        if segment.end is End.GRAZE and task.limits.is_reached(1):
            segment = segment._replace(end=End.MAX_SECONDS if task.limits.expired else End.MAX_POINTS)
        if segment.end is End.GRAZE:
            segment, grazing_exit = _choose_exit(problem, segment, problem.weights())
            z = segment.points.z[-1]
            grazing_key = z[-1], comparison_points(problem, z, problem.length_scale)
            if any(_is_same_grazing(grazing_key, known_grazing) for known_grazing in known_grazings):
                segment, grazing_exit = segment._replace(end=End.CLOSED), None
            elif is_repeated(problem, z):
                segment, grazing_exit = segment._replace(end=End.HALVED), None
            elif segment.specials[-1].kind == "GR" and _has_slow_impact(
                problem, segment, SLOW_SPEED if grazing_exit else CHATTER_SPEED
            ):
                sign = np.sign(segment.points.tangent[-1, -1])
                chatter_result = locate_nearby_chatter(problem, z, sign, task.limits)
                if chatter_result is None and task.limits.expired:
                    segment, grazing_exit = segment._replace(end=End.MAX_SECONDS), None
                else:
                    segment, grazing_exit, chatter_specials = _enter_sticking(
                        segment, chatter_result, grazing_exit is not None
                    )
            known_grazings.append(grazing_key)
        if segment.end is End.STEP:
            sign = np.sign(segment.points.tangent[-1, -1])
            grazing_exit = reselect_bounce_rows(problem, segment.points.z[-1], sign)
        if len(segments) == MAX_SEGMENTS - 1 and grazing_exit is not None:
            segment, grazing_exit = segment._replace(end=End.POINTS), None
        segments.append(segment)
        _warn_of_slow_progress(segments)
        if grazing_exit is None:
            kind = segment.specials[-1].kind if segment.specials else ""
            return segments, segment.end.reason(segment.points.z[-1, -1], kind)
        problem, start = grazing_exit.problem, grazing_exit.point


def _warn_of_slow_progress(segments):
    """Warn if many consecutive grazings lie at nearly one value of the parameter."""
    values = np.array([segment.points.z[-1, -1] for segment in segments[-CROWD_SIZE:]])
    if len(segments) % CROWD_SIZE == 0 and np.ptp(values) < CROWD_WIDTH * (1.0 + abs(values[-1])):
        warnings.warn(
            f"slow progress: {CROWD_SIZE} grazings lie within {np.ptp(values):.1e} of the parameter value"
            f" {values[-1]:.12g},"
            " as towards a complete chatter; set max_points or max_seconds, or narrow the bounds",
            SlowProgressWarning,
            stacklevel=2,
        )


def _choose_exit(problem, segment, weights):
    """Return the segment and the `BranchFromGrazing` along which the branch continues, None if there is none.

    The details of the last special point record which exits are not followed. The branch continues with the grazing
    contacts exchanged as far as possible: impacts become omitted contacts and vice versa.
    """
    special_record, grazing_point = segment.specials[-1], segment.specials[-1].detector_details
    is_contact_included = tuple(contact.is_impact for contact in grazing_point.grazing_contacts)
    arrival_tangent, row_side_codes = segment.points.tangent[-1], sides_with_release_codes(problem.sequence)

    def is_backward(grazing_exit):
        is_same_problem = grazing_exit.inclusion_mask == is_contact_included and np.array_equal(
            sides_with_release_codes(grazing_exit.problem.sequence), row_side_codes
        )
        return is_same_problem and np.sum(weights * weights * grazing_exit.point.tangent * arrival_tangent) < 0

    def exchange_key(grazing_exit):
        has_same_contacts = grazing_exit.inclusion_mask == is_contact_included
        return has_same_contacts, sum(
            is_in_exit != is_in_segment
            for is_in_exit, is_in_segment in zip(grazing_exit.inclusion_mask, is_contact_included, strict=True)
        )

    chosen_exit = max(
        (grazing_exit for grazing_exit in grazing_point.exits if not is_backward(grazing_exit)),
        key=exchange_key,
        default=None,
    )
    is_not_followed = tuple(
        not (grazing_exit is chosen_exit or is_backward(grazing_exit)) for grazing_exit in grazing_point.exits
    )
    special_records = (
        *segment.specials[:-1],
        special_record._replace(detector_details=grazing_point._replace(not_followed=is_not_followed)),
    )
    end = segment.end if chosen_exit or grazing_point.complete else End.STEP
    return segment._replace(
        specials=special_records, end=End.UNSETTLED if not chosen_exit and special_record.kind != "GR" else end
    ), chosen_exit


def _enter_sticking(segment, chatter_result, has_exit):
    """Return the segment, the exit, and the special points at the start of the next segment, close to a CH.

    `chatter_result` is the result of `locate_nearby_chatter`.
    """
    if chatter_result is None:
        return segment._replace(end=End.CHATTER if has_exit else segment.end), None, ()
    grazing_exit, residual = chatter_result
    return segment, grazing_exit, (SpecialIndex(0, "CH", residual, GrazingPoint((), (grazing_exit,), True, (False,))),)


def _has_slow_impact(problem, segment, max_speed):
    """Test whether an impact other than the grazing contacts is slower than `max_speed` at the end of a segment."""
    return has_very_slow_impact(
        problem, segment.points.z[-1], segment.specials[-1].detector_details.grazing_contacts, max_speed
    )


def _is_same_grazing(grazing_key, known_grazing):
    """Test whether two grazings, given as (value, impacts), are identical."""
    return abs(grazing_key[0] - known_grazing[0]) < VALUE_TOLERANCE and is_same_orbit(
        grazing_key[1], known_grazing[1], IMPACT_TOLERANCE
    )
