"""Orbits that graze but for one impact in n returns, in their equations: from the grazing to where they graze again."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from continuation import event_search
from continuation.arclength import Control, Point

from .diagnostics import diagnose
from .equations import OrbitEquations, problem
from .grazing import padded
from .orbit_on_branch import OrbitPoint
from .touches import TOUCH, admissible, flight_times, scales, settled_near, span, stays, stilled, touched, wall_sides

STEPS = 8  # to where the square-root map has the next touch
FAR = 3.0  # times as far as that it is looked for
NEAR = 0.25  # of a return: so near to where it was at the grazing a pass is looked for
HALVES = 6  # of a step in which a touch is looked for


class OneImpactOrbits(NamedTuple):
    """Orbits along the speed of one impact. along; grazing: z where that is zero; place: of the speed in z; passes:
    (row, wall, share of the flight after it) of each return in which there is no impact; control; length: the
    scene's."""

    along: OrbitEquations
    grazing: Float[np.ndarray, " unknowns"]
    place: int
    passes: tuple[tuple[int, int, float], ...]
    control: Control
    length: float

    def at(self, z: Float[np.ndarray, " unknowns"], speed: float) -> Point:
        """The `Point` near z where the impact has a speed."""
        return event_search.pinned(problem(self.along), z, self.place, speed, self.control, self.along)

    def nearest(self, z: Float[np.ndarray, " unknowns"]) -> tuple[bool, tuple[int, int, float]]:
        """(whether the orbit keeps to its walls; (row, wall, time) where a flight is nearest to one, or deepest).

        Where it passes the touch it is asked for itself: as many passes are alike, the least of all turning points
        is not told from the next to a part of their distance.
        """
        look = diagnose(self.along, z[None])
        near, met = np.unravel_index(np.argmin(look.clear[0]), look.clear[0].shape)
        found = [(float(look.clear[0, near, met]), (int(near), int(met), float(look.late[0, near, met])))]
        spans, length = flight_times(self.along, z), span(self.along, z) / (len(self.passes) + 1)
        for row, wall, share in self.passes:
            guess = share * spans[row]
            late, distance, _ = settled_near(self.along, z, row, wall, guess)
            if abs(late - guess) < NEAR * length:  # else it is no pass any more, or another one
                found.append((float(distance), (row, wall, float(late))))
        least, place = min(found)
        return bool(admissible(self.along, z, look)[0] and least >= 0), place

    def spot(self, z: Float[np.ndarray, " unknowns"], residual: float) -> OrbitPoint:
        """The `OrbitPoint` of z."""
        rows, hits = len(self.along.cycle.sides), self.along.hits
        look = diagnose(self.along, z[None])
        times = np.mod(z[hits], span(self.along, z))
        order = np.argsort(times)
        parts = times[order], z[rows + hits][order], np.asarray(self.along.cycle.sides)[hits][order]
        x, v, periods = float(look.x[0, 0]), float(look.v[0, 0]), int(self.along.cycle.periods)
        return OrbitPoint(float(z[-1]), *parts, periods, x, v, float(residual))


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
    listed = sorted(listed)
    cycle = padded(bare, listed)._replace(periods=np.asarray(float(times) * float(bare.cycle.periods)))
    along, size = bare._replace(cycle=cycle), len(cycle.sides)
    start = np.concatenate([cycle.times, cycle.speeds, z[-1:]])
    spans, walls, passes = flight_times(along, start), wall_sides(along.scene), []
    held = stays(along, start)
    for k in range(1, round(times * whole / found.length)):
        late, side = first.time + k * found.length, found.touches[k % 2 if found.half else 0].depth.side
        row = sum(time < late for time, *_ in listed) - 1
        if (k, 1) not in kicks(found, n):
            passes.append((row, walls.index(side), float((late - listed[row][0] - held[row]) / spans[row])))
    numbers = (np.float64(each) for each in (0.0, 1.0, 1.0, -np.inf, np.inf))
    return OneImpactOrbits(along, start, size, tuple(passes), Control(scales(along, length), *numbers), length)


def next_touch(orbits, speed):
    """(z, the wall's side) where the orbits, followed along the speed of the impact, first touch a wall, None
    where they do not soon; speed: about that there."""
    before, here, step = None, orbits.grazing, speed / STEPS
    for k in range(1, round(FAR * STEPS) + 1):
        point = orbits.at(here if before is None else 2.0 * here - before, k * step)
        if not point.met:
            return None
        good, place = orbits.nearest(point.z)
        if not good:
            return _between(orbits, here, point.z, place)
        before, here = here, point.z
    return None


def _between(orbits, good, bad, place):
    """(z, the wall's side) of the first touch between two orbits, None where none is found; place: where the bad one is
    deepest behind a wall."""
    rows = len(orbits.along.cycle.sides)
    for _ in range(HALVES):
        found = touched(orbits.along, bad, *place)
        if found.z is not None and good[orbits.place] < found.z[orbits.place] <= bad[orbits.place]:
            z = stilled(orbits.along, found.z, orbits.length)
            clear = diagnose(orbits.along, z[None]).clear.min()
            if clear > -TOUCH * orbits.length and z[rows + orbits.along.hits].min() > 0:
                return z, wall_sides(orbits.along.scene)[place[1]]
        middle = orbits.at(0.5 * (good + bad), 0.5 * (good + bad)[orbits.place])
        if not middle.met:
            return None
        fine, near = orbits.nearest(middle.z)
        if fine:
            good = middle.z
        else:
            bad, place = middle.z, near
    return None
