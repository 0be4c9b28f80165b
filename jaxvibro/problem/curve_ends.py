"""Ends of branches and loci: inadmissible orbits, grazings, and limits of orbits that stick.

Locate the limits of orbits that stick: incipient complete chatter (CH), and releases while sticking (RL). At a CH the
speed of the last recorded bounce has the critical value of `orbits.chatter`. This condition is an additional equation,
which is smooth near the point. Beyond the point the mass leaves the wall after finitely many bounces. At an RL the
least contact force within a sticking phase vanishes, and beyond the point the mass is released earlier.
"""

import re
from enum import Enum
from typing import NamedTuple

import numpy as np

from continuation import event_search
from continuation.augmented_systems import RootAndResidual
from continuation.branch_segment import SpecialIndex, first_rows, insert_row, row_at
from continuation.continuation_loop import EventDetector, Termination
from continuation.event_search import point_at_length, point_from_z
from continuation.hostcall import FAST_COMPILE, persistent_jit

from ..compiled.kernel_calls import call_as_kernel
from ..contact.kinds import flow_coefficients
from ..orbits import chatter_and_release, impact_equations
from ..orbits.flight_clearance import GRAZING_TOLERANCE
from . import soft_wall_grazing
from .grazing_contact import are_admissible, locate_grazing, set_slow_speeds_to_zero
from .orbit_equations import diagnose, scene_at, sequence_at


class End(Enum):
    """Reason for the end of a branch.

    The value of a member is a text. ``{value}`` stands for the value of the parameter. ``{kind}`` stands for the kind
    of special point at which the branch stops or starts. The texts are stored in files and parsed.

    Notes
    -----
    - BOUND and STOPPED are limits of the user: a bound, or a kind of special point in `stop`.
    - DOMAIN is the end of the domain of a parameter.
    - MAX_POINTS and MAX_SECONDS are limits of the computation; `extend` resumes there.
    - CLOSED is a closed branch.
    - STEP, POINTS, NUMBER and HALVED are failures: the step is too small, there are too many points, a number is not
      finite, or the orbit is a repeated orbit of a shorter period.
    - GRAZE, REST, CHATTER and UNSETTLED are grazings and limits of sticking beyond which no orbit of this kind exists.
    - START and LEFT are starts of a branch: the initial orbit, or the special point at which the branch begins.
    """

    BOUND = "the parameter reached its bound {value:.12g}"
    DOMAIN = "the parameter's domain ends at {value:.12g}"
    CLOSED = "it closes: the branch came back to an orbit met before, at {value:.12g}"
    STOPPED = "stopped at {kind}, {value:.12g}"
    STEP = "the step became too small at {value:.12g}: Newton's method does not converge there"
    GRAZE = "grazing at {value:.12g}: no orbit with as many periods goes on from there"
    REST = "from {value:.12g} on the mass rests on a wall for a while"
    POINTS = "it has too many points, the last at {value:.12g}"
    MAX_POINTS = "max_points reached at {value:.12g}"
    MAX_SECONDS = "max_seconds reached at {value:.12g}"
    NUMBER = "a number is not finite after {value:.12g}"
    HALVED = "at {value:.12g} it is an orbit of a shorter period, repeated"
    CHATTER = (
        "at {value:.12g} another impact is as good as without speed: towards complete chatter there is no end of"
        " grazings"
    )
    UNSETTLED = "at {value:.12g} the mass just comes to rest, or is let go: no orbit of as many periods goes on beyond"
    START = "the start"
    LEFT = "it left {kind} at {value:.12g}"

    def reason(self, value=0.0, kind=""):
        """Return the `EndReason` with the value and the kind inserted in the text."""
        return EndReason(self, self.value.format(value=value, kind=kind))


RESUMABLE_ENDS = End.MAX_POINTS, End.MAX_SECONDS  # ends that a later call can continue from


class EndReason(NamedTuple):
    """Reason for the end of a branch.

    Attributes
    ----------
    end : End
        Reason, for decisions in the code.
    text : str
        Text for display.
    """

    end: End
    text: str


