"""The one loop along a branch, be it in one parameter or in two: chunks of steps, each cut where something ends it,
with its special points put in, until the branch ends.

What is watched besides the equations is a `EventDetector`; its methods are asked in this order: `view`, `good`, `look`,
`good` where that puts points in, `passed`, `before`, `touch`, `comes_back`, `events`, `stops`."""

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

POINT_LIMIT = 20_000  # points of a branch
RETRY_FACTOR = 0.25  # times the step that came to no point of the branch, to try again
FIRST_CHUNK = 4  # steps of a chunk before its points are first checked: those beyond the first bad point are of no use


class End(Enum):
    """Why a branch ends: the text is a sentence about the parameter `name` at `value`, and the special point `kind`."""

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


ENDS = {RUNNING: None, OUTSIDE: End.BOUND, arclength.UNDERFLOW: End.STEP, arclength.NONFINITE: End.NUMBER}  # of a chunk


class Termination(NamedTuple):
    """What a `EventDetector` says of an end. points: up to it; special: the special point there, its place left open;
    end."""

    points: Point
    special: SpecialIndex
    end: Enum


class EventDetector:
    """What is known of points besides that they solve the equations, and what ends a branch: here nothing."""

    def refine_points(self, task, points, diagnostics):
        """(the points, with more where something may have been missed between two; what is known of each, as rows).
        diagnostics: what is known of the points given."""
        return points, diagnostics

    def diagnose(self, zs):
        """What is known of the points zs, a pytree of arrays with a row a point."""
        return None

    def is_admissible(self, zs, diagnostics):
        """Which points are solutions that are wanted, (points,)."""
        return np.ones(len(zs), bool)

    def is_past_singularity(self, points):
        """Which points lie beyond a place where the equations are singular though nothing branches there, the point
        before on this side of it, (points,)."""
        return np.zeros(len(points.z), bool)

    def find_early_end(self, task, points):
        """`Termination` where an end is near that is to be seen before a point is bad, else None."""
        return None

    def find_boundary_end(self, task, points, diagnostics, first_bad):
        """`Termination` at the last good point before the first bad one, None where it is not found."""
        return None

    def find_events(self, task, points, diagnostics, branch_points, termination):
        """The `event_search.Event`s between points; branch_points: branch points found already; termination:
        `Termination` at the last, or None."""
        values = event_search.test_function_values(task.problem, points, task.args)
        return event_search.locate_events(task.problem, points, values, task.control, task.args, branch_points)

    def equivalent_points(self, z, near_z):
        """The points near one that are the same solution as z."""
        return [z]

    def find_closure(self, task, points):
        """(place, length) where the branch comes back to one of the starts, None where it does not."""
        targets = [image for start in task.starts for image in self.equivalent_points(start, points.z[0])]
        return event_search.find_pass(task.problem, points, targets, task.control, task.args) if targets else None

    def end_at_special_point(self, z, kind):
        """An `End` where a special point ends the branch whatever is asked for, else None."""
        return None


class ContinuationTask(NamedTuple):
    """A branch to be followed. problem, args: its equations; control: of steps; first_step: the first; bounds: (low,
    high) of each parameter, the last one's as in the control; domain_ends: ends of these that are none of the bounds
    asked for; watch; stop: kinds of special points that end it; starts: solutions that end it when it comes back to
    them; limits: of its points and of the time."""

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
    """The `BranchSegment` from a `Point`, whose tangent leads away."""
    segments, state = [], _start_state(start, task.first_step)
    while state is not None:
        for points, info, status in _generate_chunks(task, state, _count_points(segments)):
            state = _add_segment(task, segments, points, info, status)
            if segments[-1].end is not None or state is not None:
                break
    return join_segments(segments)


class PointInfo(NamedTuple):
    """Points that are known. z: the points; diagnostics: what a `EventDetector` knows of each; admissible: which are
    wanted."""

    z: Any
    diagnostics: Any
    admissible: Any


def _point_info(detector, zs):
    diagnostics = detector.diagnose(zs)
    return PointInfo(zs, diagnostics, np.array(detector.is_admissible(zs, diagnostics)))


def _generate_chunks(task, state, n_points):
    """Yields (points, `PointInfo` of them, status) of chunks of steps, each checked after a few steps and ended early
    behind its first bad point, and where a limit is reached. n_points: of the points before."""
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
    """The `BranchSegment` of each of some tasks, those of one problem and size as the lanes of one compiled call."""
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
    """Put the `BranchSegment` of a chunk of steps to those before it; the `TrackState` to go on from with a smaller
    step, None where the steps are good."""
    segment, retry_step = _make_segment(task, points, info, status)
    n_points = _count_points([*segments, segment])
    if segment.end is None and n_points > POINT_LIMIT:
        segment = segment._replace(end=End.POINTS)
    segment = _apply_limits(task.limits, segment, n_points)
    segments.append(segment)
    task.limits.report(_count_points(segments))
    if not any(is_slow(segment) for segment in segments[:-1]):  # once for a branch
        warn_if_slow(task.control, segment)
    return _start_state(row_at(segment.points, -1), retry_step) if segment.end is None and retry_step else None


def _count_points(segments):
    """The number of points of `BranchSegment`es in a row."""
    return 1 + sum(len(segment.points.z) - 1 for segment in segments)


def _apply_limits(limits, segment, n_points):
    """The `BranchSegment` up to where a limit is reached; n_points: of all points up to its end."""
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
    """(the `BranchSegment` of a chunk of steps; the step to go on with from its last point, where a longer one came to
    no point of the branch, else None). info: `PointInfo` of the points."""
    detector, retry_step = task.detector, None
    points, end, param_index = _truncate_at_bounds(
        task, points, ENDS[status]
    )  # first, as what comes after a bound is not to be seen
    points, diagnostics = detector.refine_points(task, points, _diagnose(detector, points.z, info.z, info.diagnostics))
    admissible = info.admissible if np.array_equal(points.z, info.z) else detector.is_admissible(points.z, diagnostics)
    admissible[0] = True
    n_points, first_bad, info = len(points.z), int(np.argmin(np.append(admissible, False))), points.z
    expired = task.limits.expired  # what ends the branch there, and whether it jumped, may take long to find
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
            end = End.MAX_SECONDS if task.limits.expired else end  # the search may have been given up
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
    """What a watch knows of points, some of which it has seen known_zs: a view of a point depends on that alone."""
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
    """(the points up to where the first bound is met, why they end, the place of the parameter in z that is to be
    told)."""
    param_index = -1
    for index in range(-len(task.bounds), 0):  # one step may cross several: each cuts what the one before has left
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
    """Whether a parameter is beyond a bound."""
    return any(
        not lower <= z[index] <= upper
        for index, (lower, upper) in zip(range(-len(task.bounds), 0), task.bounds, strict=True)
    )


def _retry(step, control):
    """(the end, the step to try) where a step came to no point of the branch."""
    smaller_step = RETRY_FACTOR * float(step)
    return (End.STEP, None) if smaller_step < control.min_step else (None, smaller_step)


def _insert_events(task, points, events):
    """(the points with those of the events among them, the `SpecialIndex`s)."""
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
    """(the points up to the first special point that ends the branch, the marks up to it, the `End` or None)."""
    for special in sorted(specials, key=lambda special: special.row):
        stop_end = task.detector.end_at_special_point(points.z[special.row], special.kind)
        stop_end = stop_end or (End.STOPPED if special.kind in task.stop else None)
        if stop_end:
            return head(points, special.row + 1), [other for other in specials if other.row <= special.row], stop_end
    return points, specials, None
