"""A locus in one direction: steps along it up to where its bounds, its walls or its start end it."""

from typing import NamedTuple

import numpy as np

from continuation import driver, locate
from continuation.arclength import Control, Point
from continuation.driver import Met, Task
from continuation.limits import UNLIMITED, Limits
from continuation.stretch import Mark

from ..problem import resting
from ..problem.end import End, ended
from ..problem.end_in_plane import told
from ..problem.equations import problem
from ..problem.first_touch import OrbitWatch, to_touch
from ..problem.grazing import FLAT, opening
from ..problem.touches import stays, touches, wall_sides
from . import codim2
from .completing import Completing
from .extended_system import Grazing, Singular


class LocusSettings(NamedTuple):
    """What a locus is asked for. control: of steps, with the second parameter's bounds; first: the first step; names;
    bounds: (low, high) of each parameter by name; box: the same within their domains; domain: the ends of these that
    no bound is; length: the scene's; limits: of its points and of the time."""

    control: Control
    first: float
    names: tuple[str, str]
    bounds: dict[str, tuple[float, float]]
    box: tuple[tuple[float, float], ...]
    domain: tuple[tuple[float, ...], ...]
    length: float
    limits: Limits = UNLIMITED


class LocusWay(NamedTuple):
    """A locus in one direction, to be tracked. curve: its equations; start: a `Point` whose tangent leads away."""

    curve: Grazing | Singular | Completing
    start: Point
    asked: LocusSettings

    @property
    def task(self) -> Task:
        """The `driver.Task`."""
        curve, asked = self.curve, self.asked
        watch = LocusWatch(curve, asked.length)
        starts, own = (np.asarray(self.start.z),), (asked.box, asked.domain, watch)
        return Task(problem(curve), curve, asked.control, asked.first, *own, starts=starts, limits=asked.limits)

    def limited(self, limits: Limits) -> "LocusWay":
        """The same with these limits."""
        return self._replace(asked=self.asked._replace(limits=limits))

    @property
    def is_free(self) -> bool:
        """Whether no other touch than its own becomes an impact along it, or loses speed where it is one."""
        curve, z, tangent = self.curve, self.start.z, self.start.tangent
        walls, held, rows = wall_sides(curve.scene), stays(curve, z), len(curve.cycle.sides)
        met = touches(curve, z, self.asked.length)
        places = [(one.row, walls.index(one.side), one.late - float(held[one.row])) for one in met if not one.own]
        slow = [tangent[rows + one.row] for one in met if one.own and one.row in curve.hits]
        return all(rate > -FLAT for rate in (*slow, *(opening(curve, z, tangent, *place) for place in places)))


class LocusWatch(OrbitWatch):
    """Orbits along two parameters: the points of codimension two among them, and the touch that ends them."""

    def look(self, task, points, view):
        return super().look(task, points._replace(residual=_left(task, points)), view)

    def touch(self, task, points, view, bad):
        points, residual = to_touch(task, points, view, bad, self.length)
        if residual is None:
            return None
        return Met(points, Mark(0, self.meets(points.z[-1]), residual), End.GRAZE)

    def meets(self, z):
        """The kind of a point at which a flight touches a wall, an impact has lost its speed, or a rest is none."""
        curve = self.equations
        if isinstance(curve, Completing):
            return "GR" if touches(curve, z, self.length) else "CH"
        return resting.kind_at(curve, z, self.length) or ("GG" if isinstance(curve, Grazing) else "GR")

    def events(self, task, points, view, known, end):
        return codim2.events(task, points, view)


def track(way):
    """The `Stretch` along a `LocusWay`."""
    return ended(driver.run(way.task, way.start))


def together(ways):
    """The `Stretch` of each of some `LocusWay`s, those of one kind and size as the lanes of one compiled call."""
    return [ended(one) for one in driver.run_together([way.task for way in ways], [way.start for way in ways])]


def reason(way, one):
    """Why a `LocusWay` ended, of which the `Stretch` is known."""
    return told(one.end, way.asked.names[one.which], one.value)


def _left(task, points):
    """The residual of each point: the error before Newton's last step, but where that is large the one after it."""
    left = points.residual.copy()
    for k in np.flatnonzero(left > task.control.tolerance * (1.0 + abs(points.z[:, -2:]).max(axis=1))):
        left[k] = abs(np.asarray(locate.evaluated(task.problem, points.z[k], task.args)[0])).max()
    return left
