"""A branch from its start on: chunks of steps, the events in them located, and what ends it."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from . import arclength, locate
from .arclength import ON, OUT, Place, Point
from .persistent_jit import persistent_jit
from .rows import at, by_field

CHUNK = 128  # steps attempted in a compiled call
POLISHED = 1e-10  # a length: from a step as short the next leaves rounding alone
LOST = 1e-13  # of the largest determinant: as small is rounding
FINE = 1e-4  # a length: a step as short is no jump to another branch
HALVINGS, TRIED = 25, 6  # of an interval with a change of sign; after every so many Newton's method is tried
SAME = 1e-6  # of the scaled lengths: two points as near are one
REACH = 10.0  # of the way to the point beyond an event: so far Newton's method may come from its guess
BEGUN = 1e-8  # of the scaled lengths: a special point as near to a start is the start


class Event(NamedTuple):
    """A special point. kind: "SN", "BP" or a test's label; after: the place of the point before it; length: from that
    to it along the tangent; z; residual: the largest error left in its equations."""

    kind: str
    after: int
    length: float
    z: Float[np.ndarray, " unknowns"]
    residual: float


def tangent(problem, z, scale, args, along=None):
    """The unit tangent at a regular point: towards greater parameters, or as near as can be to a direction."""
    slopes = np.asarray(locate.evaluated(problem, z, args)[1])
    return oriented(slopes, scale, along)


def oriented(slopes, scale, along=None):
    """The unit null vector of an (n, n + 1) matrix; columns of scale 0 left out."""
    used = scale > 0
    filled = np.zeros(len(scale))
    filled[used] = np.linalg.svd(slopes[:, used])[2][-1]
    if along is None:
        along = np.zeros(len(scale))
        along[-1] = 1.0
    sign = np.sign(np.sum(scale * scale * filled * along)) or 1.0
    return sign * filled / np.linalg.norm(scale * filled)


def _tracked(problem, place, control, args, count, most):
    return arclength.track(problem.function, problem.solve, place, control, args, count, most)


@persistent_jit(static_argnums=(0, 4), numpy_first=_tracked)
def _track(problem, place, control, args, count, most):
    return problem.run(_track_as_run, place, control, args, most, problem=problem, count=count)


def _track_as_run(place, control, args, most, problem, count):
    return _tracked(problem, place, control, args, count, most)


def step(problem, point, length, control, args):
    """The branch's `Point` a length away along the tangent of one: `met` says whether Newton's method came there."""
    place = Place(point.z, point.tangent, np.float64(length), np.int32(ON))
    return at(_track(problem, place, control, args, CHUNK, np.int32(1))[1], 0)


def pinned(problem, z, index, value, control, args):
    """The `Point` near z with a value in one of its places, to rounding: `met` says whether there is one."""
    row = np.zeros(len(z))
    row[index] = 1.0 / control.scale[index] ** 2
    place = np.array(z)
    place[index] = value
    return step(
        problem, Point(place, row, *[np.zeros(())] * 3, *[np.True_] * 2), 0.0, polishing(problem, control), args
    )


def polishing(problem, control):
    """The `Control` with which Newton's method ends at rounding, or at the noise of the equations."""
    return control._replace(tolerance=np.float64(max(POLISHED, problem.noise)))


def stretches(problem, place, control, args, first=CHUNK):
    """Yields (`arclength.Point` of arrays, status of `arclength`): points in a row, the first being the last before.

    place: where it starts; first: the number of steps attempted before the first points are yielded, which doubles each
    time up to `CHUNK`. It ends when the status is not ON.
    """
    start, most = _first(problem, place, control, args), first
    while True:
        place, points = _track(problem, place, control, args, CHUNK, np.int32(most))
        kept, most = _kept(start, points), min(2 * most, CHUNK)
        yield kept, int(place.status)
        if place.status != ON:
            return
        start = at(kept, -1)


