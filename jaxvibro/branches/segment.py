"""A piece of a branch: orbits of one itinerary, from a start to the first grazing, bound or other end."""

from typing import NamedTuple

import numpy as np

from continuation import arclength, follow
from continuation.arclength import ON, OUT, Control, Place, Point
from continuation.locate import Located

from ..problem import soft_grazing
from ..problem.diagnostics import Look, looked
from ..problem.end import End
from ..problem.equations import Along, problem
from ..problem.missed_touches import with_dips
from ..problem.points import at, between, joined, put, upto
from ..problem.same_orbit import images, is_repeated
from ..problem.touches import TOUCH, Touch, admissible, is_pressed, stilled, touched
from .user_monitors import crossings

MOST = 20_000  # points of a piece
SMALLER = 0.25  # times the step that came to no point of the branch, to try again
HALVES = 60  # of an interval in which a grazing is looked for
ENDS = {ON: None, OUT: End.BOUND, arclength.UNDERFLOW: End.STEP, arclength.NONFINITE: End.NUMBER}  # of some steps


class Asked(NamedTuple):
    """What a branch is asked for. control: of steps; first: the first; domain: (low, high), the parameter's by its
    meaning; monitors: {label: function of a `MonitoredPoint`}; stop: labels; length: the scene's; marks: (`Cycle`,
    parameter) of orbits that end the branch when it meets them."""

    control: Control
    first: float
    domain: tuple[float, float]
    monitors: dict
    stop: tuple[str, ...]
    length: float
    marks: tuple


class Mark(NamedTuple):
    """A special point among those of a piece: its place there, kind, the largest error left; at a GR or CH its touches
    and exits, whether those are all, and which the branch leaves aside."""

    place: int
    kind: str
    residual: float
    touches: tuple[Touch, ...] = ()
    exits: tuple = ()
    sure: bool = True
    aside: tuple[bool, ...] = ()


class Piece(NamedTuple):
    """along: its orbits; points, look: a row a point; marks: in order; why: its `End`."""

    along: Along
    points: Point
    look: Look
    marks: tuple[Mark, ...]
    why: End


def piece(along, start, asked):
    """The `Piece` that begins at a `Point`."""
    place = Place(start.z, start.tangent, np.float64(asked.first), np.int32(ON))
    parts = []
    while place is not None:
        place = _gone_on(along, place, asked, parts)
    return _joined(along, parts)


def _gone_on(along, place, asked, parts):
    """The `Place` to go on from with a smaller step, None at an end; what is met from a place on is added to parts."""
    for points, status in follow.stretches(problem(along), place, asked.control, along):
        part = _part(along, points, status, asked)
        parts.append(part)
        if part.why is not None or sum(len(one.points.z) for one in parts) > MOST:
            return None
        if part.again:
            last = at(part.points, -1)
            return Place(last.z, last.tangent, np.float64(part.again), np.int32(ON))
    return None


class _Part(NamedTuple):
    """Of a `Piece`; again: the step to go on with from its end, where a longer one came to no point of the branch."""

    points: Point
    look: Look
    marks: tuple
    why: End | None
    again: float | None


def _part(along, points, status, asked):
    """What a chunk of steps gives, cut at its end, with its special points put in."""
    control = asked.control
    why, last, again = ENDS[status], [], None
    if status == OUT:  # first, as what comes after the bound is not to be seen
        points, why = _to_bound(along, points, asked)
    points, look = with_dips(along, points, looked(along, points.z), control)
    good = admissible(along, points.z, look)
    good[0] = True
    size, bad = len(points.z), int(np.argmin(np.append(good, False)))
    jump, known = follow.jump(problem(along), upto(points, bad + 1), control, along)
    brushed, last = _to_brush(along, upto(points, bad if jump is None else jump), asked)
    if last:
        points, why = brushed, End.GRAZE
    elif jump is not None:
        points, (why, again) = upto(points, jump), _retried(points.step[jump], control)
    elif bad < size:
        step = points.step[bad]
        points, last = _to_graze(along, points, look, bad, asked)
        why, again = ({"GR": End.GRAZE, "CH": End.REST}[last[0].kind], None) if last else _retried(step, control)
    loop = _met(along, points, asked)
    if loop is not None:
        points, last, why = cut_at(along, points, *loop, control), [], End.CLOSED
    if len(points.z) != size or last or loop is not None:
        look = looked(along, points.z)
    marks = _events(along, points, look, control, known, bool(last) and soft_grazing.is_singular(along, last[0]))
    for kind, function in asked.monitors.items():
        marks += crossings(along, points, look, kind, function, control)
    points, placed = inserted(along, points, sorted(marks, key=lambda one: one[:2]), control)
    placed += [one._replace(place=len(points.z) - 1) for one in last]
    halved = [one.place for one in placed if one.kind == "BP" and is_repeated(along, points.z[one.place])]
    stops = [one.place for one in placed if one.kind in asked.stop] + halved
    if stops:
        first = min(stops)
        points, why = upto(points, first + 1), End.HALVED if first in halved else End.STOPPED
        placed = [one for one in placed if one.place <= first]
    return _Part(points, looked(along, points.z) if marks or stops else look, tuple(placed), why, again)


