"""Track a locus in one direction until it reaches a bound, becomes inadmissible or closes."""

from typing import NamedTuple

import numpy as np

from continuation import augmented_systems, continuation_loop
from continuation.arclength import Point, StepControl
from continuation.branch_segment import SpecialIndex
from continuation.computation_limits import UNLIMITED, Limits
from continuation.continuation_loop import ContinuationTask, Termination

from ..problem import sticking_limits
from ..problem.branches_from_grazing import ZERO_RATE, distance_growth_rate
from ..problem.curve_grazing import OrbitEventDetector, truncate_at_grazing
from ..problem.end import End, convert_segment_end
from ..problem.grazing_contact import contact_durations_at, find_grazing_contacts, scene_wall_sides
from ..problem.orbit_equations import continuation_problem
from ..problem.plane_curve_end import describe_end
from . import codim2_points
from .locus_equations import GrazingEquations, SingularEquations
from .sticking_limit_equations import StickingLimitEquations


class LocusSettings(NamedTuple):
    """Settings of a locus.

    Attributes
    ----------
    control : StepControl
        Step limits, tolerance and arclength weights, with the bounds of the second parameter.
    initial_step : float
        First arclength step.
    names : tuple of str
        Names of the two parameters.
    bounds : dict of str to tuple of float
        Lower and upper bound of each parameter, by name.
    bounds_in_domains : tuple of tuple of float
        Intersection of the bounds with the domain of each parameter.
    domain_ends : tuple of tuple of float
        Ends of the domain of each parameter that are not bounds.
    scene_length : float
        Typical length of the scene.
    limits : Limits
        Limits of the number of points and of the time.
    """

    control: StepControl
    initial_step: float
    names: tuple[str, str]
    bounds: dict[str, tuple[float, float]]
    bounds_in_domains: tuple[tuple[float, float], ...]
    domain_ends: tuple[tuple[float, ...], ...]
    scene_length: float
    limits: Limits = UNLIMITED


class LocusDirection(NamedTuple):
    """Direction in which a locus is tracked.

    Attributes
    ----------
    problem : GrazingEquations or SingularEquations or StickingLimitEquations
        Equations of the locus.
    start : Point
        First point. Its tangent points in the direction.
    settings : LocusSettings
        Settings of the locus.
    """

    problem: GrazingEquations | SingularEquations | StickingLimitEquations
    start: Point
    settings: LocusSettings

    @property
    def task(self) -> ContinuationTask:
        """`ContinuationTask` that tracks the locus in this direction."""
        problem, settings = self.problem, self.settings
        event_detector = LocusEventDetector(problem, settings.scene_length)
        closing_zs, driver_arguments = (
            (np.asarray(self.start.z),),
            (settings.bounds_in_domains, settings.domain_ends, event_detector),
        )
        return ContinuationTask(
            continuation_problem(problem),
            problem,
            settings.control,
            settings.initial_step,
            *driver_arguments,
            starts=closing_zs,
            limits=settings.limits,
        )

    def with_limits(self, limits: Limits) -> "LocusDirection":
        """Return the direction with other limits."""
        return self._replace(settings=self.settings._replace(limits=limits))

    @property
    def is_admissible(self) -> bool:
        """True if no other grazing contact penetrates its wall and no grazing impact loses speed in this direction."""
        problem, z, tangent = self.problem, self.start.z, self.start.tangent
        side_codes, contact_durations, n_rows = (
            scene_wall_sides(problem.scene),
            contact_durations_at(problem, z),
            len(problem.sequence.sides),
        )
        grazing_contacts = find_grazing_contacts(problem, z, self.settings.scene_length)
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

    def find_boundary_end(self, task, points, diagnostics, first_bad):
        points, residual = truncate_at_grazing(task, points, diagnostics, first_bad, self.length_scale)
        if residual is None:
            return None
        return Termination(points, SpecialIndex(0, self.end_contact_kind(points.z[-1]), residual), End.GRAZE)

    def end_contact_kind(self, z):
        """Return the kind of special point at which the orbit becomes inadmissible: GR, GG, CH or RL."""
        problem = self.equations
        if isinstance(problem, StickingLimitEquations):
            return "GR" if find_grazing_contacts(problem, z, self.length_scale) else "CH"
        return sticking_limits.sticking_limit_kind(problem, z, self.length_scale) or (
            "GG" if isinstance(problem, GrazingEquations) else "GR"
        )

    def find_events(self, task, points, diagnostics, known_branch_points, termination):
        return codim2_points.locate_codim2_events(task, points, diagnostics)


def track_locus(locus_direction):
    """Track a locus in one `LocusDirection`; return its segment."""
    return convert_segment_end(continuation_loop.follow_branch(locus_direction.task, locus_direction.start))


def track_loci_together(locus_directions):
    """Track loci in several `LocusDirection` records; return their segments.

    Directions with equations of the same kind and size are lanes of one compiled call.
    """
    return [
        convert_segment_end(segment)
        for segment in continuation_loop.follow_branches(
            [locus_direction.task for locus_direction in locus_directions],
            [locus_direction.start for locus_direction in locus_directions],
        )
    ]


def termination_reason(locus_direction, segment):
    """Describe why the segment of a `LocusDirection` ends."""
    return describe_end(segment.end, locus_direction.settings.names[segment.end_param_index], segment.end_value)


def _newton_residuals(task, points):
    """Return the residual of each point.

    The stored residual is that before the last step of Newton's method. If it exceeds the tolerance, the residual is
    evaluated again at the point.
    """
    residual_by_point = points.residual.copy()
    for point_index in np.flatnonzero(
        residual_by_point > task.control.tolerance * (1.0 + abs(points.z[:, -2:]).max(axis=1))
    ):
        residual_by_point[point_index] = abs(
            np.asarray(augmented_systems.evaluate_problem(task.problem, points.z[point_index], task.args)[0])
        ).max()
    return residual_by_point
