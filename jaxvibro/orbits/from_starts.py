"""The periodic orbits that many trajectories come near, stable and unstable: Newton's method from their returns.

A trajectory that comes near an unstable orbit follows it for a while, so it comes back near itself. Each stretch of n
periods, those with the nearest ends and some at random, is a guess of the impacts of an orbit.
"""

from dataclasses import replace

import jax
import numpy as np

from continuation import newton

from ..maps.initial_conditions import box, random_starts
from ..maps.iterate import KEEP, iterate
from ..scene import check
from ..scene.codes import Status
from ..scene.scene import Scene
from ..scene.state import State
from ..scene.symmetry import is_symmetric
from .by_impacts import by_impacts, padded, solutions
from .by_shooting import by_state
from .free_response import free_response
from .orbit import Orbit, OrbitError
from .orbit_comparison import is_same_orbit, meetings, mirrored

SETTLE = 300  # drive periods after which a second look at the trajectories is taken
NEAREST, RANDOM = 2048, 1024  # stretches of each length that are tried
COARSE = 1e-4  # of the largest x and v: stretches that begin nearer to each other are one
LANES = 256  # of one call of Newton's method
MOST = 32  # impacts of an orbit
SAME = 1e-7  # of the largest speed: two orbits as near are one


@check.host("use solve_orbits, which takes guesses")
def find_orbits(scene: Scene, max_period: int = 4, starts: int = 200, seed: int = 0) -> tuple[Orbit, ...]:
    """The periodic orbits of a scene up to a number of drive periods, stable and unstable: a tuple of `Orbit`.

    scene: a single one. starts: trajectories that are searched, at phase 0, drawn from `seed` as
    `initial_conditions.box` says. Found are the orbits that trajectories come near: on an attractor, on the way to it,
    at the start; more starts find more. Each is there once, the least period first; of mirror images both, and they say
    so.

    Raises ArgumentError for a batch of scenes and for counts that cannot be.
    """
    check.require_single(scene)
    longest = check.whole("max_period", max_period, 1)
    if longest > KEEP // 2:
        raise check.ArgumentError("max_period", f"must be at most {KEEP // 2}", max_period)
    starts, seed = check.whole("starts", starts, 1), check.whole("seed", seed, 0)
    begun = iterate(scene, random_starts(scene, starts, seed), KEEP)
    looks = [begun, iterate(scene, begun.state, SETTLE)]
    fast = box(scene)[2]
    found = _Known(scene, fast)
    found.add(lambda: by_state(scene, free_response(scene), 1))
    rng = np.random.default_rng(seed)
    for periods in range(1, longest + 1):
        for guess in _distinct(scene, _stretches(scene, looks, periods, rng)):
            found.add(lambda guess=guess: by_impacts(scene, *guess))
        for state in _settled(looks[1], periods):
            found.add(lambda state=state, periods=periods: by_state(scene, state, periods))
    return found.paired()


class _Known:
    """Orbits met so far, each once."""

    def __init__(self, scene, fast):
        self.scene, self.fast, self.orbits, self.hits = scene, fast, [], []

    def add(self, make):
        """Adds what `make` returns, unless it is known or no orbit."""
        try:
            orbit = make()
        except OrbitError:
            return
        hits = self.seen(orbit)
        if self.place(orbit.periods, hits) is None:
            self.orbits.append(orbit)
            self.hits.append(hits)

    def seen(self, orbit):
        """The orbit's impacts as points."""
        time = orbit.impacts.time + orbit.state.phase / float(self.scene.frequency)
        return meetings(float(self.scene.frequency), time, orbit.impacts.side, orbit.impacts.speed, self.fast)

    def place(self, periods, hits):
        """The place of the orbit with these impacts, None where it is not known."""
        for place, (other, theirs) in enumerate(zip(self.orbits, self.hits, strict=True)):
            if other.periods == periods and is_same_orbit(hits, theirs, SAME):
                return place
        return None

    def paired(self):
        """The orbits in order, each with the place of its mirror image."""
        symmetric = is_symmetric(self.scene)
        if symmetric:
            for orbit, hits in zip(list(self.orbits), list(self.hits), strict=True):
                if self.place(orbit.periods, mirrored(hits)) is None:
                    self.add(lambda orbit=orbit: _image(orbit))
        order = sorted(range(len(self.orbits)), key=lambda k: _rank(self.orbits[k]))
        places = {old: new for new, old in enumerate(order)}
        twins = [self.place(self.orbits[k].periods, mirrored(self.hits[k])) for k in order]
        return tuple(
            replace(self.orbits[k], mirror_of=places.get(twin) if symmetric else None)
            for k, twin in zip(order, twins, strict=True)
        )


