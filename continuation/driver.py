"""Run the continuation loop, in one parameter or in two.

The loop computes chunks of steps, truncates each where the branch ends, inserts its special points and repeats until
the branch ends. An `EventDetector` adds diagnostics and events to those of the equations. Its methods are called in
this order: `diagnose`, `is_admissible`, `refine_points`, `is_admissible` if that adds points, `is_past_singularity`,
`find_early_end`, `find_boundary_end`, `find_closure`, `find_events`, `end_at_special_point`.
"""

from enum import Enum
from typing import Any, NamedTuple

import numpy as np

from . import arclength, event_search
from .arclength import OUTSIDE, RUNNING, Point, StepControl, TrackState
from .branch_segment import BranchSegment, SpecialIndex, join_segments
from .branch_switching import continued_tangent
from .intermediate_points import point_from_z, truncate_at_length, truncate_at_value
from .limits import UNLIMITED, Limits
from .point_rows import head, insert_row, join_rows, map_fields, row_at
from .problem import Problem
from .slow_progress import is_slow, warn_if_slow

POINT_LIMIT = 20_000  # largest number of points of a branch
RETRY_FACTOR = 0.25  # ratio of the step after a failed step to the failed one
FIRST_CHUNK = 4  # steps before points are first checked; those beyond the first inadmissible point are discarded


class End(Enum):
    """Termination reasons; the text refers to the parameter `name` at `value` and the special point `kind`."""

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
        Special point at the end; its row is not set.
    end : Enum
        Termination reason.
    """

    points: Point
    special: SpecialIndex
    end: Enum


class EventDetector:
    """Diagnostics, special points and ends besides those of the equations; this base class adds none."""

    def refine_points(self, task, points, diagnostics):
        """Insert points where an event may be missed between two.

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
        """Compute diagnostics of the points `zs`, a pytree of arrays with one row per point."""
        return None

    def is_admissible(self, zs, diagnostics):
        """Return which points are admissible solutions, bool array of shape (points,)."""
        return np.ones(len(zs), bool)

    def is_past_singularity(self, points):
        """Return which points lie just beyond a singularity without branching, shape (points,)."""
        return np.zeros(len(points.z), bool)

    def find_early_end(self, task, points):
        """Return the `Termination` of an end that is detected before a point is inadmissible, or None."""
        return None

    def find_boundary_end(self, task, points, diagnostics, first_bad):
        """Return the `Termination` before the first inadmissible point, or None if it is not located."""
        return None

    def find_events(self, task, points, diagnostics, branch_points, termination):
        """Locate the special points between points.

        Parameters
        ----------
        task : ContinuationTask
            The task.
        points : Point
            Points, one row each.
        diagnostics : Any
            Diagnostics of the points.
        branch_points : dict of int to Event
            Branch points that are already located, by the row before them.
        termination : Termination or None
            Termination at the last point.

        Returns
        -------
        list of Event
            Special points.
        """
        values = event_search.test_function_values(task.problem, points, task.args)
        return event_search.locate_events(task.problem, points, values, task.control, task.args, branch_points)

    def equivalent_points(self, z, near_z):
        """Return the points near `near_z` that represent the same solution as z."""
        return [z]

    def find_closure(self, task, points):
        """Return (row, length) where the branch returns to one of the starts, or None."""
        targets = [image for start in task.starts for image in self.equivalent_points(start, points.z[0])]
        return event_search.find_pass(task.problem, points, targets, task.control, task.args) if targets else None

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
        (low, high) of each parameter; those of the last agree with the control.
    domain_ends : tuple, optional
        Bounds of each parameter that are ends of its domain and not requested bounds.
    detector : EventDetector, optional
        Diagnostics and events besides those of the equations.
    stop : tuple of str, optional
        Kinds of special point at which the branch ends.
    starts : tuple of ndarray, optional
        Solutions that close the branch if it returns to them.
    limits : Limits, optional
        Limits of points and time.
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


def follow_branch(task, start):
    """Continue a branch from a point.

    Parameters
    ----------
    task : ContinuationTask
        The task.
    start : Point
        Starting point; its tangent points along the branch.

    Returns
    -------
    BranchSegment
        The branch in this direction.
    """
    segments, state = [], _start_state(start, task.first_step)
    while state is not None:
        for points, info, status in _generate_chunks(task, state, _count_points(segments)):
            state = _add_segment(task, segments, points, info, status)
            if segments[-1].end is not None or state is not None:
                break
    return join_segments(segments)


class PointInfo(NamedTuple):
    """Points with their diagnostics and a mask of the admissible ones."""

    z: Any
    diagnostics: Any
    admissible: Any


def _point_info(detector, zs):
    diagnostics = detector.diagnose(zs)
    return PointInfo(zs, diagnostics, np.array(detector.is_admissible(zs, diagnostics)))


