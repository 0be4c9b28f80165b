"""Orbits that graze but for one impact in n returns, in their equations: from the grazing to where they graze again."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from continuation import event_search
from continuation.arclength import Control

from .diagnostics import diagnose
from .equations import OrbitEquations, problem
from .grazing import padded
from .orbit_on_branch import OrbitPoint
from .touches import TOUCH, admissible, scales, span, stilled, touched

STEPS = 8  # to where the square-root map has the next touch
FAR = 3.0  # times as far as that it is looked for
HALVES = 6  # of a step in which a touch is looked for


class OneImpactOrbits(NamedTuple):
    """Orbits along the speed of one impact. along; grazing: z where that is zero; index: its place in z; control."""

    along: OrbitEquations
    grazing: Float[np.ndarray, " unknowns"]
    index: int
    control: Control

    def at(self, z, speed):
        """The `Point` near z where the impact has a speed."""
        return event_search.pinned(problem(self.along), z, self.index, speed, self.control, self.along)

    def spot(self, z, residual):
        """The `OrbitPoint` of z."""
        rows, hits = len(self.along.cycle.sides), self.along.hits
        look = diagnose(self.along, z[None])
        times = np.mod(z[hits], span(self.along, z))
        order = np.argsort(times)
        parts = times[order], z[rows + hits][order], np.asarray(self.along.cycle.sides)[hits][order]
        numbers = int(self.along.cycle.periods), float(look.x[0, 0]), float(look.v[0, 0]), float(residual)
        return OrbitPoint(float(z[-1]), *parts, *numbers)


def rounds(found, n):
    """How often the orbit of a `TouchReturn` is gone through by those with one impact in n returns: if a return is half
    of it these close after an even number of returns, and else as their own mirror image."""
    return n // 2 if found.half and n % 2 == 0 else n


def kicks(found, n):
    """(return, place among the touches) of each such impact, once round."""
    return [(0, 0), (n, 1)] if found.half and n % 2 else [(0, 0)]


def one_impact_orbits(found, n, length):
    """The `OneImpactOrbits` with one impact in n returns beside those of the orbit of a `TouchReturn`; length: the
    scene's."""
    bare, z, first = found.bare, found.z, found.touches[0]
    rows, whole, times = len(bare.cycle.sides), span(bare, z), rounds(found, n)
    listed = [(first.time + k * found.length, 0.0, found.touches[place].depth.side) for k, place in kicks(found, n)]
    for k in bare.hits if rows else ():
        late = first.time + (z[k] - first.time) % whole
        listed += [(late + j * whole, z[rows + k], bare.cycle.sides[k]) for j in range(times)]
    cycle = padded(bare, sorted(listed))._replace(periods=np.asarray(float(times) * float(bare.cycle.periods)))
    along = bare._replace(cycle=cycle)
    size = len(cycle.sides)
    numbers = (np.float64(each) for each in (0.0, 1.0, 1.0, -np.inf, np.inf))
    start = np.concatenate([cycle.times, cycle.speeds, z[-1:]])
    return OneImpactOrbits(along, start, size, Control(scales(along, length), *numbers))


def next_touch(orbits, speed, length):
    """(z, residual) where the orbits, followed from the grazing along the speed of the impact, touch a wall first, None
    where they do not soon; speed: about that there."""
    before, here, step, reached = None, orbits.grazing, speed / STEPS, 0.0
    while reached < FAR * speed:
        guess = here if before is None else 2.0 * here - before
        point = orbits.at(guess, reached + step)
        if not point.met:
            return None
        look = diagnose(orbits.along, point.z[None])
        if not admissible(orbits.along, point.z, look)[0]:
            return _between(orbits, here, point.z, look, length)
        before, here, reached = here, point.z, reached + step
    return None


def _between(orbits, good, bad, look, length):
    """(z, residual) of the first touch between two orbits, good the one before, None where none is found."""
    for _ in range(HALVES):
        row, wall = np.unravel_index(np.argmin(look.clear[0]), look.clear[0].shape)
        found = touched(orbits.along, bad, row, wall, float(look.late[0, row, wall]))
        low, high = good[orbits.index], bad[orbits.index]
        if found.z is not None and low < found.z[orbits.index] <= high:
            z = stilled(orbits.along, found.z, length)
            view = diagnose(orbits.along, z[None])
            if view.clear.min() > -TOUCH * length and z[len(orbits.along.cycle.sides) + orbits.along.hits].min() > 0:
                return z, found.residual
        middle = orbits.at(0.5 * (good + bad), 0.5 * (low + high))
        if not middle.met:
            return None
        view = diagnose(orbits.along, middle.z[None])
        if admissible(orbits.along, middle.z, view)[0]:
            good = middle.z
        else:
            bad, look = middle.z, view
    return None