def convert_segment_end(segment):
    """Replace the end of a segment by the member of `End` with the same name.

    Parameters
    ----------
    segment : continuation.branch_segment.BranchSegment
        Segment from `continuation`.

    Returns
    -------
    continuation.branch_segment.BranchSegment
        Segment whose ``end`` is an `End`.
    """
    return segment._replace(end=End[segment.end.name])


def parse_end(text):
    """Return the `End` that a text describes, for old branch files, which store only the text.

    Parameters
    ----------
    text : str
        Text of an `EndReason`.

    Returns
    -------
    End
        The reason.

    Raises
    ------
    ValueError
        If no member of `End` has such a text.
    """
    return _match_reason_text(text)[0]


def rescale_reason_text(text, unit_factor):
    """Convert the value in a text to another unit.

    Parameters
    ----------
    text : str
        Text of an `EndReason`.
    unit_factor : float
        Value of the old unit in the new unit.

    Returns
    -------
    str
        Text with the value multiplied by `unit_factor`.
    """
    _, text_match = _match_reason_text(text)
    if not text_match.groups():
        return text
    return f"{text[: text_match.start(1)]}{float(text_match[1]) * unit_factor:.12g}{text[text_match.end(1) :]}"


def _match_reason_text(text):
    """Return (`End`, match) of a text; the first group of the match is the value, if the text contains a value."""
    for end in End:
        text_pattern = re.sub(r"\\{value[^}]*\\}", r"(\\S+)", re.escape(end.value)).replace(r"\{kind\}", ".+")
        text_match = re.fullmatch(text_pattern, text)
        if text_match:
            return end, text_match
    raise ValueError(f"unknown reason for the end of a branch: {text!r}")


DIP_RATIO = 0.5  # relative to the least of three values; intervals where a parabola falls below this are searched
N_PARTS = 8  # parts of an interval that is searched for a minimum
MAX_REFINEMENTS = 6  # refinements of the parts around the minimum


def insert_missed_grazings(task, points, diagnostics):
    """Insert an inadmissible point where a clearance or a speed becomes negative between two points.

    Returns (points, `Diagnostics` of the points). `task` is the `ContinuationTask` of a branch or a locus; its ``args``
    are the equations.
    """
    problem = task.args
    margins = _clearances_and_speeds(problem, points.z, diagnostics)
    with np.errstate(invalid="ignore"):
        is_positive = margins > problem.slack
        may_become_negative = (
            (margins[1:-1] < margins[:-2]) & (margins[1:-1] <= margins[2:]) & is_positive[1:-1] & is_positive[2:]
        )
        curvature = margins[:-2] - 2.0 * margins[1:-1] + margins[2:]
        predicted_minimum = margins[1:-1] - (margins[2:] - margins[:-2]) ** 2 / (
            8.0 * np.where(curvature > 0, curvature, np.inf)
        )
        may_become_negative &= (
            np.isfinite(margins[:-2]) & np.isfinite(margins[2:]) & (predicted_minimum < DIP_RATIO * margins[1:-1])
        )
    n_inserted = 0
    for middle_point_index in np.unique(np.nonzero(may_become_negative)[0]) + 1:
        for previous_point_index in (middle_point_index - 1, middle_point_index):
            suspect_margin_columns = np.flatnonzero(may_become_negative[middle_point_index - 1])
            inadmissible_point = _find_inadmissible_point(
                task, points, int(previous_point_index + n_inserted), suspect_margin_columns
            )
            if inadmissible_point is not None:
                points = insert_row(points, previous_point_index + n_inserted + 1, inadmissible_point)
                n_inserted += 1
    return points, diagnose(problem, points.z) if n_inserted else diagnostics


