"""What orbits along a branch or a locus must keep to besides their equations, and where they first touch a wall."""

import numpy as np

from continuation import event_search
from continuation.driver import Watch
from continuation.locate import Located
from continuation.points import between, pointed
from continuation.rows import at, put, upto

from . import resting, soft_grazing
from .diagnostics import diagnose
from .missed_touches import with_dips
from .touches import TOUCH, admissible, rests, stilled, touched

HALVES = 60  # of an interval in which a touch is looked for


class OrbitWatch(Watch):
    """Orbits keep between their walls, and their impacts have a speed. equations: `OrbitEquations`, or those of a
    locus; length: the scene's."""

    def __init__(self, equations, length):
        self.equations, self.length = equations, length

    def look(self, task, points, view):
        return with_dips(task, points, view)

    def view(self, zs):
        return diagnose(self.equations, zs)

    def good(self, zs, view):
        return admissible(self.equations, zs, view)


def to_touch(task, points, look, bad, length):
    """(the points up to the touch before the first bad one, the largest error left there); those before, and None,
    where none is found, or the time is over. task: the `driver.Task`, its args the equations; length: the scene's."""
    good, far = at(points, bad - 1), float(points.step[bad])
    there, seen, low, high = at(points, bad), at(look, bad), 0.0, far
    for _ in range(HALVES):
        found = _first_touch(task, good, there, seen, low, high, length)
        if found is not None or task.limits.expired:
            break
        middle = between(task, points, bad - 1, 0.5 * (low + high))
        if middle is None:
            break
        view = diagnose(task.args, middle.z[None])
        if admissible(task.args, middle.z, view)[0]:
            low = 0.5 * (low + high)
        else:
            high, there, seen = 0.5 * (low + high), middle, at(view, 0)
    cut = upto(points, bad)
    if found is None:
        return cut, None
    z, residual = found
    return put(cut, bad, pointed(task, points, bad - 1, z)), residual


def _first_touch(task, good, there, seen, low, high, length):
    """(z, residual) of the first touch between two lengths from a good point, None where it is not found, or another is
    before it. there, seen: the point at the second length."""
    along = task.args
    rows, hit = len(along.cycle.sides), along.hits
    middle = 0.5 * (good.z + there.z)
    square, found = task.control.scale**2, []
    for row in hit:
        if there.z[rows + row] <= 0:
            found.append(_stopped(task, middle, int(row), length))
    if not found or not (there.z[rows + hit] <= 0).any():
        for row, wall in zip(*np.nonzero(seen.clear < 0), strict=True):
            found.append(touched(along, there.z, row, wall, float(seen.late[row, wall])))
        found += _unrested(along, middle, seen)
    best = None
    for one in found:
        if one.z is None:
            continue
        ahead = float(np.sum(square * good.tangent * (one.z - good.z)))
        inside = low - 1e-9 - 0.02 * (high - low) <= ahead <= high + 1e-9 + 0.02 * (high - low)
        if inside and (best is None or ahead < best[0]):
            best = ahead, one
    if best is None:
        return None
    z = stilled(along, best[1].z, length)
    view, slack = diagnose(along, z[None]), -TOUCH * length
    earlier = view.clear.min(initial=0.0) < slack or z[rows : 2 * rows].min(initial=0.0) < slack
    return None if earlier else (z, best[1].residual)


def _unrested(along, z, seen):
    """The points near z where rests that are none any more just are: `Located`s."""
    ends = zip((resting.excesses, resting.presses), rests(along, seen), strict=True)
    return [resting.located(along, z, int(row), one) for one, values in ends for row in np.flatnonzero(values <= 0)]


def _stopped(task, z, row, length):
    """The point near z where an impact loses its speed: `Located`."""
    along = task.args
    rows = len(along.cycle.sides)
    if len(z) > 2 * rows + 1 and soft_grazing.is_smooth(along.scene, along.cycle.sides[row]):  # singular, for a locus
        return soft_grazing.located(along, z, [row], length)
    one = event_search.pinned(task.problem, z, rows + row, 0.0, task.control, along)
    return Located(one.z if one.met else None, float(one.residual))