def _rank(orbit):
    return orbit.periods, len(orbit.label), orbit.label, orbit.itinerary, orbit.state.x


def _image(orbit):
    """The mirror image of an orbit: the other walls, half a period later."""
    length = 2.0 * np.pi / float(orbit.scene.frequency)
    impacts, span = orbit.impacts, orbit.periods * length
    if orbit.unknowns == "state":
        state = orbit.state
        return by_state(orbit.scene, State(-state.x, -state.v, state.phase + np.pi, -state.contact), orbit.periods)
    times = np.mod(impacts.time + 0.5 * length, span)
    order = np.argsort(times)
    return by_impacts(
        orbit.scene, times[order], impacts.speed[order], -impacts.side[order], orbit.state.phase, orbit.periods
    )


def _stretches(scene, looks, periods, rng):
    """Guesses of orbits, {impacts: (list of (times, speeds, sides), periods)}: stretches of trajectories."""
    length = 2.0 * np.pi / float(scene.frequency)
    found = {}
    for look in looks:
        points = look.points
        apart = abs(points[periods:] - points[:-periods]).max(axis=-1)
        flat = np.where((look.status < Status.CAP)[None, :], apart, np.inf).ravel()
        order = np.argsort(flat, kind="stable")
        spots = np.round(points[:-periods].reshape(-1, 2)[order] / (COARSE * abs(points).max())).astype(int)
        nearest = order[np.sort(np.unique(spots, axis=0, return_index=True)[1])[:NEAREST]]  # one of each spot
        chosen = np.unique(np.concatenate([nearest, rng.integers(0, flat.size, RANDOM)]))
        for begin, lane in zip(*np.unravel_index(chosen[np.isfinite(flat[chosen])], apart.shape), strict=True):
            rows = slice(begin + 1, begin + 1 + periods)
            hit = look.side[rows, lane] != 0
            count = int(hit.sum())
            if 0 < count <= MOST:
                times = look.time[rows, lane] + length * np.arange(periods)[:, None]
                found.setdefault(count, []).append(
                    (times[hit], look.speed[rows, lane][hit], look.side[rows, lane][hit])
                )
    return {count: (guesses, periods) for count, guesses in found.items()}


def _distinct(scene, stretches):
    """The arguments of `by_impacts` for each distinct solution that Newton's method reaches from the guesses."""
    length = 2.0 * np.pi / float(scene.frequency)
    for count, (guesses, periods) in sorted(stretches.items()):
        seen = set()
        for first in range(0, len(guesses), LANES):
            some = guesses[first : first + LANES]
            some += [some[-1]] * (LANES - len(some))
            cycles = [padded(scene, *guess, 0.0, periods) for guess in some]
            found, solved = solutions(scene, jax.tree.map(lambda *each: np.stack(each), *cycles))
            good = (solved.status == newton.OK) & (found.speeds[:, :count] > 0).all(axis=1)
            for k in np.flatnonzero(good):
                times, speeds, sides = (each[k, :count] for each in found[:3])
                key = _key(times, speeds, sides, periods, length)
                if key not in seen:
                    seen.add(key)
                    yield times, speeds, sides, 0.0, periods


def _key(times, speeds, sides, periods, length):
    """Equal for equal cycles, whichever of their periods comes first, but for an accident of rounding."""
    turns = []
    for turn in range(periods):
        late = np.mod(times - turn * length, periods * length)
        order = np.argsort(late)
        turns.append(tuple(np.round(late[order], 6)) + tuple(np.round(speeds[order], 6)) + tuple(sides[order]))
    return min(turns)


def _settled(look, periods):
    """States that have come back after so many periods: orbits that rest on a wall are found from nothing else."""
    points = look.points
    near = 1e-6 * abs(points[-1]).max(initial=1.0)
    back = abs(points[-1] - points[-1 - periods]).max(axis=-1) <= near
    seen = set()
    for lane in np.flatnonzero(back & (look.status < Status.CAP)):
        key = tuple(np.round(points[-1, lane], 5))
        if key not in seen:
            seen.add(key)
            yield State(*(float(each[lane]) for each in (look.x[-1], look.v[-1])), 0.0, float(look.contact[-1, lane]))