def _generate_chunks(task, state, n_points):
    """Yield (points, their `PointInfo`, status) of chunks of steps.

    Points are checked after a few steps each. A chunk ends after its first inadmissible point and where a limit is
    reached. `n_points` is the number of points before.
    """
    chunk = None
    for points, status in event_search.track_chunks(task.problem, state, task.control, task.args, FIRST_CHUNK):
        if chunk is None:
            chunk, info = points, _point_info(task.detector, points.z)
            info.admissible[0] = True
        elif len(points.z) > 1:
            new_points = _point_info(task.detector, points.z[1:])
            diagnostics = map_fields(lambda *leaves: np.concatenate(leaves), info.diagnostics, new_points.diagnostics)
            chunk = join_rows([chunk, points])
            info = PointInfo(chunk.z, diagnostics, np.concatenate([info.admissible, new_points.admissible]))
        is_complete = status != RUNNING or len(chunk.z) > event_search.CHUNK_SIZE or not info.admissible.all()
        if is_complete or task.limits.reached(n_points + len(chunk.z) - 1):
            yield chunk, info, status
            n_points, chunk = n_points + len(chunk.z) - 1, None


def follow_branches(tasks, start_points):
    """Continue several branches; tasks of one problem and size run as lanes of one compiled call.

    Parameters
    ----------
    tasks : sequence of ContinuationTask
        The tasks.
    start_points : sequence of Point
        Starting point of each.

    Returns
    -------
    list of BranchSegment
        One segment per task.
    """
    lanes_by_problem, segment_of_lane = {}, {}
    for lane, (task, start) in enumerate(zip(tasks, start_points, strict=True)):
        lanes_by_problem.setdefault((task.problem, len(start.z)), []).append(lane)
    for (problem, _), lanes in lanes_by_problem.items():
        lane_segments = _follow_lanes(problem, [tasks[lane] for lane in lanes], [start_points[lane] for lane in lanes])
        segment_of_lane |= zip(lanes, lane_segments, strict=True)
    return [segment_of_lane[lane] for lane in range(len(tasks))]


def _follow_lanes(problem, tasks, start_points):
    lane_segments = [[] for _ in tasks]

    def on_chunk(lane, points, status):
        state = _add_segment(
            tasks[lane], lane_segments[lane], points, _point_info(tasks[lane].detector, points.z), status
        )
        return None if lane_segments[lane][-1].end is not None else state or True

    states = [_start_state(start, task.first_step) for task, start in zip(tasks, start_points, strict=True)]
    event_search.track_branches(
        problem, states, [task.control for task in tasks], [task.args for task in tasks], on_chunk
    )
    return [join_segments(segments) for segments in lane_segments]


def _start_state(start, first_step):
    return TrackState(start.z, start.tangent, np.float64(first_step), np.int32(RUNNING))


def _add_segment(task, segments, points, info, status):
    """Append the `BranchSegment` of a chunk of steps.

    Returns the `TrackState` with which to retry with a smaller step, or None if no retry is needed.
    """
    segment, retry_step = _make_segment(task, points, info, status)
    n_points = _count_points([*segments, segment])
    if segment.end is None and n_points > POINT_LIMIT:
        segment = segment._replace(end=End.POINTS)
    segment = _apply_limits(task.limits, segment, n_points)
    segments.append(segment)
    task.limits.report(_count_points(segments))
    if not any(is_slow(segment) for segment in segments[:-1]):  # warn once per branch
        warn_if_slow(task.control, segment)
    return _start_state(row_at(segment.points, -1), retry_step) if segment.end is None and retry_step else None


def _count_points(segments):
    """Count the points of consecutive `BranchSegment` objects."""
    return 1 + sum(len(segment.points.z) - 1 for segment in segments)


def _apply_limits(limits, segment, n_points):
    """Truncate a `BranchSegment` where a limit is reached; `n_points` is the number of all points up to its end."""
    n_excess = 0 if limits.room is None else n_points - max(limits.room, 1)
    if n_excess > 0 or (n_excess == 0 and limits.room is not None and segment.end is None):
        n_remaining = max(len(segment.points.z) - n_excess, 1)
        specials = tuple(special for special in segment.specials if special.row < n_remaining)
        points, diagnostics = head(segment.points, n_remaining), head(segment.diagnostics, n_remaining)
        return BranchSegment(segment.args, points, diagnostics, specials, End.MAX_POINTS, -1, float(points.z[-1, -1]))
    if segment.end is None and limits.expired:
        return segment._replace(end=End.MAX_SECONDS)
    return segment


