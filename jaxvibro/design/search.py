"""Bifurcations looked for in a box of scenes, without an orbit to begin with: `search`.

Random scenes of the box are settled from random states. What comes back is an orbit; each is taken towards where the
tests of the kinds asked for vanish, along their gradients by the free numbers (`aims`): a step of Newton's method and a
half more, followed as a ray. A ray that ends has met a boundary; otherwise the next step begins where it came to. Of
each boundary met the places nearest to the scene are handed to `follow`, which locates the point.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from continuation.limits import EXPIRED, UNLIMITED, limits_of

from ..branches.branch import Special
from ..branches.follow import check_settings, through
from ..branches.seed_orbits import SETTLE, settled_orbits
from ..maps.initial_conditions import random_starts
from ..maps.iterate import iterate
from ..orbits.impact_equations import Cycle
from ..output.table_text import columns
from ..problem.orbit_on_branch import OrbitPoint, place_orbit
from ..scene import check
from ..scene.scene import Scene
from .aims import FLIP, FOLD, SLOW, TOUCH, aims
from .free_numbers import room_of, units_of
from .point_equations import mark, whole
from .rays import RayEnd, rays

TESTS = {"SN": (FOLD,), "SB": (FOLD,), "PD": (FLIP,), "GR": (TOUCH, SLOW)}
ENDS = {RayEnd.FOLD: ("SN", "SB"), RayEnd.FLIP: ("PD",), RayEnd.TOUCH: ("GR",), RayEnd.SLOW: ("GR",)}
LANES = 32  # of a compiled call
EACH = 16  # orbits of one itinerary that are taken on
ROUNDS = 4  # of steps
BEYOND = 1.5  # times the step of Newton's method, that a ray goes
MOST_IMPACTS = 16  # of an orbit
TRIED = 3  # places of a boundary that are handed to `follow`
STEPS = {"first_step": 0.01, "largest_step": 0.05, "tolerance": 1e-10, "monitors": ()}


@dataclass(frozen=True, eq=False)
class Search:
    """What `search` found. scene; free: the unit of each number; points: a `Special` of each boundary, along the free
    number that moves the orbit most towards it, the nearest to the scene first; distances: of their scenes from the
    scene, in units; met: how many rays ended on each boundary; starts: random scenes; settled: how many of them came
    back within max_period periods; followed: rays; stopped: why the search ended before it was complete, else ""."""

    scene: Scene = field(repr=False)
    free: dict[str, float]
    points: tuple[Special, ...]
    distances: tuple[float, ...]
    met: tuple[int, ...]
    starts: int
    settled: int
    followed: int
    stopped: str = ""

    def table(self) -> str:
        """A line each, and how far it was looked."""
        rows = [("kind", "orbit", "itinerary", "distance", *self.free, "met")]
        for one, distance, met in zip(self.points, self.distances, self.met, strict=True):
            walls = " ".join(word or "." for word in one.itinerary)
            there = (f"{float(one.scene.parameter(name)):.9g}" for name in self.free)
            rows.append((one.kind, one.label, walls, f"{distance:.6g}", *there, str(met)))
        told = f"{self.starts} random scenes, {self.settled} of them settled; {self.followed} rays"
        why = [self.stopped] if self.stopped else []
        return "\n".join([columns(rows) if self.points else "nothing found", told, *why])


class _Seed(NamedTuple):
    """An orbit that a start settled on. offset: of its scene, in units; periods; impacts: times, speeds, sides."""

    offset: Float[np.ndarray, " free"]
    periods: int
    impacts: tuple[Float[np.ndarray, " impacts"], ...]


class _Place(NamedTuple):
    """Where a ray ended. kinds: that it may be; seed: the orbit just before; ahead: the way, in units."""

    kinds: tuple[str, ...]
    seed: _Seed
    ahead: Float[np.ndarray, " free"]


@check.host("use the function that located gives")
def search(
    scene: Scene,
    kinds: str | Sequence[str],
    free: Mapping[str, float],
    bounds: Mapping[str, Sequence[float]],
    starts: int = 1000,
    max_period: int = 4,
    seed: int = 0,
    *,
    max_seconds: float | None = None,
) -> Search:
    """Bifurcations of the attractors in a box of scenes: a `Search`, a point of each boundary that was met.

    scene: a single one; kinds: of SN, SB, PD, GR, one or more; free: {name: unit}; bounds: {name: (low, high)} of free
    numbers about the scene, due for all whose domain has no ends. starts: random scenes of the box, each with a random
    state, drawn from `seed`; max_period: drive periods of the longest orbits. max_seconds: wall-clock time, s, after
    which no further rays are followed and no further boundaries are located; None is no limit.

    A point is a `Special`: `located`, `locus` and `switch` take it on. Boundaries are told apart by kind, periods and
    itinerary. What no start settles near is not found, and where nothing is found the table says how far it was looked.

    Raises ArgumentError for kinds, numbers and bounds that cannot be.
    """
    limits = limits_of(None, max_seconds, None, check.ArgumentError)
    check.require_single(scene)
    check.require_spring(scene, "search")
    kinds = check.sequence("kinds", kinds)
    if not kinds or not set(kinds) <= set(TESTS):
        raise check.ArgumentError("kinds", f"must be some of {', '.join(TESTS)}", kinds)
    units = units_of(scene, free)
    room = room_of(scene, units, bounds)
    for name, low, high in zip(units, *room, strict=True):
        if not np.isfinite([low, high]).all():
            raise check.ArgumentError(f"bounds.{name}", "must be given, as the number's domain has no end", None)
    starts, max_period = check.whole("starts", starts, 1), check.whole("max_period", max_period, 1)
    if max_period > check.MOST_PERIODS:
        raise check.ArgumentError("max_period", f"must be at most {check.MOST_PERIODS}", max_period)
    settled = _settled(scene, units, room, starts, max_period, check.whole("seed", seed, 0))
    places, followed, whole = _ends(scene, units, room, _thinned(settled), kinds, limits)
    points, distances, met, left = _located(scene, units, room, places, kinds, limits)
    stopped = "" if whole and not left else f"{EXPIRED}: {followed} rays followed, {left} boundaries not located"
    return Search(scene, units, points, distances, met, starts, len(settled), followed, stopped)


def _moved(scene, units, offset):
    """The scene moved by so many units of each free number, a row each for many."""
    values = np.asarray(offset).T
    pairs = zip(units.items(), values, strict=True)
    return scene.replace(**{name: float(scene.parameter(name)) + unit * value for (name, unit), value in pairs})


def _settled(scene, units, room, starts, max_period, seed):
    """The `_Seed`s of random starts in random scenes."""
    low, high = room
    offsets = low + (high - low) * np.random.default_rng(seed).random((starts, len(units)))
    batch = _moved(scene, units, offsets)
    found = iterate(batch, random_starts(batch, starts, (seed, 1)), SETTLE)
    length = np.broadcast_to(2.0 * np.pi / np.asarray(batch.frequency), starts)
    return [_Seed(offsets[lane], *rest) for lane, *rest in settled_orbits(found, length, max_period)]


def _thinned(seeds):
    """At most so many of each itinerary, and none with more impacts than are followed."""
    taken, kept = {}, []
    for one in seeds:
        key = _word(one)
        taken[key] = taken.get(key, 0) + 1
        if taken[key] <= EACH and len(one.impacts[0]) <= MOST_IMPACTS:
            kept.append(one)
    return kept


def _word(seed):
    """The periods of an orbit and the sides of its impacts, begun where they are least, so that any start is alike."""
    sides = tuple(int(side) for side in seed.impacts[2])
    return seed.periods, min((sides[k:] + sides[:k] for k in range(len(sides))), default=())


def _ends(scene, units, room, seeds, kinds, limits=UNLIMITED):
    """(the `_Place`s where rays from some orbits end in one of the kinds, how many rays there were, whether the time
    was enough for all)."""
    tests = sorted({test for kind in kinds for test in TESTS[kind]})
    groups, places, followed = {}, [], 0
    for one in seeds:
        groups.setdefault(len(one.impacts[0]), []).append(one)
    for impacts, group in groups.items():
        lanes = [(one, test) for one in group for test in (tests if impacts else [TOUCH]) if test in tests]
        for _ in range(ROUNDS):
            lanes, met, count, whole = _round(scene, units, room, lanes, limits)
            places += [one for one in met if set(one.kinds) & set(kinds)]
            followed += count
            if not whole:
                return places, followed, False
    return places, followed, True


def _round(scene, units, room, lanes, limits):
    """(what is to go on, the `_Place`s of rays that have ended, how many rays there were, whether the time was enough
    for all) of (`_Seed`, test)s; the orbits have as many impacts."""
    onwards, met, count = [], [], 0
    for first in range(0, len(lanes), LANES):
        if limits.expired:
            return onwards, met, count, False
        some = lanes[first : first + LANES]
        ways, ends = _followed(scene, units, room, some + some[-1:] * (LANES - len(some)))
        for k, (one, test) in enumerate(some):
            if not ways[k].any():
                continue
            count += 1
            parts = np.split(ends.unknowns[k], 2) if len(one.impacts[0]) else one.impacts[:2]
            there = _Seed(one.offset + ends.share[k] * ways[k], one.periods, (*parts, one.impacts[2]))
            if ends.end[k] == RayEnd.NONE:
                onwards.append((there, test))
            else:
                met.append(_Place(ENDS[RayEnd(int(ends.end[k]))], there, ways[k]))
    return onwards, met, count, True


def _followed(scene, units, room, lanes):
    """(the ways of a block of lanes, in units, the `Ray`s along them)."""
    tree, base, marks = _numbers(scene, units)
    offsets = np.stack([one.offset for one, _ in lanes])
    parts = [np.stack([one.impacts[k] for one, _ in lanes]) for k in range(3)]
    periods = np.array([float(one.periods) for one, _ in lanes])
    cycles, numbers = Cycle(*parts, np.zeros(len(lanes)), periods), base + offsets @ marks
    tests = np.arange(len(lanes)), np.array([test for _, test in lanes])
    values, slopes = (each[tests] for each in jax.device_get(aims(tree, cycles, numbers, marks)))
    ways = _ways(values, slopes, offsets, room)
    return ways, jax.device_get(rays(tree, cycles, numbers, ways @ marks))


def _numbers(scene, units):
    """(the tree of a scene's numbers, these, what a unit of each free number is of them)."""
    numbers = whole(scene)
    marks = np.stack([mark(scene, name) * unit for name, unit in units.items()])
    return jax.tree.structure(numbers), np.stack([np.asarray(leaf) for leaf in jax.tree.leaves(numbers)]), marks


def _ways(values, slopes, offsets, room):
    """A step of Newton's method and a half more towards where each test vanishes, cut where it leaves the box; 0 where
    there is no such step."""
    with np.errstate(all="ignore"):
        ways = -BEYOND * values[:, None] * slopes / np.sum(slopes**2, axis=1, keepdims=True)
        ways = np.where(np.isfinite(ways).all(axis=1, keepdims=True), ways, 0.0)
        ends = np.where(ways > 0, room[1] - offsets, room[0] - offsets)
        share = np.nan_to_num(np.where(ways == 0, 1.0, ends / ways), nan=1.0, posinf=1.0)
    return ways * np.clip(share.min(axis=1, keepdims=True), 0.0, 1.0)


def _located(scene, units, room, places, kinds, limits=UNLIMITED):
    """(`Special`s, distances, how many rays met each), the nearest first; how many boundaries the time was not enough
    for."""
    boundaries = {}
    for one in sorted(places, key=lambda one: np.linalg.norm(one.seed.offset)):
        boundaries.setdefault((one.kinds, *_word(one.seed)), []).append(one)
    found, left = {}, 0
    for some in boundaries.values():
        if limits.expired:
            left += 1
            continue
        for one in some[:TRIED]:
            special = _special(scene, units, room, one, kinds)
            if special is None:
                continue
            pairs = ((float(special.scene.parameter(n)) - float(scene.parameter(n))) / u for n, u in units.items())
            distance, spot = float(np.linalg.norm(list(pairs))), special.spot
            key = special.kind, *_word(_Seed(one.seed.offset, spot.periods, (spot.times, spot.speeds, spot.sides)))
            before = found.get(key, (special, np.inf, 0))
            best = min((before[:2], (special, distance)), key=lambda each: each[1])
            found[key] = (*best, before[2] + len(some))
            break
    nearest = sorted(found.values(), key=lambda one: one[1])
    return *(tuple(one[k] for one in nearest) for k in range(3)), left


def _special(scene, units, room, place, kinds):
    """The `Special` of one of the kinds next to a `_Place`, None where it is none."""
    which = int(np.argmax(abs(place.ahead)))
    name, here = tuple(units)[which], _moved(scene, units, place.seed.offset)
    value = float(here.parameter(name))
    spot = OrbitPoint(value, *place.seed.impacts, place.seed.periods, np.nan, np.nan, np.nan)
    bounds = tuple(float(scene.parameter(name)) + units[name] * float(end[which]) for end in room)
    towards = "forward" if place.ahead[which] > 0 else "backward"
    settings = check_settings(**STEPS, stop=kinds)
    branch = through(here, name, bounds, place_orbit(here, name, spot), towards, settings)
    return next((one for one in branch.special if one.kind in kinds), None)
