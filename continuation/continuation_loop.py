"""Run the continuation loop, in one parameter or in two.

The loop computes a chunk of steps, truncates it where the branch ends and inserts its special points. This is repeated
until the branch ends. An `EventDetector` adds diagnostics and events to those of the equations. Its methods are called
in this order: `diagnose`, `is_admissible`, `refine_points`, `is_admissible` again if `refine_points` adds points,
`is_past_singularity`, `find_early_end`, `find_boundary_end`, `find_closure`, `find_events`, `end_at_special_point`.
"""

from enum import Enum
from typing import Any, NamedTuple

import numpy as np

from . import arclength, event_search
from .arclength import OUTSIDE, RUNNING, Point, StepControl, make_start_point, make_track_state
from .augmented_systems import tangent_through_point
from .branch_segment import (
    UNLIMITED,
    BranchSegment,
    Limits,
    SpecialIndex,
    first_rows,
    has_slow_progress,
    insert_row,
    join_rows,
    join_segments,
    map_fields,
    row_at,
    warn_if_slow,
)
from .event_search import point_from_z, truncate_at_length, truncate_at_value
from .problem import Problem

POINT_LIMIT = 20_000  # largest number of points of a branch
RETRY_FACTOR = 0.25  # ratio of the step after a failed step to the failed one
FIRST_CHUNK = 4  # steps before points are first checked; those beyond the first inadmissible point are discarded


class End(Enum):
    """Termination reasons as texts with placeholders: `name` and `value` of a parameter, `kind` of a special point."""

    BOUND = "{name} reached its bound {value:.12g}"
    DOMAIN = "the domain of {name} ends at {value:.12g}"
    CLOSED = "it closes: the branch came back to its start at {value:.12g}"
    HOPF = "it ends in the Hopf point at {value:.12g}"
    STOPPED = "stopped at {kind}, {value:.12g}"
    STEP = "the step became too small at {value:.12g}: Newton's method does not converge there"
    POINTS = "it has too many points, the last at {value:.12g}"
    MAX_POINTS = "max_points reached at {value:.12g}"
    MAX_SECONDS = "max_seconds reached at {value:.12g}"
    NUMBER = "a number is not finite after {value:.12g}"


# Ends by the status of a chunk.
ENDS = {RUNNING: None, OUTSIDE: End.BOUND, arclength.UNDERFLOW: End.STEP, arclength.NONFINITE: End.NUMBER}


class Termination(NamedTuple):
    """Termination that an `EventDetector` reports.

    Attributes
    ----------
    points : Point
        Points up to the end.
    special : SpecialIndex
        Special point at the end. Its row is arbitrary.
    end : Enum
        Termination reason.
    """

    points: Point
    special: SpecialIndex
    end: Enum


class EventDetector:
    """Detector of special points and ends besides those of the equations; the base class detects none."""

    def refine_points(self, task, points, diagnostics):
        """Insert points where an event between two points may be missed.

        Parameters
        ----------
        task : ContinuationTask
            The task.
        points : Point
            Points, one row each.
        diagnostics : Any
            Diagnostics of the points.

        Returns
        -------
        tuple
            Points and diagnostics, with the inserted rows.
        """
        return points, diagnostics

    def diagnose(self, zs):
        """Compute diagnostics of points: a NamedTuple of arrays with one row per point, or None."""
        return None

    def is_admissible(self, zs, diagnostics):
        """Return a bool array of shape (points,), True for admissible solutions."""
        return np.ones(len(zs), bool)

    def is_past_singularity(self, points):
        """Return a bool array of shape (points,), True for points just beyond a singularity without branching."""
        return np.zeros(len(points.z), bool)

    def find_early_end(self, task, points):
        """Return the `Termination` of an end that occurs before any point is inadmissible, or None."""
        return None

    def find_boundary_end(self, task, points, diagnostics, first_bad):
        """Return the `Termination` just before the first inadmissible point; None if the end is not located."""
        return None

    def find_events(self, task, points, diagnostics, known_branch_points, termination):
        """Locate the special points between points.

        Parameters
        ----------
        task : ContinuationTask
            The task.
        points : Point
            Points, one row each.
        diagnostics : Any
            Diagnostics of the points.
        known_branch_points : dict of int to Event
            Located branch points by the row before each point.
        termination : Termination or None
            Termination at the last point.

        Returns
        -------
        list of Event
            Special points.
        """
        values = event_search.test_function_values(task.problem, points, task.args)
        return event_search.locate_events(task.problem, points, values, task.control, task.args, known_branch_points)

    def equivalent_points(self, z, near_z):
        """Return the points near `near_z` that represent the same solution as z."""
        return [z]

    def find_closure(self, task, points):
        """Return (row before, length from this row) where the branch returns to a start of the task, or None."""
        target_zs = [
            equivalent_z for start_z in task.starts for equivalent_z in self.equivalent_points(start_z, points.z[0])
        ]
        return (
            event_search.find_first_pass(task.problem, points, target_zs, task.control, task.args)
            if target_zs
            else None
        )

    def end_at_special_point(self, z, kind):
        """Return the `End` if a special point always ends the branch, else None."""
        return None