def _retried(step, control):
    """(why, again) of a `_Part` where a step came to no point of the branch."""
    again = SMALLER * float(step)
    return (End.STEP, None) if again < control.smallest else (None, again)


def _joined(along, parts):
    points, look = joined([one.points for one in parts]), joined([one.look for one in parts])
    marks, offset = [], 0
    for part in parts:
        marks += [one._replace(place=one.place + offset) for one in part.marks]
        offset += len(part.points.z) - 1
    return Piece(along, points, look, tuple(marks), End.POINTS if parts[-1].why is None else parts[-1].why)


def _to_graze(along, points, look, bad, asked):
    """(the points up to the grazing before the first bad one, [its `Mark`]); without a mark where none is found."""
    points, residual = to_touch(along, points, look, bad, asked)
    if residual is None:
        return points, []
    z = points.z[-1]
    met, ways, sure = soft_grazing.exits(along, z, asked.length)
    kind = "CH" if len(ways) < 2 and is_pressed(along, z, met) else "GR"
    return points, [Mark(0, kind, residual, tuple(met), tuple(ways), sure)]


def _to_brush(along, points, asked):
    """As `_to_graze`, where contacts with soft walls are about to lose their speed: before it is lost in rounding."""
    size = len(along.cycle.sides)
    for k in range(1, len(points.z)):
        z, tangent = points.z[k], points.tangent[k]
        rows = [row for row in soft_grazing.slow(along, z, asked.length) if tangent[size + row] < 0]
        found = soft_grazing.located(along, z, rows, asked.length) if rows else None
        if found is None or found.z is None:
            continue
        ahead = -z[size + rows[0]] / tangent[size + rows[0]]
        length = float(np.sum(asked.control.scale**2 * tangent * (found.z - z)))
        if abs(length - ahead) < 0.5 * ahead:
            met, ways, sure = soft_grazing.exits(along, found.z, asked.length)
            one = at(points, k)._replace(z=found.z, step=np.float64(length))
            mark = Mark(0, "GR", float(found.residual), tuple(met), tuple(ways), sure)
            return put(upto(points, k + 1), k + 1, one), [mark]
    return points, []


def to_touch(along, points, look, bad, asked):
    """(the points up to the touch before the first bad one, the largest error left there); those before, and None,
    where none is found."""
    good, length = at(points, bad - 1), float(points.step[bad])
    there, seen, low, high = at(points, bad), at(look, bad), 0.0, length
    for _ in range(HALVES):
        found = _first_touch(along, good, there, seen, low, high, asked)
        if found is not None:
            break
        middle = between(along, points, bad - 1, 0.5 * (low + high), asked.control)
        if middle is None:
            break
        view = looked(along, middle.z[None])
        if admissible(along, middle.z, view)[0]:
            low = 0.5 * (low + high)
        else:
            high, there, seen = 0.5 * (low + high), middle, at(view, 0)
    cut = upto(points, bad)
    if found is None:
        return cut, None
    z, residual = found
    return put(cut, bad, pointed(along, points, bad - 1, z, asked.control)), residual


def _first_touch(along, good, there, seen, low, high, asked):
    """(z, residual) of the first touch between two lengths from a good point, None where it is not found, or another is
    before it. there, seen: the point at the second length."""
    rows, hit = len(along.cycle.sides), along.hits
    middle = 0.5 * (good.z + there.z)
    square, found = asked.control.scale**2, []
    for row in hit:
        if there.z[rows + row] <= 0:
            found.append(_stopped(along, middle, int(row), asked))
    if not found or not (there.z[rows + hit] <= 0).any():
        for row, wall in zip(*np.nonzero(seen.clear < 0), strict=True):
            found.append(touched(along, there.z, row, wall, float(seen.late[row, wall])))
    best = None
    for one in found:
        if one.z is None:
            continue
        length = float(np.sum(square * good.tangent * (one.z - good.z)))
        inside = low - 1e-9 - 0.02 * (high - low) <= length <= high + 1e-9 + 0.02 * (high - low)
        if inside and (best is None or length < best[0]):
            best = length, one
    if best is None:
        return None
    z = stilled(along, best[1].z, asked.length)
    view, slack = looked(along, z[None]), -TOUCH * asked.length
    earlier = view.clear.min(initial=0.0) < slack or z[rows : 2 * rows].min(initial=0.0) < slack
    return None if earlier else (z, best[1].residual)