def _find_inadmissible_point(task, points, previous_point_index, margin_columns):
    """Return an inadmissible `Point` between two points, or None if no such point is detected."""
    problem, lower_arclength, upper_arclength = task.args, 0.0, float(points.step[previous_point_index + 1])
    for _ in range(MAX_REFINEMENTS):
        sample_arclengths = np.linspace(lower_arclength, upper_arclength, N_PARTS + 1)[1:-1]
        sample_points = [
            point_at_length(task, points, previous_point_index, sample_arclength)
            for sample_arclength in sample_arclengths
        ]
        if any(point is None for point in sample_points):
            return None
        zs = np.stack([point.z for point in sample_points])
        diagnostics = diagnose(problem, zs)
        is_inadmissible = ~are_admissible(problem, zs, diagnostics)
        if is_inadmissible.any():
            return sample_points[int(np.argmax(is_inadmissible))]
        margins = _clearances_and_speeds(problem, zs, diagnostics)
        lowest_sample_index = int(np.argmin(margins[:, margin_columns].min(axis=1)))
        sample_spacing = (upper_arclength - lower_arclength) / N_PARTS
        lower_arclength, upper_arclength = (
            sample_arclengths[lowest_sample_index] - sample_spacing,
            sample_arclengths[lowest_sample_index] + sample_spacing,
        )
    return None


def _clearances_and_speeds(problem, zs, diagnostics):
    """Return the clearances and the impact speeds of each point, array of shape (points, clearances + impacts)."""
    speeds = zs[:, len(problem.sequence.sides) + problem.impact_rows]
    return np.concatenate([diagnostics.clearance.reshape(len(zs), -1), speeds], axis=1)


def _row_values_kernel(z, problem, function_of_start):
    coeffs, sequence = flow_coefficients(scene_at(problem, z)), sequence_at(problem, z)
    return chatter_and_release.evaluate_chatter_starts(
        function_of_start, coeffs, sequence, impact_equations.compute_flights(coeffs, sequence)
    )


@persistent_jit(static_argnums=0, compiler_options=FAST_COMPILE)
def _evaluate_row_values(function_of_start, z, problem):
    return call_as_kernel(_row_values_kernel, z, problem, function_of_start=function_of_start)


def excess_speeds(problem, z):
    """Return the excess of the speed of each row over the largest speed that leads to sticking.

    Parameters
    ----------
    problem : OrbitProblem
        Equations of the orbit.
    z : ndarray
        Unknowns.

    Returns
    -------
    ndarray
        Array of shape (rows,), inf for rows without a following release. See `chatter_and_release.excess_speed`.
    """
    return np.asarray(_evaluate_row_values(chatter_and_release.excess_speed, z, problem))


def min_contact_forces(problem, z):
    """Return the least contact force between each row and its release.

    For an impact with R = 0 that no release follows, the value is the force that pulls the mass off the wall.

    Parameters
    ----------
    problem : OrbitProblem
        Equations of the orbit.
    z : ndarray
        Unknowns.

    Returns
    -------
    ndarray
        Array of shape (rows,), inf for other rows.
    """
    return np.asarray(diagnose(problem, z[None]).min_contact_force)[0]


def toggle_early_lift_off(problem, z):
    """Switch between equations of orbits with and without a lift-off of the mass before it sticks.

    Parameters
    ----------
    problem : OrbitProblem
        Equations of the orbit.
    z : ndarray
        Unknowns.

    Returns
    -------
    OrbitProblem or None
        Switched equations; None if the orbit does not stick, or if no sticking phase begins with zero contact force.
    """
    if problem.sequence.releases is None:
        return None
    zero_force_rows = np.flatnonzero(
        abs(np.asarray(_evaluate_row_values(chatter_and_release.initial_contact_force, z, problem)))
        < GRAZING_TOLERANCE * problem.length_scale
    )
    if not len(zero_force_rows):
        return None
    release_codes = np.array(problem.sequence.releases)
    release_rows = (zero_force_rows + 1) % np.count_nonzero(problem.sequence.sides)
    release_codes[release_rows] = 3.0 - release_codes[release_rows]
    return problem._replace(sequence=problem.sequence._replace(releases=release_codes))


def locate_sticking_limit(problem, z, row, row_values_of):
    """Locate the point near z at which the excess speed or the least contact force of a row is zero.

    Parameters
    ----------
    problem : OrbitProblem
        Equations of the orbit.
    z : ndarray
        Guess.
    row : int
        Row of the impact.
    row_values_of : callable
        `excess_speeds` or `min_contact_forces`.

    Returns
    -------
    continuation.augmented_systems.RootAndResidual
        Solution.
    """
    n_rows, next_row = problem.n_rows, (row + 1) % problem.n_used_rows
    # The values depend on the times and speeds of the row and of the next row, and on the parameters.
    entry_indices = [*sorted({row, next_row, n_rows + row, n_rows + next_row}), *range(2 * n_rows, len(z))]
    return problem.locate_zero(z, lambda z: row_values_of(problem, z)[row], entry_indices)


