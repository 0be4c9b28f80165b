"""A segment of a branch: orbits of one itinerary, from a start to the first grazing, bound or other end."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from continuation import driver, event_search
from continuation.arclength import Control
from continuation.driver import Met, Task
from continuation.limits import UNLIMITED, Limits
from continuation.rows import at, put, upto
from continuation.stretch import Mark

from ..orbits.impact_equations import Cycle
from ..problem import graze_within, resting, soft_grazing
from ..problem.end import End, ended
from ..problem.equations import problem
from ..problem.first_touch import OrbitWatch, to_touch
from ..problem.grazing import GrazingExit
from ..problem.same_orbit import images, is_repeated
from ..problem.touches import Touch, is_pressed
from . import through_rests
from .neimark_sacker import neimark_sacker
from .resonances import resonances
from .user_monitors import MonitoredPoint, crossings


class BranchSettings(NamedTuple):
    """What a branch is asked for. control: of steps; first: the first; domain: (low, high), the parameter's by its
    meaning; monitors: {label: function of a `MonitoredPoint`}; stop: labels; length: the scene's; marks: (`Cycle`,
    parameter) of orbits that end the branch when it meets them; limits: of its points and of the time."""

    control: Control
    first: float
    domain: tuple[float, ...]
    monitors: dict[str, Callable[[MonitoredPoint], Any]]
    stop: tuple[str, ...]
    length: float
    marks: tuple[tuple[Cycle, float], ...]
    limits: Limits = UNLIMITED


class GrazingPoint(NamedTuple):
    """What is known of a GR or CH. touches: of walls; exits: the branches that leave it; sure: whether these are all;
    aside: which of them the branch does not go on with."""

    touches: tuple[Touch, ...]
    exits: tuple[GrazingExit, ...]
    sure: bool
    aside: tuple[bool, ...] = ()


def follow_itinerary(along, start, asked):
    """The `Stretch` of orbits of one itinerary that begins at a `Point`; its end is an `End` of `problem.end`."""
    control = asked.control
    box, watch = ((float(control.low), float(control.high)),), BranchWatch(along, asked.length, asked.monitors)
    ends = asked.stop, asked.marks, asked.limits
    task = Task(problem(along), along, control, asked.first, box, (asked.domain,), watch, *ends)
    return ended(driver.run(task, start))


class BranchWatch(OrbitWatch):
    """Orbits along one parameter: they graze, double their period, are met again from another impact, or turn out to be
    shorter ones; and what a user monitors."""

    def __init__(self, along, length, monitors):
        super().__init__(along, length)
        self.monitors = monitors

    def passed(self, points):
        """Where contacts with soft walls have lost their speed: there the determinant changes its sign with theirs."""
        return soft_grazing.lost(self.equations, points.z)

    def before(self, task, points):
        """Where contacts with soft walls are about to lose their speed: before it is lost in rounding."""
        along, size = self.equations, len(self.equations.cycle.sides)
        for k in range(1, len(points.z) if along.scene.soft_sides else 0):
            z, tangent = points.z[k], points.tangent[k]
            rows = [row for row in soft_grazing.slow(along, z, self.length) if tangent[size + row] < 0]
            rows = [row for row in rows if not graze_within.is_pressed_in(along, z, row)]
            found = soft_grazing.located(along, z, rows, self.length) if rows else None
            if found is None or found.z is None:
                continue
            ahead = -z[size + rows[0]] / tangent[size + rows[0]]
            length = float(np.sum(task.control.scale**2 * tangent * (found.z - z)))
            if abs(length - ahead) < 0.5 * ahead:
                one = at(points, k)._replace(z=found.z, step=np.float64(length))
                more = soft_grazing.exits(along, found.z, self.length)
                return self.grazing(put(upto(points, k + 1), k + 1, one), "GR", float(found.residual), more)
        return self.from_within(task, points) if along.scene.soft_sides else None

    def from_within(self, task, points):
        """`Met` where a mass within a soft wall is about to leave it for a moment, or not to leave it any more."""
        met = graze_within.ahead(self.equations, points, task.control, self.length)
        if met is None:
            return None
        last, found = met
        one = at(points, last)._replace(z=found.z, step=np.float64(found.step))
        more = found.touches, found.exits, found.sure
        return self.grazing(put(upto(points, last + 1), last + 1, one), "GR", found.residual, more)

    def touch(self, task, points, view, bad):
        along = self.equations
        points, residual = to_touch(task, points, view, bad, self.length)
        if residual is None:
            return None
        z = points.z[-1]
        unrest = resting.kind_at(along, z, self.length)
        if unrest:
            ways = through_rests.exits(along, z, np.sign(points.tangent[-1, -1]), self.length, task.limits)
            return None if ways is None else self.grazing(points, unrest, residual, ((), ways, True))
        more = soft_grazing.exits(along, z, self.length)
        kind = "CH" if len(more[1]) < 2 and is_pressed(along, z, more[0]) else "GR"
        ends = kind == "CH" and along.cycle.releases is None
        return self.grazing(points, kind, residual, more)._replace(end=End.REST if ends else End.GRAZE)

    def grazing(self, points, kind, residual, more):
        """The `Met` at the last of the points; more: (touches, exits, whether these are all)."""
        met, ways, sure = more
        return Met(points, Mark(0, kind, residual, GrazingPoint(tuple(met), tuple(ways), sure)), End.GRAZE)

    def events(self, task, points, view, known, end):
        """Where the contact at the end has no speed each test is zero: it is given the sign that the multipliers come
        there with."""
        hits, tangent = len(self.equations.cycle.sides), points.tangent
        flip = view.flip if hits else 1.0 + view.trace + view.determinant
        if end is not None and soft_grazing.is_singular(self.equations, end.mark.more.touches):
            doubled, folded = (1.0 + sign * view.trace[-2:] + view.determinant[-2:] for sign in (1.0, -1.0))
            flip = np.append(flip[:-1], flip[-2] * _turned(*doubled))
            tangent = np.vstack([tangent[:-1], tangent[-2] * _turned(*folded)])
        doubles = (hits or self.equations.scene.force is not None) and self.equations.cycle.releases is None
        values = {"PD": flip} if doubles else {}  # none under a spring alone, none of what rests
        found = event_search.events(
            task.problem, points._replace(tangent=tangent), values, task.control, task.args, known
        )
        found += [*neimark_sacker(task, points, view), *resonances(task, points, view)]
        for kind, function in self.monitors.items():
            found += crossings(task, points, view, kind, function)
        return found

    def images(self, orbit, near):
        """orbit: (`Cycle`, parameter)."""
        return images(self.equations, *orbit, near)

    def stops(self, z, kind):
        return End.HALVED if kind == "BP" and is_repeated(self.equations, z) else None


def _turned(before, after):
    """-1 where a number changes its sign, else 1."""
    return -1.0 if before * after < 0 else 1.0
