"""Follow a segment of a branch: orbits with one itinerary, from a start to the first grazing, bound or other end."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from continuation import continuation_loop, event_search
from continuation.arclength import StepControl
from continuation.branch_segment import SpecialIndex
from continuation.computation_limits import UNLIMITED, Limits
from continuation.continuation_loop import ContinuationTask, Termination
from continuation.point_rows import first_rows, insert_row, row_at

from ..orbits.impact_equations import ImpactSequence
from ..problem import grazing_inside_wall, soft_wall_grazing, sticking_limits
from ..problem.branches_from_grazing import BranchFromGrazing
from ..problem.curve_grazing import OrbitEventDetector, truncate_at_grazing
from ..problem.end import End, convert_segment_end
from ..problem.grazing_contact import GrazingContact, is_pressed_on_wall
from ..problem.orbit_equations import continuation_problem
from ..problem.orbit_equivalence import equivalent_unknowns, is_repeated
from . import through_sticking
from .multiplier_resonances import locate_resonances
from .neimark_sacker import locate_neimark_sacker
from .user_monitors import MonitoredPoint, locate_crossings


class BranchSettings(NamedTuple):
    """Settings of the continuation of a branch.

    Attributes
    ----------
    control : StepControl
        Step control.
    initial_step : float
        First step.
    domain_ends : tuple of float
        Ends of the domain of the parameter, except those equal to a bound of the branch.
    monitors : dict of str to callable
        Functions of a `MonitoredPoint` by label.
    stop : tuple of str
        Kinds at which the branch ends.
    length_scale : float
        Length of the scene.
    closure_targets : tuple
        (`ImpactSequence`, parameter value) of orbits that close the branch.
    limits : Limits
        Limits of points and time.
    """

    control: StepControl
    initial_step: float
    domain_ends: tuple[float, ...]
    monitors: dict[str, Callable[[MonitoredPoint], Any]]
    stop: tuple[str, ...]
    length_scale: float
    closure_targets: tuple[tuple[ImpactSequence, float], ...]
    limits: Limits = UNLIMITED


class GrazingPoint(NamedTuple):
    """Details of a GR, CH or RL.

    Attributes
    ----------
    grazing_contacts : tuple of GrazingContact
        Grazing contacts.
    exits : tuple of BranchFromGrazing
        Branches that emanate from the point.
    complete : bool
        True if all exits are known.
    not_followed : tuple of bool
        True for each exit along which the branch does not continue.
    """

    grazing_contacts: tuple[GrazingContact, ...]
    exits: tuple[BranchFromGrazing, ...]
    complete: bool
    not_followed: tuple[bool, ...] = ()


def follow_itinerary(problem, start, settings):
    """Follow orbits with one itinerary from a `Point`; return the `BranchSegment`, whose end is an `End`."""
    control = settings.control
    parameter_bounds, detector = (
        ((float(control.lower), float(control.upper)),),
        BranchEventDetector(problem, settings.length_scale, settings.monitors),
    )
    termination_settings = settings.stop, settings.closure_targets, settings.limits
    task = ContinuationTask(
        continuation_problem(problem),
        problem,
        control,
        settings.initial_step,
        parameter_bounds,
        (settings.domain_ends,),
        detector,
        *termination_settings,
    )
    return convert_segment_end(continuation_loop.follow_branch(task, start))


class BranchEventDetector(OrbitEventDetector):
    """Event detector for orbits along one parameter.

    The detector locates the special points of `follow`, including sign changes of user-defined monitors. It also
    detects repeated shorter orbits, and returns to the orbits that close the branch, whose first impact may then be
    another one.
    """

    def __init__(self, problem, length_scale, monitors):
        super().__init__(problem, length_scale)
        self.monitors = monitors

    def is_past_singularity(self, points):
        """Mark points past a zero speed of a soft contact, where the determinant changes sign."""
        return soft_wall_grazing.has_passed_zero_speed(self.equations, points.z)

    def find_early_end(self, task, points):
        """Return the `Termination` at the next zero of the speed of a soft contact, or grazing in contact, or None.

        A zero is located before rounding affects the speed.
        """
        problem, n_rows = self.equations, len(self.equations.sequence.sides)
        for k in range(1, len(points.z) if problem.scene.soft_sides else 0):
            z, tangent = points.z[k], points.tangent[k]
            slow_rows = [
                row
                for row in soft_wall_grazing.slow_contact_rows(problem, z, self.length_scale)
                if tangent[n_rows + row] < 0
            ]
            slow_rows = [row for row in slow_rows if not grazing_inside_wall.is_pressed_into_wall(problem, z, row)]
            grazing_solution = (
                soft_wall_grazing.locate_soft_grazing(problem, z, slow_rows, self.length_scale) if slow_rows else None
            )
            if grazing_solution is None or grazing_solution.z is None:
                continue
            expected_arclength = -z[n_rows + slow_rows[0]] / tangent[n_rows + slow_rows[0]]
            arclength = float(np.sum(task.control.scale**2 * tangent * (grazing_solution.z - z)))
            if abs(arclength - expected_arclength) < 0.5 * expected_arclength:
                point = row_at(points, k)._replace(z=grazing_solution.z, step=np.float64(arclength))
                grazing_details = soft_wall_grazing.find_all_exits(problem, grazing_solution.z, self.length_scale)
                return self.grazing_termination(
                    insert_row(first_rows(points, k + 1), k + 1, point),
                    "GR",
                    float(grazing_solution.residual),
                    grazing_details,
                )
        return self.find_grazing_in_contact(task, points) if problem.scene.soft_sides else None

    def find_grazing_in_contact(self, task, points):
        """Return the `Termination` at a grazing within a contact phase in a soft wall.

        At this grazing a short flight within the contact phase appears or disappears.
        """
        index_and_grazing = grazing_inside_wall.find_upcoming_grazing(
            self.equations, points, task.control, self.length_scale
        )
        if index_and_grazing is None:
            return None
        row_before, upcoming_grazing = index_and_grazing
        point = row_at(points, row_before)._replace(z=upcoming_grazing.z, step=np.float64(upcoming_grazing.step))
        grazing_details = upcoming_grazing.grazing_contacts, upcoming_grazing.exits, upcoming_grazing.has_all_exits
        return self.grazing_termination(
            insert_row(first_rows(points, row_before + 1), row_before + 1, point),
            "GR",
            upcoming_grazing.residual,
            grazing_details,
        )

    def find_boundary_end(self, task, points, diagnostics, first_bad):
        """Return the `Termination` at the grazing or sticking limit before the first inadmissible point."""
        problem = self.equations
        points, residual = truncate_at_grazing(task, points, diagnostics, first_bad, self.length_scale)
        if residual is None:
            return None
        z = points.z[-1]
        sticking_kind = sticking_limits.sticking_limit_kind(problem, z, self.length_scale)
        if sticking_kind:
            grazing_exits = through_sticking.find_sticking_exits(
                problem, z, np.sign(points.tangent[-1, -1]), self.length_scale, task.limits
            )
            return (
                None
                if grazing_exits is None
                else self.grazing_termination(points, sticking_kind, residual, ((), grazing_exits, True))
            )
        grazing_details = soft_wall_grazing.find_all_exits(problem, z, self.length_scale)
        kind = "CH" if len(grazing_details[1]) < 2 and is_pressed_on_wall(problem, z, grazing_details[0]) else "GR"
        ends_in_sticking = kind == "CH" and problem.sequence.releases is None
        return self.grazing_termination(points, kind, residual, grazing_details)._replace(
            end=End.REST if ends_in_sticking else End.GRAZE
        )

    def grazing_termination(self, points, kind, residual, grazing_details):
        """Make the `Termination` at the last point; `grazing_details` are (grazing contacts, exits, completeness)."""
        grazing_contacts, grazing_exits, complete = grazing_details
        return Termination(
            points,
            SpecialIndex(0, kind, residual, GrazingPoint(tuple(grazing_contacts), tuple(grazing_exits), complete)),
            End.GRAZE,
        )

    def find_events(self, task, points, diagnostics, known_branch_points, termination):
        """Locate special points.

        Every test function vanishes at a grazing of a soft wall at the end of the segment. There each test function
        is given the sign that follows from the multipliers before the grazing.
        """
        n_rows, tangent = len(self.equations.sequence.sides), points.tangent
        flip_test = diagnostics.flip_test if n_rows else 1.0 + diagnostics.trace + diagnostics.determinant
        if termination is not None and soft_wall_grazing.has_singular_contact(
            self.equations, termination.special.detector_details.grazing_contacts
        ):
            end_flip_values, last_fold_values = (
                1.0 + sign * diagnostics.trace[-2:] + diagnostics.determinant[-2:] for sign in (1.0, -1.0)
            )
            flip_test = np.append(flip_test[:-1], flip_test[-2] * _sign_change_factor(*end_flip_values))
            tangent = np.vstack([tangent[:-1], tangent[-2] * _sign_change_factor(*last_fold_values)])
        can_double = (n_rows or self.equations.scene.force is not None) and self.equations.sequence.releases is None
        test_values = {"PD": flip_test} if can_double else {}  # linear free motion and sticking orbits have no PD
        events = event_search.locate_events(
            task.problem, points._replace(tangent=tangent), test_values, task.control, task.args, known_branch_points
        )
        events += [*locate_neimark_sacker(task, points, diagnostics), *locate_resonances(task, points, diagnostics)]
        for kind, monitor in self.monitors.items():
            events += locate_crossings(task, points, diagnostics, kind, monitor)
        return events

    def equivalent_points(self, target, near_z):
        """Yield unknowns near `near_z` that describe the orbit of a target (`ImpactSequence`, parameter value)."""
        return equivalent_unknowns(self.equations, *target, near_z)

    def end_at_special_point(self, z, kind):
        return End.HALVED if kind == "BP" and is_repeated(self.equations, z) else None


def _sign_change_factor(value_before, value_after):
    """Return -1 if two values differ in sign, else 1."""
    return -1.0 if value_before * value_after < 0 else 1.0