def sticking_limit_kind(problem, z):
    """Classify the limit of an orbit that sticks.

    Parameters
    ----------
    problem : OrbitProblem
        Equations of the orbit.
    z : ndarray
        Unknowns.

    Returns
    -------
    str
        ``"CH"`` if a sticking phase begins to exist, ``"RL"`` if the least contact force vanishes, otherwise empty.
    """
    rounding_tolerance, release_codes = GRAZING_TOLERANCE * problem.length_scale, problem.sequence.releases
    zero_force_rows = np.flatnonzero(abs(min_contact_forces(problem, z)) < rounding_tolerance)
    if release_codes is None:
        return "CH" if len(zero_force_rows) else ""
    next_release_codes = release_codes[(zero_force_rows + 1) % np.count_nonzero(problem.sequence.sides)]
    if (next_release_codes == 0).any() or (abs(excess_speeds(problem, z)) < rounding_tolerance).any():
        return "CH"
    return "RL" if len(zero_force_rows) else ""


MAX_BISECTIONS = 60  # of an interval that contains a grazing


class OrbitEventDetector(EventDetector):
    """Event detector for orbits that must stay between the walls and have impacts with positive speed.

    Parameters
    ----------
    problem : OrbitProblem
        Problem of the orbits.
    """

    def __init__(self, problem):
        self.problem = problem

    def refine_points(self, task, points, diagnostics):
        return insert_missed_grazings(task, points, diagnostics)

    def diagnose(self, zs):
        return diagnose(self.problem, zs)

    def is_admissible(self, zs, diagnostics):
        return are_admissible(self.problem, zs, diagnostics)

    def find_boundary_end(self, task, points, diagnostics, first_bad):
        """End the curve at the grazing before the first inadmissible point."""
        points, residual = truncate_at_grazing(task, points, diagnostics, first_bad)
        if residual is None:
            return None
        return Termination(points, SpecialIndex(0, self.end_kind(points.z[-1]), residual), End.GRAZE)

    def end_kind(self, z):
        """Return the kind of special point at which the orbits become inadmissible."""
        return "GR"


def truncate_at_grazing(task, points, diagnostics, first_inadmissible):
    """Truncate points at the grazing before the first inadmissible point.

    Parameters
    ----------
    task : continuation.continuation_loop.ContinuationTask
        Task whose ``args`` are the equations.
    points : continuation.arclength.Point
        Points along the curve.
    diagnostics : Diagnostics
        Diagnostics of the points.
    first_inadmissible : int
        Index of the first inadmissible point.

    Returns
    -------
    points : continuation.arclength.Point
        Admissible points, and the grazing if it is located.
    residual : float or None
        Largest residual at the grazing; None if the grazing is not located or the time limit is reached.
    """
    admissible_point, step_length = row_at(points, first_inadmissible - 1), float(points.step[first_inadmissible])
    inadmissible_point, inadmissible_diagnostics, lower_arclength, upper_arclength = (
        row_at(points, first_inadmissible),
        row_at(diagnostics, first_inadmissible),
        0.0,
        step_length,
    )
    for _ in range(MAX_BISECTIONS):
        located_grazing = _locate_first_grazing(
            task,
            admissible_point,
            inadmissible_point,
            inadmissible_diagnostics,
            lower_arclength,
            upper_arclength,
        )
        if located_grazing is not None or task.limits.expired:
            break
        middle_point = point_at_length(task, points, first_inadmissible - 1, 0.5 * (lower_arclength + upper_arclength))
        if middle_point is None:
            break
        middle_diagnostics = diagnose(task.args, middle_point.z[None])
        if are_admissible(task.args, middle_point.z, middle_diagnostics)[0]:
            lower_arclength = 0.5 * (lower_arclength + upper_arclength)
        else:
            upper_arclength, inadmissible_point, inadmissible_diagnostics = (
                0.5 * (lower_arclength + upper_arclength),
                middle_point,
                row_at(middle_diagnostics, 0),
            )
    truncated_points = first_rows(points, first_inadmissible)
    if located_grazing is None:
        return truncated_points, None
    grazing_z, residual = located_grazing
    return insert_row(
        truncated_points, first_inadmissible, point_from_z(task, points, first_inadmissible - 1, grazing_z)
    ), residual