def together(problem, places, controls, args, goes_on):
    """`stretches` of many branches, the lanes of one compiled call a chunk.

    places, controls, args: lists, one of each a lane, alike in their shapes; goes_on: takes a lane's number and what
    `stretches` yields, and says whether the lane is to go on, or the `Place` to go on from. The lanes are filled up to
    a power of two.
    """
    starts = [_first(problem, *each) for each in zip(places, controls, args, strict=True)]
    more = (1 << (len(places) - 1).bit_length()) - len(places)
    idle = [places[-1]._replace(status=np.int32(OUT))] * more
    places = jax.tree.map(lambda *each: np.stack(each), *places, *idle)
    controls, args = (jax.tree.map(lambda *e: np.stack(e), *each, *each[-1:] * more) for each in (controls, args))
    while (places.status == ON).any():
        lanes = np.flatnonzero(places.status == ON)
        places, points = _track_lanes(problem, places, controls, args, CHUNK)
        status = np.array(places.status)
        for lane in lanes:
            kept = _kept(starts[lane], jax.tree.map(lambda leaf, lane=lane: leaf[lane], points))
            starts[lane] = at(kept, -1)
            onwards = goes_on(int(lane), kept, int(status[lane]))
            if isinstance(onwards, Place):
                places = jax.tree.map(lambda leaf, new, lane=lane: _with(leaf, lane, new), places, onwards)
                starts[lane], status[lane] = _first(problem, onwards, *_of_lane(controls, args, lane)), ON
            elif not onwards:
                status[lane] = OUT
        places = places._replace(status=status)


def _with(leaf, lane, new):
    leaf = np.array(leaf)
    leaf[lane] = new
    return leaf


def _of_lane(controls, args, lane):
    return jax.tree.map(lambda leaf: leaf[lane], (controls, args))


@persistent_jit(static_argnums=(0, 4), numpy_first=True)
def _track_lanes(problem, places, controls, args, count):
    def one(*lane):
        return arclength.track(problem.function, problem.solve, *lane, count)

    return jax.vmap(one)(places, controls, args)


def _first(problem, place, control, args):
    """The `Point` at the start of a branch."""
    zero = np.zeros_like(place.step)
    start = step(problem, Point(place.z, place.tangent, *[zero] * 3, *[np.True_] * 2), 0.0, control, args)
    return start._replace(z=place.z, tangent=place.tangent, step=zero, kept=np.True_)


def _kept(start, points):
    """A start and the points of a chunk that were kept, in a row."""
    return by_field(lambda first, leaf: np.concatenate([np.asarray(first)[None], leaf[points.kept]]), start, points)


@persistent_jit(static_argnums=(0, 1), numpy_first=True)
def _values(problem, test, zs, args):
    return jax.vmap(lambda z: jnp.linalg.det(test.matrix(z, args)))(zs)


