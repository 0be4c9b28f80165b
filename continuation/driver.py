"""The one loop along a branch, be it in one parameter or in two: chunks of steps, each cut where something ends it,
with its special points put in, until the branch ends.

What is watched besides the equations is a `Watch`; its methods are asked in this order: `view`, `good`, `look`, `good`
where that puts points in, `passed`, `before`, `touch`, `comes_back`, `events`, `stops`.
"""

from enum import Enum
from typing import Any, NamedTuple

import numpy as np

from . import arclength, event_search
from .arclength import ON, OUT, Control, Place, Point
from .branch_switching import through
from .limits import UNLIMITED, Limits
from .points import cut_at, pointed, to_value
from .problem import Problem
from .rows import at, by_field, joined, put, upto
from .slow_progress import is_slow, warn_if_slow
from .stretch import Mark, Stretch, glued

MOST = 20_000  # points of a branch
SMALLER = 0.25  # times the step that came to no point of the branch, to try again
FEW = 4  # steps of a chunk before its points are first checked: those beyond the first bad point are of no use


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


ENDS = {ON: None, OUT: End.BOUND, arclength.UNDERFLOW: End.STEP, arclength.NONFINITE: End.NUMBER}  # of a chunk


class Met(NamedTuple):
    """What a `Watch` says of an end. points: up to it; mark: the special point there, its place left open; end."""

    points: Point
    mark: Mark
    end: Enum


class Watch:
    """What is known of points besides that they solve the equations, and what ends a branch: here nothing."""

    def look(self, task, points, view):
        """(the points, with more where something may have been missed between two; what is known of each, as rows).
        view: what is known of the points given."""
        return points, view

    def view(self, zs):
        """What is known of the points zs, a pytree of arrays with a row a point."""
        return None

    def good(self, zs, view):
        """Which points are solutions that are wanted, (points,)."""
        return np.ones(len(zs), bool)

    def passed(self, points):
        """Which points lie beyond a place where the equations are singular though nothing branches there, the point
        before on this side of it, (points,)."""
        return np.zeros(len(points.z), bool)

    def before(self, task, points):
        """`Met` where an end is near that is to be seen before a point is bad, else None."""
        return None

    def touch(self, task, points, view, bad):
        """`Met` at the last good point before the first bad one, None where it is not found."""
        return None

    def events(self, task, points, view, known, end):
        """The `event_search.Event`s between points; known: branch points found already; end: `Met` at the last, or
        None."""
        values = event_search.watched(task.problem, points, task.args)
        return event_search.events(task.problem, points, values, task.control, task.args, known)

    def images(self, z, near):
        """The points near one that are the same solution as z."""
        return [z]

    def comes_back(self, task, points):
        """(place, length) where the branch comes back to one of the starts, None where it does not."""
        marks = [each for z in task.starts for each in self.images(z, points.z[0])]
        return event_search.passes_mark(task.problem, points, marks, task.control, task.args) if marks else None

    def stops(self, z, kind):
        """An `End` where a special point ends the branch whatever is asked for, else None."""
        return None


class Task(NamedTuple):
    """A branch to be followed. problem, args: its equations; control: of steps; first: the first; box: (low, high) of
    each parameter, the last one's as in the control; domain: ends of these that are none of the bounds asked for;
    watch; stop: kinds of special points that end it; starts: solutions that end it when it comes back to them; limits:
    of its points and of the time."""

    problem: Problem
    args: Any
    control: Control
    first: float
    box: tuple[tuple[float, float], ...]
    domain: tuple[tuple[float, ...], ...] = ()
    watch: Watch = Watch()
    stop: tuple[str, ...] = ()
    starts: tuple[Any, ...] = ()
    limits: Limits = UNLIMITED


def run(task, start):
    """The `Stretch` from a `Point`, whose tangent leads away."""
    parts, place = [], _place(start, task.first)
    while place is not None:
        for points, seen, status in _chunks(task, place, _count(parts)):
            place = _add(task, parts, points, seen, status)
            if parts[-1].end is not None or place is not None:
                break
    return glued(parts)


class Seen(NamedTuple):
    """Points that are known. z: the points; view: what a `Watch` knows of each; good: which are wanted."""

    z: Any
    view: Any
    good: Any


def _seen(watch, zs):
    view = watch.view(zs)
    return Seen(zs, view, np.array(watch.good(zs, view)))