class ContinuationTask(NamedTuple):
    """Definition of one continuation.

    Parameters
    ----------
    problem : Problem
        Equations.
    args : Any
        Further argument of the equations.
    control : StepControl
        Step sizes, tolerance and bounds of the last parameter.
    first_step : float
        Length of the first step.
    bounds : tuple
        (low, high) of each parameter. The bounds of the last parameter agree with `control`.
    domain_ends : tuple, optional
        For each parameter, the bounds that limit its domain and were not chosen by the user. A branch that reaches such
        a bound ends with `End.DOMAIN`.
    detector : EventDetector, optional
        Detector of events besides those of the equations.
    stop : tuple of str, optional
        Kinds of special point at which the branch ends.
    starts : tuple of ndarray, optional
        Solutions that close the branch if it returns to them.
    limits : Limits, optional
        Limits of the number of points and of the time.
    """

    problem: Problem
    args: Any
    control: StepControl
    first_step: float
    bounds: tuple[tuple[float, float], ...]
    domain_ends: tuple[tuple[float, ...], ...] = ()
    detector: EventDetector = EventDetector()
    stop: tuple[str, ...] = ()
    starts: tuple[Any, ...] = ()
    limits: Limits = UNLIMITED


def follow_branch(task, start_point):
    """Continue a branch from a point.

    Parameters
    ----------
    task : ContinuationTask
        The task.
    start_point : Point
        Starting point; its tangent points along the branch.

    Returns
    -------
    BranchSegment
        The branch in this direction.
    """
    segments, start_state = [], make_track_state(start_point, task.first_step)
    while start_state is not None:
        for points, diagnosed_points, track_status in _generate_chunks(task, start_state, _count_points(segments)):
            segment, retry_step = _make_segment(task, points, diagnosed_points, track_status)
            segment = _apply_limits(task.limits, segment, _count_points([*segments, segment]))
            task.limits.report(_count_points([*segments, segment]))
            if not any(map(has_slow_progress, segments)):  # warn once per branch
                warn_if_slow(task.control, segment)
            segments.append(segment)
            if segment.end is not None or retry_step is not None:
                break
        is_retried = segment.end is None and retry_step is not None
        start_state = make_track_state(row_at(segment.points, -1), retry_step) if is_retried else None
    return join_segments(segments)


def follow_both_directions(task, z, tangent, direction="both"):
    """Continue from a solution in the requested directions.

    Returns (backward `BranchSegment`, forward `BranchSegment`). A segment is None if its direction is not requested.
    The backward segment is also None if the forward segment closes.
    """
    backward_segment, forward_segment, limits = None, None, task.limits
    if direction != "backward":
        forward_task = task._replace(limits=limits.half_points() if direction == "both" else limits)
        forward_segment = follow_branch(forward_task, make_start_point(z, tangent))
        limits = limits.after_points(len(forward_segment.points.z) - 1)
    if direction != "forward" and (forward_segment is None or forward_segment.end is not End.CLOSED):
        backward_segment = follow_branch(task._replace(limits=limits), make_start_point(z, -tangent))
    return backward_segment, forward_segment


class DiagnosedPoints(NamedTuple):
    """Points with their diagnostics.

    Attributes
    ----------
    z : ndarray
        Points, one row each.
    diagnostics : Any
        Diagnostics of the `EventDetector`, one row per point, or None.
    admissible : ndarray
        True for admissible points. Array of shape (points,).
    """

    z: Any
    diagnostics: Any
    admissible: Any


def _diagnose_points(detector, zs):
    diagnostics = detector.diagnose(zs)
    return DiagnosedPoints(zs, diagnostics, np.array(detector.is_admissible(zs, diagnostics)))