def _locate_first_grazing(
    task, admissible_point, inadmissible_point, inadmissible_diagnostics, lower_arclength, upper_arclength
):
    """Return (z, residual) of the first grazing between two arclengths from an admissible point.

    The result is None if no grazing is located, or if another grazing precedes the located grazing.
    """
    problem = task.args
    n_rows, impact_row_indices = len(problem.sequence.sides), problem.impact_rows
    middle_z = 0.5 * (admissible_point.z + inadmissible_point.z)
    squared_weights, candidate_solutions = task.control.scale**2, []
    for row in impact_row_indices:
        if inadmissible_point.z[n_rows + row] <= 0:
            candidate_solutions.append(_locate_zero_speed(task, middle_z, int(row)))
    if not candidate_solutions or not (inadmissible_point.z[n_rows + impact_row_indices] <= 0).any():
        for row, wall_index in zip(*np.nonzero(inadmissible_diagnostics.clearance < 0), strict=True):
            candidate_solutions.append(
                locate_grazing(
                    problem,
                    inadmissible_point.z,
                    row,
                    wall_index,
                    float(inadmissible_diagnostics.turning_time[row, wall_index]),
                )
            )
        candidate_solutions += _locate_sticking_ends(problem, middle_z, inadmissible_diagnostics)
    nearest_candidate = None
    for candidate in candidate_solutions:
        if candidate.z is None:
            continue
        candidate_arclength = float(
            np.sum(squared_weights * admissible_point.tangent * (candidate.z - admissible_point.z))
        )
        is_between = (
            lower_arclength - 1e-9 - 0.02 * (upper_arclength - lower_arclength)
            <= candidate_arclength
            <= upper_arclength + 1e-9 + 0.02 * (upper_arclength - lower_arclength)
        )
        if is_between and (nearest_candidate is None or candidate_arclength < nearest_candidate[0]):
            nearest_candidate = candidate_arclength, candidate
    if nearest_candidate is None:
        return None
    grazing_z = set_slow_speeds_to_zero(problem, nearest_candidate[1].z)
    diagnostics, min_allowed_clearance = diagnose(problem, grazing_z[None]), -GRAZING_TOLERANCE * problem.length_scale
    has_earlier_grazing = (
        diagnostics.clearance.min(initial=0.0) < min_allowed_clearance
        or grazing_z[n_rows : 2 * n_rows].min(initial=0.0) < min_allowed_clearance
    )
    return None if has_earlier_grazing else (grazing_z, nearest_candidate[1].residual)


def _locate_sticking_ends(problem, z, inadmissible_diagnostics):
    """Locate the points near z at which sticking phases that are missing at the inadmissible point cease to exist."""
    functions_with_margins = zip(
        (excess_speeds, min_contact_forces),
        problem.condition.sticking_margins(inadmissible_diagnostics),
        strict=True,
    )
    return [
        locate_sticking_limit(problem, z, int(row), row_values_of)
        for row_values_of, row_margins in functions_with_margins
        for row in np.flatnonzero(row_margins <= 0)
    ]


def _locate_zero_speed(task, z, impact_row):
    """Locate the point near z at which the speed of an impact is zero."""
    problem = task.args
    n_rows = len(problem.sequence.sides)
    if len(z) > 2 * n_rows + 1 and soft_wall_grazing.is_smooth_soft_wall(
        problem.scene, problem.sequence.sides[impact_row]
    ):  # singular, for a locus
        return soft_wall_grazing.locate_soft_grazing(problem, z, [impact_row])
    point = event_search.solve_with_fixed_entry(task.problem, z, n_rows + impact_row, 0.0, task.control, problem)
    return RootAndResidual(point.z if point.converged else None, float(point.residual))