def _make_segment(task, points, info, status):
    """Make the `BranchSegment` of a chunk of steps from its points and `PointInfo`.

    Returns it and the step with which to continue from its last point if a longer step failed, else None.
    """
    detector, retry_step = task.detector, None
    # Truncate first: points beyond a bound must not be examined.
    points, end, param_index = _truncate_at_bounds(task, points, ENDS[status])
    points, diagnostics = detector.refine_points(task, points, _diagnose(detector, points.z, info.z, info.diagnostics))
    admissible = info.admissible if np.array_equal(points.z, info.z) else detector.is_admissible(points.z, diagnostics)
    admissible[0] = True
    n_points, first_bad, info = len(points.z), int(np.argmin(np.append(admissible, False))), points.z
    expired = task.limits.expired  # then skip the search for the end and for jumps, which may take long
    truncated = expired and first_bad < n_points
    points, end = (head(points, first_bad), End.MAX_SECONDS) if truncated else (points, end)
    candidates = head(points, first_bad + 1)
    jump, branch_points = event_search.find_jump(
        task.problem, candidates, task.control, task.args, detector.is_past_singularity(candidates) | expired
    )
    termination = (
        None if truncated else detector.find_early_end(task, head(points, first_bad if jump is None else jump))
    )
    termination = None if termination is not None and _is_outside(task, termination.points.z[-1]) else termination
    if termination is None and jump is not None:
        points, (end, retry_step) = head(points, jump), _retry(points.step[jump], task.control)
    elif termination is None and first_bad < n_points and not truncated:
        termination, step = detector.find_boundary_end(task, points, diagnostics, first_bad), points.step[first_bad]
        if termination is None:
            points, (end, retry_step) = head(points, first_bad), _retry(step, task.control)
            end = End.MAX_SECONDS if task.limits.expired else end  # the search may have been aborted
    if termination is not None:
        points, end = termination.points, termination.end
    closure = detector.find_closure(task, points)
    if closure is not None:
        points, termination, end, retry_step = truncate_at_length(task, points, *closure), None, End.CLOSED, None
    if len(points.z) != n_points or termination is not None or closure is not None:
        info, diagnostics = points.z, _diagnose(detector, points.z, info, diagnostics)
    events = sorted(
        detector.find_events(task, points, diagnostics, branch_points, termination),
        key=lambda event: (event.row_before, event.length),
    )
    points, specials = _insert_events(task, points, events)
    if termination is not None:
        specials.append(termination.special._replace(row=len(points.z) - 1))
    points, specials, stop_end = _truncate_at_stop(task, points, specials)
    diagnostics = _diagnose(detector, points.z, info, diagnostics) if events or stop_end else diagnostics
    value = float(points.z[-1, param_index])
    return BranchSegment(
        task.args, points, diagnostics, tuple(specials), stop_end or end, param_index, value
    ), None if stop_end else retry_step


def _diagnose(detector, zs, known_zs, known_diagnostics):
    """Compute diagnostics of points; those of known points are reused, because they depend on the point alone."""
    if known_diagnostics is None:
        return None
    row_of_bytes = {z.tobytes(): k for k, z in enumerate(known_zs)}
    known_rows = np.array([row_of_bytes.get(z.tobytes(), -1) for z in zs])
    if (known_rows >= 0).all():
        return map_fields(lambda leaf: leaf[known_rows], known_diagnostics)
    is_new = known_rows < 0

    def fill_leaf(leaf, new_values):
        values = leaf[known_rows]
        values[is_new] = new_values
        return values

    return map_fields(fill_leaf, known_diagnostics, detector.diagnose(zs[is_new]))


def _truncate_at_bounds(task, points, end):
    """Truncate points at the first bound; returns them, the end and the index in z of the parameter to report."""
    param_index = -1
    for index in range(-len(task.bounds), 0):  # one step may cross several bounds
        lower, upper = task.bounds[index]
        outside = (points.z[:, index] < lower) | (points.z[:, index] > upper)
        outside[0] = False
        if outside.any():
            last_row = int(np.argmax(outside))
            value = lower if points.z[last_row, index] < lower else upper
            points, is_located = truncate_at_value(task, points, last_row, index, value)
            domain_ends = task.domain_ends[index] if task.domain_ends else ()
            end, param_index = (End.DOMAIN if value in domain_ends else End.BOUND) if is_located else End.STEP, index
    return points, end, param_index


def _is_outside(task, z):
    """Return True if a parameter is out of bounds."""
    return any(
        not lower <= z[index] <= upper
        for index, (lower, upper) in zip(range(-len(task.bounds), 0), task.bounds, strict=True)
    )


def _retry(step, control):
    """Return (end, step to retry with) after a failed step."""
    smaller_step = RETRY_FACTOR * float(step)
    return (End.STEP, None) if smaller_step < control.min_step else (None, smaller_step)


def _insert_events(task, points, events):
    """Insert the points of events; returns the points and the `SpecialIndex` list."""
    specials, offsets = [], {}
    for shift, (kind, row, length, z, residual) in enumerate(events):
        point = point_from_z(task, points, row + shift, z)
        if kind == "BP":
            incoming = points.tangent[row + shift]
            point = point._replace(tangent=continued_tangent(task.problem, z, task.control.scale, task.args, incoming))
        points = insert_row(points, row + shift + 1, point._replace(step=np.float64(length - offsets.get(row, 0.0))))
        offsets[row] = length
        specials.append(SpecialIndex(row + shift + 1, kind, residual))
    return points, specials


def _truncate_at_stop(task, points, specials):
    """Truncate at the first special point that ends the branch; return points, special points, `End` or None."""
    for special in sorted(specials, key=lambda special: special.row):
        stop_end = task.detector.end_at_special_point(points.z[special.row], special.kind)
        stop_end = stop_end or (End.STOPPED if special.kind in task.stop else None)
        if stop_end:
            return head(points, special.row + 1), [other for other in specials if other.row <= special.row], stop_end
    return points, specials, None