def _generate_chunks(task, track_state, n_earlier_points):
    """Yield (points, `DiagnosedPoints` of the points, status) of each chunk of steps.

    The first check of the points follows after `FIRST_CHUNK` steps. The interval between checks then grows to
    `CHUNK_SIZE` steps. A chunk ends if it has more than `CHUNK_SIZE` points or an inadmissible point, if the branch
    ends, or if a limit is reached. `n_earlier_points` is the number of points of the branch before the first chunk.
    """
    chunk_points = None
    for points, track_status in event_search.track_chunks(
        task.problem, track_state, task.control, task.args, FIRST_CHUNK
    ):
        if chunk_points is None:
            chunk_points, diagnosed_points = points, _diagnose_points(task.detector, points.z)
            diagnosed_points.admissible[0] = True
        elif len(points.z) > 1:
            new_diagnosed_points = _diagnose_points(task.detector, points.z[1:])
            diagnostics = map_fields(
                lambda *leaves: np.concatenate(leaves), diagnosed_points.diagnostics, new_diagnosed_points.diagnostics
            )
            chunk_points = join_rows([chunk_points, points])
            diagnosed_points = DiagnosedPoints(
                chunk_points.z,
                diagnostics,
                np.concatenate([diagnosed_points.admissible, new_diagnosed_points.admissible]),
            )
        is_chunk_complete = (
            track_status != RUNNING
            or len(chunk_points.z) > event_search.CHUNK_SIZE
            or not diagnosed_points.admissible.all()
        )
        if is_chunk_complete or task.limits.is_reached(n_earlier_points + len(chunk_points.z) - 1):
            yield chunk_points, diagnosed_points, track_status
            n_earlier_points, chunk_points = n_earlier_points + len(chunk_points.z) - 1, None


def _count_points(segments):
    """Count the points of consecutive `BranchSegment` objects."""
    return 1 + sum(len(segment.points.z) - 1 for segment in segments)


def _apply_limits(limits, segment, n_points):
    """Truncate a `BranchSegment` where a limit is reached.

    `n_points` counts the points of the branch up to the end of the segment.
    """
    n_excess_points = -1 if limits.points_remaining is None else n_points - max(limits.points_remaining, 1)
    if n_excess_points > 0 or (n_excess_points == 0 and segment.end is None):
        n_allowed_rows = max(len(segment.points.z) - n_excess_points, 1)
        specials = tuple(special for special in segment.specials if special.row < n_allowed_rows)
        points, diagnostics = (
            first_rows(segment.points, n_allowed_rows),
            first_rows(segment.diagnostics, n_allowed_rows),
        )
        return BranchSegment(segment.args, points, diagnostics, specials, End.MAX_POINTS, -1, float(points.z[-1, -1]))
    if segment.end is None and (n_points > POINT_LIMIT or limits.expired):
        return segment._replace(end=End.POINTS if n_points > POINT_LIMIT else End.MAX_SECONDS)
    return segment


def _make_segment(task, points, known_points, track_status):
    """Make the `BranchSegment` of a chunk of steps from its points and `DiagnosedPoints`.

    Returns the segment and a step length. If a step from the last point failed, the step length is that of a retry,
    else None.
    """
    detector = task.detector
    # Truncate first: points beyond a bound must not be examined.
    points, end, param_index = _truncate_at_bounds(task, points, ENDS[track_status])
    diagnostics = _diagnose_new_points(detector, points.z, known_points.z, known_points.diagnostics)
    points, diagnostics = detector.refine_points(task, points, diagnostics)
    is_known = np.array_equal(points.z, known_points.z)
    admissible = known_points.admissible if is_known else detector.is_admissible(points.z, diagnostics)
    admissible[0] = True
    diagnosed_z = points.z
    points, end, retry_step, termination, branch_points = _cut_at_end(task, points, diagnostics, admissible, end)
    closure_position = detector.find_closure(task, points)
    if closure_position is not None:
        points = truncate_at_length(task, points, *closure_position)
        end, retry_step, termination = End.CLOSED, None, None
    diagnostics = _diagnose_new_points(detector, points.z, diagnosed_z, diagnostics)
    diagnosed_z = points.z
    events = detector.find_events(task, points, diagnostics, branch_points, termination)
    points, specials = _insert_events(task, points, sorted(events, key=lambda event: (event.row_before, event.length)))
    if termination is not None:
        specials.append(termination.special._replace(row=len(points.z) - 1))
    points, specials, end_at_special = _truncate_at_stop(task, points, specials)
    diagnostics = _diagnose_new_points(detector, points.z, diagnosed_z, diagnostics)
    end, end_value = end_at_special or end, float(points.z[-1, param_index])
    segment = BranchSegment(task.args, points, diagnostics, tuple(specials), end, param_index, end_value)
    return segment, None if end_at_special else retry_step