def _chunks(task, place, count):
    """Yields (points, `Seen` of them, status) of chunks of steps, each checked after a few steps and ended early behind
    its first bad point, and where a limit is reached. count: of the points before."""
    chunk = None
    for points, status in event_search.stretches(task.problem, place, task.control, task.args, FEW):
        if chunk is None:
            chunk, seen = points, _seen(task.watch, points.z)
            seen.good[0] = True
        elif len(points.z) > 1:
            new = _seen(task.watch, points.z[1:])
            view = by_field(lambda *leaves: np.concatenate(leaves), seen.view, new.view)
            chunk = joined([chunk, points])
            seen = Seen(chunk.z, view, np.concatenate([seen.good, new.good]))
        ends = status != ON or len(chunk.z) > event_search.CHUNK or not seen.good.all()
        if ends or task.limits.reached(count + len(chunk.z) - 1):
            yield chunk, seen, status
            count, chunk = count + len(chunk.z) - 1, None


def run_together(tasks, starts):
    """The `Stretch` of each of some tasks, those of one problem and size as the lanes of one compiled call."""
    groups, found = {}, {}
    for k, (task, start) in enumerate(zip(tasks, starts, strict=True)):
        groups.setdefault((task.problem, len(start.z)), []).append(k)
    for (problem, _), lanes in groups.items():
        some = _side_by_side(problem, [tasks[k] for k in lanes], [starts[k] for k in lanes])
        found |= zip(lanes, some, strict=True)
    return [found[k] for k in range(len(tasks))]


def _side_by_side(problem, tasks, starts):
    parts = [[] for _ in tasks]

    def goes_on(lane, points, status):
        place = _add(tasks[lane], parts[lane], points, _seen(tasks[lane].watch, points.z), status)
        return None if parts[lane][-1].end is not None else place or True

    places = [_place(start, task.first) for task, start in zip(tasks, starts, strict=True)]
    event_search.together(problem, places, [one.control for one in tasks], [one.args for one in tasks], goes_on)
    return [glued(each) for each in parts]


def _place(start, first):
    return Place(start.z, start.tangent, np.float64(first), np.int32(ON))


def _add(task, parts, points, seen, status):
    """Put the `Stretch` of a chunk of steps to those before it; the `Place` to go on from with a smaller step, None
    where the steps are good."""
    one, again = _part(task, points, seen, status)
    count = _count([*parts, one])
    if one.end is None and count > MOST:
        one = one._replace(end=End.POINTS)
    one = _limited(task.limits, one, count)
    parts.append(one)
    task.limits.report(_count(parts))
    if not any(is_slow(each) for each in parts[:-1]):  # once for a branch
        warn_if_slow(task.control, one)
    return _place(at(one.points, -1), again) if one.end is None and again else None


def _count(parts):
    """The number of points of `Stretch`es in a row."""
    return 1 + sum(len(each.points.z) - 1 for each in parts)


def _limited(limits, one, count):
    """The `Stretch` up to where a limit is reached; count: of all points up to its end."""
    over = 0 if limits.room is None else count - max(limits.room, 1)
    if over > 0 or (over == 0 and limits.room is not None and one.end is None):
        size = max(len(one.points.z) - over, 1)
        marks = tuple(each for each in one.marks if each.place < size)
        points, view = upto(one.points, size), upto(one.view, size)
        return Stretch(one.args, points, view, marks, End.MAX_POINTS, -1, float(points.z[-1, -1]))
    if one.end is None and limits.expired:
        return one._replace(end=End.MAX_SECONDS)
    return one


