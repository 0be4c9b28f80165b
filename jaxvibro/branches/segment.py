"""Follow a segment of a branch: orbits with one itinerary, from a start to the first grazing, bound or other end."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from continuation import driver, event_search
from continuation.arclength import StepControl
from continuation.branch_segment import SpecialIndex
from continuation.driver import ContinuationTask, Termination
from continuation.limits import UNLIMITED, Limits
from continuation.point_rows import head, insert_row, row_at

from ..orbits.impact_equations import ImpactSequence
from ..problem import grazing_from_within, soft_grazing, sticking_limits
from ..problem.end import End, convert_end
from ..problem.equations import continuation_problem
from ..problem.first_grazing import OrbitEventDetector, truncate_at_grazing
from ..problem.grazing import GrazingExit
from ..problem.grazing_contact import GrazingContact, is_pressed_on_wall
from ..problem.same_orbit import equivalent_points, is_repeated
from . import through_sticking
from .neimark_sacker import locate_neimark_sacker
from .resonances import locate_resonances
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
        Bounds that follow from the meaning of the parameter.
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
    """Details of a GR or CH.

    Attributes
    ----------
    grazing_contacts : tuple of GrazingContact
        Grazing contacts.
    exits : tuple of GrazingExit
        Branches that emanate from it.
    complete : bool
        Whether all exits are known.
    not_followed : tuple of bool
        For each exit, whether the branch does not continue along it.
    """

    grazing_contacts: tuple[GrazingContact, ...]
    exits: tuple[GrazingExit, ...]
    complete: bool
    not_followed: tuple[bool, ...] = ()


def follow_itinerary(problem, start, settings):
    """Follow orbits with one itinerary from a `Point`; return the `BranchSegment`, whose end is an `End`."""
    control = settings.control
    parameter_bounds, detector = (
        ((float(control.lower), float(control.upper)),),
        BranchEventDetector(problem, settings.length_scale, settings.monitors),
    )
    end_settings = settings.stop, settings.closure_targets, settings.limits
    task = ContinuationTask(
        continuation_problem(problem),
        problem,
        control,
        settings.initial_step,
        parameter_bounds,
        (settings.domain_ends,),
        detector,
        *end_settings,
    )
    return convert_end(driver.follow_branch(task, start))


class BranchEventDetector(OrbitEventDetector):
    """Event detector for orbits along one parameter.

    It detects grazings, period doublings, returns to a known orbit from another impact, repeated shorter orbits, and
    sign changes of user-defined monitors.
    """

    def __init__(self, problem, length_scale, monitors):
        super().__init__(problem, length_scale)
        self.monitors = monitors

    def is_past_singularity(self, points):
        """Mark points past a zero speed of a soft contact, where the determinant changes sign."""
        return soft_grazing.is_past_zero_speed(self.equations, points.z)

    def find_early_end(self, task, points):
        """End the segment where soft contacts are about to lose their speed, before it is lost in rounding."""
        problem, n_rows = self.equations, len(self.equations.sequence.sides)
        for k in range(1, len(points.z) if problem.scene.soft_sides else 0):
            z, tangent = points.z[k], points.tangent[k]
            slow_rows = [
                row
                for row in soft_grazing.slow_contact_rows(problem, z, self.length_scale)
                if tangent[n_rows + row] < 0
            ]
            slow_rows = [row for row in slow_rows if not grazing_from_within.is_pressed_into_wall(problem, z, row)]
            solution = soft_grazing.locate_soft_grazing(problem, z, slow_rows, self.length_scale) if slow_rows else None
            if solution is None or solution.z is None:
                continue
            expected_length = -z[n_rows + slow_rows[0]] / tangent[n_rows + slow_rows[0]]
            arclength = float(np.sum(task.control.scale**2 * tangent * (solution.z - z)))
            if abs(arclength - expected_length) < 0.5 * expected_length:
                point = row_at(points, k)._replace(z=solution.z, step=np.float64(arclength))
                grazing_details = soft_grazing.find_all_exits(problem, solution.z, self.length_scale)
                return self.grazing_termination(
                    insert_row(head(points, k + 1), k + 1, point), "GR", float(solution.residual), grazing_details
                )
        return self.find_inner_end(task, points) if problem.scene.soft_sides else None

    def find_inner_end(self, task, points):
        """Return the `Termination` where a mass in a soft wall is about to leave it briefly, or to stop leaving it."""
        index_and_grazing = grazing_from_within.find_upcoming_grazing(
            self.equations, points, task.control, self.length_scale
        )
        if index_and_grazing is None:
            return None
        last_index, upcoming = index_and_grazing
        point = row_at(points, last_index)._replace(z=upcoming.z, step=np.float64(upcoming.step))
        grazing_details = upcoming.grazing_contacts, upcoming.exits, upcoming.complete
        return self.grazing_termination(
            insert_row(head(points, last_index + 1), last_index + 1, point), "GR", upcoming.residual, grazing_details
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
        grazing_details = soft_grazing.find_all_exits(problem, z, self.length_scale)
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

        Every test function vanishes where the contact at the end has zero speed. It is given the sign that the
        multipliers have as they approach the point.
        """
        n_rows, tangent = len(self.equations.sequence.sides), points.tangent
        flip_test = diagnostics.flip_test if n_rows else 1.0 + diagnostics.trace + diagnostics.determinant
        if termination is not None and soft_grazing.is_singular_grazing(
            self.equations, termination.special.details.grazing_contacts
        ):
            flip_values, fold_values = (
                1.0 + sign * diagnostics.trace[-2:] + diagnostics.determinant[-2:] for sign in (1.0, -1.0)
            )
            flip_test = np.append(flip_test[:-1], flip_test[-2] * _sign_change(*flip_values))
            tangent = np.vstack([tangent[:-1], tangent[-2] * _sign_change(*fold_values)])
        can_double = (n_rows or self.equations.scene.force is not None) and self.equations.sequence.releases is None
        test_values = {"PD": flip_test} if can_double else {}  # linear free motion and sticking orbits have no PD
        events = event_search.locate_events(
            task.problem, points._replace(tangent=tangent), test_values, task.control, task.args, known_branch_points
        )
        events += [*locate_neimark_sacker(task, points, diagnostics), *locate_resonances(task, points, diagnostics)]
        for kind, function in self.monitors.items():
            events += locate_crossings(task, points, diagnostics, kind, function)
        return events

    def equivalent_points(self, target, near_z):
        """Yield equivalent points of a target (`ImpactSequence`, parameter value)."""
        return equivalent_points(self.equations, *target, near_z)

    def end_at_special_point(self, z, kind):
        return End.HALVED if kind == "BP" and is_repeated(self.equations, z) else None


def _sign_change(value_before, value_after):
    """Return -1 if two values differ in sign, else 1."""
    return -1.0 if value_before * value_after < 0 else 1.0