def watched(problem, points, args):
    """{label: determinant at each point} of a problem's tests."""
    rows = -(-len(points.z) // (CHUNK + 1)) * (CHUNK + 1)
    padded = np.concatenate([points.z, np.repeat(points.z[-1:], rows - len(points.z), axis=0)])
    return {test.label: np.asarray(_values(problem, test, padded, args))[: len(points.z)] for test in problem.tests}


def events(problem, points, values, control, args, known=None):
    """The `Event`s between points in a row, in order; values: {label: of the problem's tests at each point}; known: of
    `jump`, the branch points between these and more points.

    One at the first point is left out: it belongs to the points before, or the branch was begun in it.
    """
    found, watched = [], {"BP": points.determinant, "SN": points.tangent[:, -1]} | values
    for kind, each in watched.items():
        signs = _signs(each)
        for after in np.flatnonzero(signs[:-1] * signs[1:] < 0):
            crossed = kind == "SN" and any(one.after == after for one in found)  # it may turn there, without a fold
            event = (known or {}).get(int(after)) if kind == "BP" else None
            if event is None:
                event = _located(problem, kind, points, int(after), each, control, args, 1 if crossed else HALVINGS)
            if event is not None and np.linalg.norm(control.scale * (event.z - points.z[0])) > BEGUN:
                found.append(event)
    return _told_apart(found, control)


def jump(problem, points, control, args, passed=None):
    """(the place of the first point that lies on another branch than the one before it, None where none does; the
    branch points up to there, {place of the point before: `Event`}).

    At a jump the determinant has another sign, and no branch point is between the two. passed: (points,), the points
    before which that is known, None where it is of none: these are taken for jumps.
    """
    signs, found = _signs(points.determinant), {}
    for after in np.flatnonzero((signs[:-1] * signs[1:] < 0) & (points.step[1:] > FINE)):
        event = None
        if passed is None or not passed[after + 1]:
            event = _located(problem, "BP", points, int(after), points.determinant, control, args)
        if event is None:
            return int(after) + 1, found
        found[int(after)] = event
    return None, found


def _signs(values):
    """The sign of each; a zero has that of the one before, so that the change is after it; none is at the start."""
    signs = np.where(abs(values) <= LOST * abs(values).max(), 0.0, np.sign(values))
    for k in np.flatnonzero(signs == 0):
        signs[k] = signs[k - 1] if k else next((sign for sign in signs if sign), 0.0)
    return signs


def _located(problem, kind, points, after, values, control, args, halvings=HALVINGS):
    """The event between two points, None where Newton's method leads to none there."""
    here = at(points, after)
    low, high = 0.0, float(points.step[after + 1])
    guess = high * values[after] / (values[after] - values[after + 1])
    for halving in range(halvings):
        near = step(problem, here, guess, control, args)
        if halving % TRIED == 0:
            event = _event(problem, kind, here, after, (low, high), near, guess, control, args)
            if event is not None:
                return event
        if near.met and _signed(problem, kind, here, args) * _signed(problem, kind, near, args) > 0:
            low = guess
        else:
            high = guess
        guess = 0.5 * (low + high)
    return None


def _event(problem, kind, here, after, between, near, guess, control, args):
    """The event to which Newton's method leads from a guess, None where that is not between two lengths."""
    low, high = between
    z = near.z if near.met else here.z + guess * here.tangent
    with np.errstate(divide="ignore"):  # what has no weight may come as far as it likes
        reach = REACH * high / control.scale
    found = _polished(problem, kind, z, args, reach)
    if found.z is None:
        return None
    along = float(np.sum(control.scale**2 * here.tangent * (found.z - here.z)))
    spare = 0.05 * (high - low)
    if not low - spare <= along <= high + spare:
        return None
    return Event(kind, after, min(max(along, low), high), found.z, found.residual)


def _signed(problem, kind, point, args):
    """What changes its sign where there is an event of a kind."""
    if kind in ("SN", "BP"):
        return np.sign(point.tangent[-1] if kind == "SN" else point.determinant)
    (test,) = (test for test in problem.tests if test.label == kind)
    return np.linalg.slogdet(locate.matrices(problem, test, point.z, args)[0])[0]


def _polished(problem, kind, z, args, reach):
    """The event to which Newton's method leads: `locate.Located`, without a z where it is none."""
    if kind == "SN":
        found = locate.fold(problem, z, args, reach)
    elif kind == "BP":
        found = locate.branch_point(problem, z, args, reach)
    else:
        found = _tested(problem, kind, z, args, reach)
    return found if found.z is None or problem.holds(found.z, args) else locate.Located(None, np.nan)


def _tested(problem, kind, z, args, reach):
    (test,) = (test for test in problem.tests if test.label == kind)
    found = locate.singular(problem, test, z, args, reach)
    if found.z is None or test.holds(found.z, args):
        return found
    return locate.Located(None, np.nan)


def _told_apart(found, control):
    """Events in order. Where a branch is crossed at its own turning point, both a fold and a branch point are seen: it
    is a branch point."""
    crossings = [one for one in found if one.kind == "BP"]
    kept = [
        one
        for one in found
        if one.kind != "SN" or not any(np.linalg.norm(control.scale * (one.z - two.z)) < SAME for two in crossings)
    ]
    return sorted(kept, key=lambda one: (one.after, one.length))


def meets(points, marks, control):
    """(place of the point before, length from it, which mark) of each of some marks, points in z, that a row of points
    passes near enough to be on the same branch; confirm with `step`."""
    found = []
    square = control.scale**2
    for k, mark in enumerate(marks):
        apart = mark - points.z[:-1]
        along = np.einsum("ik,ik->i", apart, square * points.tangent[:-1])
        aside = np.linalg.norm(control.scale * (apart - along[:, None] * points.tangent[:-1]), axis=1)
        size = points.step[1:]
        ahead = along > 0
        if points.step[0] == 0:  # the first point begins the branch: a mark a rounding away is that very point
            ahead[:1] = along[:1] > BEGUN
        for after in np.flatnonzero(ahead & (along <= size) & (aside < 0.5 * size)):
            found.append((int(after), float(along[after]), k))
    return sorted(found)


def passes_mark(problem, points, marks, control, args):
    """(place of the point before, length from it) where a row of points first passes through one of some marks."""
    for after, length, k in meets(points, marks, control):
        here = at(points, after)
        there = step(problem, here, length, control, args)
        if there.met and np.linalg.norm(control.scale * (there.z - marks[k])) < SAME:
            return after, length
    return None