def _part(task, points, seen, status):
    """(the `Stretch` of a chunk of steps; the step to go on with from its last point, where a longer one came to no
    point of the branch, else None). seen: `Seen` of the points."""
    watch, again = task.watch, None
    points, end, which = _within(task, points, ENDS[status])  # first, as what comes after a bound is not to be seen
    points, view = watch.look(task, points, _viewed(watch, points.z, seen.z, seen.view))
    good = seen.good if np.array_equal(points.z, seen.z) else watch.good(points.z, view)
    good[0] = True
    size, bad, seen = len(points.z), int(np.argmin(np.append(good, False))), points.z
    late = task.limits.expired  # what ends the branch there, and whether it jumped, may take long to find
    over = late and bad < size
    points, end = (upto(points, bad), End.MAX_SECONDS) if over else (points, end)
    tried = upto(points, bad + 1)
    jump, known = event_search.jump(task.problem, tried, task.control, task.args, watch.passed(tried) | late)
    met = None if over else watch.before(task, upto(points, bad if jump is None else jump))
    met = None if met is not None and _is_outside(task, met.points.z[-1]) else met
    if met is None and jump is not None:
        points, (end, again) = upto(points, jump), _retried(points.step[jump], task.control)
    elif met is None and bad < size and not over:
        met, step = watch.touch(task, points, view, bad), points.step[bad]
        if met is None:
            points, (end, again) = upto(points, bad), _retried(step, task.control)
            end = End.MAX_SECONDS if task.limits.expired else end  # the search may have been given up
    if met is not None:
        points, end = met.points, met.end
    loop = watch.comes_back(task, points)
    if loop is not None:
        points, met, end, again = cut_at(task, points, *loop), None, End.CLOSED, None
    if len(points.z) != size or met is not None or loop is not None:
        seen, view = points.z, _viewed(watch, points.z, seen, view)
    events = sorted(watch.events(task, points, view, known, met), key=lambda one: (one.after, one.length))
    points, marks = _inserted(task, points, events)
    if met is not None:
        marks.append(met.mark._replace(place=len(points.z) - 1))
    points, marks, halt = _stopped(task, points, marks)
    view = _viewed(watch, points.z, seen, view) if events or halt else view
    value = float(points.z[-1, which])
    return Stretch(task.args, points, view, tuple(marks), halt or end, which, value), None if halt else again


def _viewed(watch, zs, before, view):
    """What a watch knows of points, some of which it has seen before: a view of a point depends on that alone."""
    if view is None:
        return None
    places = {z.tobytes(): k for k, z in enumerate(before)}
    known = np.array([places.get(z.tobytes(), -1) for z in zs])
    if (known >= 0).all():
        return by_field(lambda leaf: leaf[known], view)
    new = known < 0

    def filled(leaf, more):
        found = leaf[known]
        found[new] = more
        return found

    return by_field(filled, view, watch.view(zs[new]))


def _within(task, points, end):
    """(the points up to where the first bound is met, why they end, the place of the parameter in z that is to be
    told)."""
    which = -1
    for k in range(-len(task.box), 0):  # one step may cross several: each cuts what the one before has left
        low, high = task.box[k]
        outside = (points.z[:, k] < low) | (points.z[:, k] > high)
        outside[0] = False
        if outside.any():
            last = int(np.argmax(outside))
            value = low if points.z[last, k] < low else high
            points, there = to_value(task, points, last, k, value)
            domain = task.domain[k] if task.domain else ()
            end, which = (End.DOMAIN if value in domain else End.BOUND) if there else End.STEP, k
    return points, end, which


def _is_outside(task, z):
    """Whether a parameter is beyond a bound."""
    return any(not low <= z[k] <= high for k, (low, high) in zip(range(-len(task.box), 0), task.box, strict=True))


def _retried(step, control):
    """(the end, the step to try) where a step came to no point of the branch."""
    again = SMALLER * float(step)
    return (End.STEP, None) if again < control.smallest else (None, again)


def _inserted(task, points, events):
    """(the points with those of the events among them, the `Mark`s)."""
    placed, done = [], {}
    for shift, (kind, after, length, z, residual) in enumerate(events):
        one = pointed(task, points, after + shift, z)
        if kind == "BP":
            before = points.tangent[after + shift]
            one = one._replace(tangent=through(task.problem, z, task.control.scale, task.args, before))
        points = put(points, after + shift + 1, one._replace(step=np.float64(length - done.get(after, 0.0))))
        done[after] = length
        placed.append(Mark(after + shift + 1, kind, residual))
    return points, placed


def _stopped(task, points, marks):
    """(the points up to the first special point that ends the branch, the marks up to it, the `End` or None)."""
    for one in sorted(marks, key=lambda one: one.place):
        halt = task.watch.stops(points.z[one.place], one.kind)
        halt = halt or (End.STOPPED if one.kind in task.stop else None)
        if halt:
            return upto(points, one.place + 1), [each for each in marks if each.place <= one.place], halt
    return points, marks, None