def _stopped(along, z, row, asked):
    """The point near z where an impact loses its speed: `Located`."""
    rows = len(along.cycle.sides)
    if len(z) > 2 * rows + 1 and soft_grazing.is_smooth(along.scene, along.cycle.sides[row]):  # singular, for a locus
        return soft_grazing.located(along, z, [row], asked.length)
    return _pinned(problem(along), z, rows + row, 0.0, asked, along)


def _pinned(task, z, index, value, asked, along):
    """`follow.pinned` as a `Located`."""
    one = follow.pinned(task, z, index, value, asked.control, along)
    return Located(one.z if one.met else None, float(one.residual))


def pointed(along, points, after, z, control):
    """A `Point` with this z, its tangent and determinant taken on the branch there."""
    here = at(points, after)
    length = float(np.sum(control.scale**2 * here.tangent * (z - here.z)))
    one = follow.step(problem(along), here, length, control, along)
    if not one.met or not np.isfinite(one.tangent).all():
        one = here
    return one._replace(z=z, step=np.float64(length), met=np.True_, kept=np.True_)


def _to_bound(along, points, asked):
    """(the points, the last one on the bound that was passed, why)."""
    control = asked.control
    value = control.low if points.z[-1, -1] < control.low else control.high
    points, there = to_value(along, points, len(points.z) - 1, -1, value, asked)
    why = End.DOMAIN if value in asked.domain else End.BOUND
    return points, why if there else End.STEP


def to_value(along, points, last, index, value, asked):
    """(the points up to where one of the numbers of z, before a place, has a value, whether it was found)."""
    (p, q) = points.z[last - 1 : last + 1, index]
    share = (value - p) / (q - p)
    guess = between(along, points, last - 1, share * float(points.step[last]), asked.control)
    guess = points.z[last - 1] + share * (points.z[last] - points.z[last - 1]) if guess is None else guess.z
    found = _pinned(problem(along), guess, index, value, asked, along)
    cut = upto(points, last)
    if found.z is None:
        return cut, False
    z = np.array(found.z)
    z[index] = value  # but for a rounding it is
    return put(cut, last, pointed(along, points, last - 1, z, asked.control)), True


def _met(along, points, asked):
    """(place, length) where the branch comes to one of the marks, None where it does not."""
    marks = [each for cycle, value in asked.marks for each in images(along, cycle, value, points.z[0])]
    return follow.passes_mark(problem(along), points, marks, asked.control, along) if marks else None


def cut_at(along, points, after, length, control):
    """The points up to a length after one of them."""
    one = between(along, points, after, length, control)
    cut = upto(points, after + 1)
    return cut if one is None else put(cut, after + 1, one)


def _events(along, points, look, control, known, singular):
    """The events between points, as `inserted` takes them; singular: at the last one a contact has no speed, where each
    test is zero, and is given the sign that the multipliers come there with."""
    flip, tangent = look.flip, points.tangent
    if singular:
        doubled, folded = (1.0 + sign * look.trace[-2:] + look.determinant[-2:] for sign in (1.0, -1.0))
        flip = np.append(flip[:-1], flip[-2] * _turned(*doubled))
        tangent = np.vstack([tangent[:-1], tangent[-2] * _turned(*folded)])
    values = {"PD": flip} if len(along.cycle.sides) else {}
    return listed(follow.events(problem(along), points._replace(tangent=tangent), values, control, along, known))


def _turned(before, after):
    """-1 where a number changes its sign, else 1."""
    return -1.0 if before * after < 0 else 1.0


def listed(events):
    """`follow.Event`s as `inserted` takes them."""
    return [(one.after, one.length, one.kind, one.z, one.residual) for one in events]


def inserted(along, points, marks, control):
    """(the points with those of the marks among them, the `Mark`s)."""
    placed, done = [], {}
    for shift, (after, length, kind, z, residual) in enumerate(marks):
        one = pointed(along, points, after + shift, z, control)
        points = put(points, after + shift + 1, one._replace(step=np.float64(length - done.get(after, 0.0))))
        done[after] = length
        placed.append(Mark(after + shift + 1, kind, residual))
    return points, placed
