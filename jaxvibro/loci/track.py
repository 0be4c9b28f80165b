"""Track a locus in one direction until it ends at its bounds, its walls or its start."""

from typing import NamedTuple

import numpy as np

from continuation import augmented_systems, driver
from continuation.arclength import Point, StepControl
from continuation.branch_segment import SpecialIndex
from continuation.driver import ContinuationTask, Termination
from continuation.limits import UNLIMITED, Limits

from ..problem import sticking_limits
from ..problem.end import End, convert_end
from ..problem.equations import continuation_problem
from ..problem.first_grazing import OrbitEventDetector, truncate_at_grazing
from ..problem.grazing import ZERO_RATE, opening_rate
from ..problem.grazing_contact import contact_durations_at, find_grazing_contacts, wall_sides
from ..problem.plane_curve_end import describe_end
from . import codim2
from .chatter_completion import ChatterEquations
from .extended_system import GrazingEquations, SingularEquations


class LocusSettings(NamedTuple):
    """Settings of a locus.

    `control` of the steps, with the bounds of the second parameter; `initial_step`; `names` of the parameters; `bounds`
    of each by name; `box`, the bounds within the domains; `domain_ends`, the ends of the domains that are not bounds;
    `scene_length`, the length of the scene; `limits` of the number of points and of the time.
    """

    control: StepControl
    initial_step: float
    names: tuple[str, str]
    bounds: dict[str, tuple[float, float]]
    box: tuple[tuple[float, float], ...]
    domain_ends: tuple[tuple[float, ...], ...]
    scene_length: float
    limits: Limits = UNLIMITED


class LocusDirection(NamedTuple):
    """Direction in which a locus is tracked: equations, a `Point` whose tangent gives the direction, settings."""

    problem: GrazingEquations | SingularEquations | ChatterEquations
    start: Point
    settings: LocusSettings

    @property
    def task(self) -> ContinuationTask:
        """`ContinuationTask` of the driver."""
        problem, settings = self.problem, self.settings
        detector = LocusEventDetector(problem, settings.scene_length)
        starts, driver_arguments = (np.asarray(self.start.z),), (settings.box, settings.domain_ends, detector)
        return ContinuationTask(
            continuation_problem(problem),
            problem,
            settings.control,
            settings.initial_step,
            *driver_arguments,
            starts=starts,
            limits=settings.limits,
        )

    def with_limits(self, limits: Limits) -> "LocusDirection":
        """Return the direction with other limits."""
        return self._replace(settings=self.settings._replace(limits=limits))

    @property
    def is_admissible(self) -> bool:
        """True if no other contact becomes an impact along the direction, and no impact at a contact loses speed."""
        problem, z, tangent = self.problem, self.start.z, self.start.tangent
        walls, contact_durations, n_rows = (
            wall_sides(problem.scene),
            contact_durations_at(problem, z),
            len(problem.sequence.sides),
        )
        contacts = find_grazing_contacts(problem, z, self.settings.scene_length)
        contact_positions = [
            (contact.row, walls.index(contact.side), contact.delay - float(contact_durations[contact.row]))
            for contact in contacts
            if not contact.is_impact
        ]
        speed_rates = [
            tangent[n_rows + contact.row]
            for contact in contacts
            if contact.is_impact and contact.row in problem.impact_rows
        ]
        return all(
            opening_rate > -ZERO_RATE
            for opening_rate in (
                *speed_rates,
                *(opening_rate(problem, z, tangent, *position) for position in contact_positions),
            )
        )


class LocusEventDetector(OrbitEventDetector):
    """Event detector of a locus: points of codimension two, and the grazing contact that ends it."""

    def refine_points(self, task, points, diagnostics):
        return super().refine_points(task, points._replace(residual=_point_residuals(task, points)), diagnostics)

    def find_boundary_end(self, task, points, diagnostics, first_bad):
        points, residual = truncate_at_grazing(task, points, diagnostics, first_bad, self.length_scale)
        if residual is None:
            return None
        return Termination(points, SpecialIndex(0, self.contact_kind(points.z[-1]), residual), End.GRAZE)

    def contact_kind(self, z):
        """Return the kind of an end: grazing, impact with zero speed, or limit of a sticking phase."""
        problem = self.equations
        if isinstance(problem, ChatterEquations):
            return "GR" if find_grazing_contacts(problem, z, self.length_scale) else "CH"
        return sticking_limits.sticking_limit_kind(problem, z, self.length_scale) or (
            "GG" if isinstance(problem, GrazingEquations) else "GR"
        )

    def find_events(self, task, points, diagnostics, known_branch_points, termination):
        return codim2.locate_events(task, points, diagnostics)


def track_locus(direction):
    """Track a `LocusDirection`; return its segment."""
    return convert_end(driver.follow_branch(direction.task, direction.start))


def track_together(directions):
    """Track several directions; return their segments.

    Directions of equal kind and size are lanes of one compiled call.
    """
    return [
        convert_end(segment)
        for segment in driver.follow_branches(
            [direction.task for direction in directions], [direction.start for direction in directions]
        )
    ]


def termination_reason(direction, segment):
    """Describe why the segment of a `LocusDirection` ends."""
    return describe_end(segment.end, direction.settings.names[segment.end_param_index], segment.end_value)


def _point_residuals(task, points):
    """Return the residual of each point before the last step of Newton's method, or after it if the former is large."""
    point_residuals = points.residual.copy()
    for k in np.flatnonzero(point_residuals > task.control.tolerance * (1.0 + abs(points.z[:, -2:]).max(axis=1))):
        point_residuals[k] = abs(np.asarray(augmented_systems.evaluate(task.problem, points.z[k], task.args)[0])).max()
    return point_residuals