def _cut_at_end(task, points, diagnostics, admissible, end):
    """Truncate points at an early end, a jump or the first inadmissible point.

    Returns the points, the `End` or None, the step length of a retry or None, the `Termination` or None, and the branch
    points by the row before each.
    """
    detector, n_admissible = task.detector, int(np.argmin(np.append(admissible, False)))
    is_time_up = task.limits.expired  # then skip the search for the end and for jumps, which may take long
    is_truncated_by_time = is_time_up and n_admissible < len(points.z)
    if is_truncated_by_time:
        points, end = first_rows(points, n_admissible), End.MAX_SECONDS
    candidate_points = first_rows(points, n_admissible + 1)
    is_past_singularity = detector.is_past_singularity(candidate_points) | is_time_up
    jump_row, branch_points = event_search.find_jump(
        task.problem, candidate_points, task.control, task.args, is_past_singularity
    )
    end_row = n_admissible if jump_row is None else jump_row
    termination = None if is_truncated_by_time else detector.find_early_end(task, first_rows(points, end_row))
    if termination is not None and not _is_out_of_bounds(task, termination.points.z[-1]):
        return termination.points, termination.end, None, termination, branch_points
    if end_row == len(points.z):
        return points, end, None, None, branch_points
    failed_step = points.step[end_row]
    termination = detector.find_boundary_end(task, points, diagnostics, end_row) if jump_row is None else None
    if termination is not None:
        return termination.points, termination.end, None, termination, branch_points
    end, retry_step = _retry_step_or_end(failed_step, task.control)
    if jump_row is None and task.limits.expired:  # the search may have been aborted
        end = End.MAX_SECONDS
    return first_rows(points, end_row), end, retry_step, None, branch_points


def _diagnose_new_points(detector, zs, known_zs, known_diagnostics):
    """Compute the diagnostics of new points and reuse those of known points. Diagnostics depend only on z."""
    if known_diagnostics is None or zs is known_zs:
        return known_diagnostics
    row_by_z_bytes = {z.tobytes(): row for row, z in enumerate(known_zs)}
    known_rows = np.array([row_by_z_bytes.get(z.tobytes(), -1) for z in zs])
    diagnostics, is_new = map_fields(lambda leaf: leaf[known_rows], known_diagnostics), known_rows < 0
    if is_new.any():
        for leaf, new_values in zip(diagnostics, detector.diagnose(zs[is_new]), strict=True):
            leaf[is_new] = new_values
    return diagnostics


def _truncate_at_bounds(task, points, end):
    """Truncate points at the first bound.

    Returns the points, the `End` and the index in z of the parameter that the termination reason reports.
    """
    param_index = -1
    for index in range(-len(task.bounds), 0):  # one step may cross several bounds
        lower, upper = task.bounds[index]
        is_outside = (points.z[:, index] < lower) | (points.z[:, index] > upper)
        is_outside[0] = False
        if is_outside.any():
            row_beyond = int(np.argmax(is_outside))
            crossed_bound = lower if points.z[row_beyond, index] < lower else upper
            points, is_located = truncate_at_value(task, points, row_beyond, index, crossed_bound)
            domain_ends = task.domain_ends[index] if task.domain_ends else ()
            end, param_index = (
                (End.DOMAIN if crossed_bound in domain_ends else End.BOUND) if is_located else End.STEP,
                index,
            )
    return points, end, param_index


def _is_out_of_bounds(task, z):
    """Return True if a parameter is out of bounds."""
    return any(
        not lower <= z[index] <= upper
        for index, (lower, upper) in zip(range(-len(task.bounds), 0), task.bounds, strict=True)
    )


def _retry_step_or_end(failed_step, control):
    """Return (None, shorter step) after a failed step, or (`End`, None) if the step would be too small."""
    retry_step = RETRY_FACTOR * float(failed_step)
    return (End.STEP, None) if retry_step < control.min_step else (None, retry_step)


def _insert_events(task, points, events):
    """Insert the points of events; return the points and the list of `SpecialIndex`."""
    specials, length_by_row = [], {}
    for n_inserted, (kind, row_before, length, z, residual) in enumerate(events):
        point = point_from_z(task, points, row_before + n_inserted, z)
        if kind == "BP":
            incoming_tangent = points.tangent[row_before + n_inserted]
            point = point._replace(
                tangent=tangent_through_point(task.problem, z, task.control.scale, task.args, incoming_tangent)
            )
        points = insert_row(
            points,
            row_before + n_inserted + 1,
            point._replace(step=np.float64(length - length_by_row.get(row_before, 0.0))),
        )
        length_by_row[row_before] = length
        specials.append(SpecialIndex(row_before + n_inserted + 1, kind, residual))
    return points, specials


def _truncate_at_stop(task, points, specials):
    """Truncate at the first special point that ends the branch; return (points, special points, `End` or None)."""
    for special in sorted(specials, key=lambda special: special.row):
        end_at_special = task.detector.end_at_special_point(points.z[special.row], special.kind)
        end_at_special = end_at_special or (End.STOPPED if special.kind in task.stop else None)
        if end_at_special:
            return (
                first_rows(points, special.row + 1),
                [candidate_special for candidate_special in specials if candidate_special.row <= special.row],
                end_at_special,
            )
    return points, specials, None
