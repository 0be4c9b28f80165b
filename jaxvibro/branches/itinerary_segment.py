"""Follow a segment of a branch: orbits with one itinerary, from a start to the first grazing, bound or other end."""

import numpy as np

from continuation import continuation_loop, event_search
from continuation.branch_segment import SpecialIndex
from continuation.continuation_loop import Termination
from continuation.point_rows import first_rows, insert_row, row_at

from ..problem import grazing_inside_wall, soft_wall_grazing, sticking_limits
from ..problem.branches_from_grazing import GrazingPoint
from ..problem.curve_grazing import OrbitEventDetector, truncate_at_grazing
from ..problem.end import End, convert_segment_end
from ..problem.grazing_contact import is_pressed_on_wall
from ..problem.orbit_equivalence import equivalent_unknowns, is_repeated
from . import through_sticking
from .multiplier_resonances import locate_resonances
from .neimark_sacker import locate_neimark_sacker
from .user_monitors import locate_crossings


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
        sticking_kind = sticking_limits.sticking_limit_kind(problem, z)
        if sticking_kind:
            parameter_sign = np.sign(points.tangent[-1, -1])
            grazing_exits = through_sticking.find_sticking_exits(problem, z, parameter_sign, task.limits)
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
