"""Track a locus in one direction until it reaches a bound, becomes inadmissible or closes."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from continuation import continuation_loop
from continuation.arclength import Point, make_start_point
from continuation.computation_limits import Limits
from continuation.continuation_loop import ContinuationTask

from ..problem import sticking_limits
from ..problem.branches_from_grazing import ZERO_RATE, distance_growth_rate
from ..problem.curve_grazing import OrbitEventDetector
from ..problem.end import convert_segment_end
from ..problem.grazing_contact import contact_durations_at, find_grazing_contacts, scene_wall_sides
from ..problem.orbit_problem import OrbitProblem
from . import codim2_points
from .locus_equations import GrazingCondition
from .sticking_limit_equations import StickingLimitCondition


class LocusDirection(NamedTuple):
    """Direction in which a locus is tracked.

    Attributes
    ----------
    task : ContinuationTask
        Task whose ``args`` are the problem of the locus.
    start : Point
        First point. Its tangent points in the direction.
    names : tuple of str
        Names of the two parameters.
    bounds : dict of str to tuple of float
        Lower and upper bound of each parameter, by name.
    """

    task: ContinuationTask
    start: Point
    names: tuple[str, str]
    bounds: dict[str, tuple[float, float]]

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
        return sticking_limits.sticking_limit_kind(problem, z) or (
            "GG" if isinstance(problem.condition, GrazingCondition) else "GR"
        )

    def find_events(self, task, points, diagnostics, known_branch_points, termination):
        return codim2_points.locate_codim2_events(task, points, diagnostics)


def track_locus(locus_direction):
    """Track a locus in one `LocusDirection`; return its segment."""
    return convert_segment_end(continuation_loop.follow_branch(locus_direction.task, locus_direction.start))


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
