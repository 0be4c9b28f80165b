"""How far an orbit is from its nearest bifurcations, in the space of some numbers of its scene: `margin`."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import takewhile
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from continuation.limits import EXPIRED, limits_of

from ..orbits.impact_equations import Cycle
from ..orbits.orbit import Orbit, OrbitError
from ..output.table_text import columns, headed
from ..output.units import unit_in, unit_of
from ..scene import check
from ..scene.codes import SolutionStatus
from ..scene.parameters import domain
from ..scene.scene import Scene
from ..scene.symmetry import stays_symmetric
from .edge import CUSP, Edge, cusp, edges_of
from .free_numbers import room_of, units_of
from .located_point import solved
from .nearest import nearest
from .nearest_edge import nearest_on
from .point_equations import mark, whole
from .ray_end import point_at
from .rays import RayEnd, rays

KINDS = ("SN", "PD", "SB", "GR")
REACHES = 1.0, 4.0, 16.0, 64.0, 256.0  # units: one after the other, until a boundary is found
MOST = 4  # starts of a kind and of touches of one wall
ROUNDING = 1e-12  # of 1 + a number's change: so far beyond its bound it is at it
ALIKE = 1e-6  # of 1 + the distance: two points as near are one
SLACK = 4.0 / 1024.0  # of a way: a ray's end is so well known
NEAR = 1e-3  # units: edges are looked for once from places as near
APART = 0.3  # of 1 + the largest unknown: an orbit that far on from a cusp, by the cube root of `SLACK`, has passed it
REACHED, BEHIND = "reached", "behind another"


@dataclass(frozen=True, eq=False)
class NearPoint:
    """A bifurcation near a scene. kind: SN, PD, SB or GR; distance: from the scene, in units of the free numbers;
    change: by how much each free number is another there; direction: to it, of length 1, in these units; scene: there;
    times, speeds, sides: of its orbit's impacts, of half the orbit at an SB; residual: the largest number left in its
    equations; slope: of the distance across the direction, 0 where it is least; status: "reached": the orbit was
    followed on the straight way there, and it is the first that it meets; "behind another": another comes before;
    at_bound: the names of free numbers that are at a bound there; edge: what ends the boundary there, "a touch", "an
    impact without speed", "a cusp", or nothing."""

    kind: str
    distance: float
    change: dict[str, float]
    direction: dict[str, float]
    scene: Scene = field(repr=False)
    times: Float[np.ndarray, " impacts"]
    speeds: Float[np.ndarray, " impacts"]
    sides: tuple[int, ...]
    residual: float
    slope: float
    status: str
    at_bound: tuple[str, ...]
    edge: str = ""


@dataclass(frozen=True, eq=False)
class Margin:
    """What is near an orbit. orbit; free: the unit of each number; points: the nearest `NearPoint` of each kind, the
    nearest first; others: more of them, and such as lie behind; searched: how far, in units, in how many directions the
    orbit was followed. stopped: why the search ended before it was complete, else ""; a nearer bifurcation may then be
    missing."""

    orbit: Orbit
    free: dict[str, float]
    points: tuple[NearPoint, ...]
    others: tuple[NearPoint, ...]
    searched: tuple[float, int]
    stopped: str = ""

    @property
    def distance(self) -> float:
        """To the nearest, in units; infinite where none was found."""
        return self.points[0].distance if self.points else np.inf

    def table(self, units: str = "scene") -> str:
        """A line each, and how far it was looked. units: "scene", or "physical" (Hz, N, mm) of a scene that has scales.

        Raises ArgumentError for other units, and where the scene has no scales.
        """
        known = {name: unit_in(self.orbit.scene, unit_of(name), units) for name in self.free}

        def values(scene):
            return (f"{size * float(scene.parameter(name)):.9g}" for name, (_, size) in known.items())

        rows = [("kind", "distance", *(headed(name, unit, units) for name, (unit, _) in known.items()), "status")]
        for one in self.points:
            status = one.status + (f", at a bound of {', '.join(one.at_bound)}" if one.at_bound else "")
            status += f", ends there in {one.edge}" if one.edge else ""
            rows.append((one.kind, f"{one.distance:.9g}", *values(one.scene), status))
        rows.append((self.orbit.label, "0", *values(self.orbit.scene), "the orbit itself"))
        steps = ", ".join(f"{name} {known[name][1] * step:g}" for name, step in self.free.items())
        reach, ways = self.searched
        told = f"followed to a distance of {reach:g} in {ways} directions"
        return "\n".join([columns(rows), f"units: {steps}", told, *([self.stopped] if self.stopped else [])])


class _Space(NamedTuple):
    """The free numbers. names; units: what one of each is of the scene's numbers; low, high: bounds, in units from the
    scene; symmetric: which of them keep a symmetric scene so."""

    names: tuple[str, ...]
    units: Float[np.ndarray, "free numbers"]
    low: Float[np.ndarray, " free"]
    high: Float[np.ndarray, " free"]
    symmetric: Float[np.ndarray, " free"]


@check.host("use the function that located gives")
def margin(
    orbit: Orbit,
    free: Mapping[str, float],
    bounds: Mapping[str, Sequence[float]] | None = None,
    kinds: str | Sequence[str] = KINDS,
    directions: int = 128,
    seed: int = 0,
    *,
    max_seconds: float | None = None,
) -> Margin:
    """The nearest bifurcation of each kind, in the space of some numbers of the orbit's scene: a `Margin`.

    orbit: an `Orbit` of separate impacts, or of none, stable or not. free: {name: unit}: distances are the root of the
    sum of squares of (change / unit). bounds: {name: (low, high)} of free numbers, by default their domains. kinds: SN,
    PD, SB, GR. directions: in so many, the axes and random ones, the orbit is followed until something ends it; these
    ends are where Newton's method on the condition of Karush, Kuhn and Tucker begins, with multipliers for bounds. The
    margin is that of this one orbit: other motions may be there sooner, and take most starts (`find_attractors`).

    An SB is looked for among the free numbers that keep the scene symmetric. Nothing is proved about directions
    in which the orbit was not followed (`searched`). max_seconds: wall-clock time, s, after which the orbit is followed
    no farther and no further point is looked for; None is no limit. `stopped` then says so.

    Raises ArgumentError for a name that the scene lacks, a unit that is no positive number, bounds that do not hold the
    scene; OrbitError for an orbit that rests on a wall.
    """
    limits = limits_of(None, max_seconds, None, check.ArgumentError)
    if not isinstance(orbit, Orbit):
        raise check.ArgumentError("orbit", "must be an Orbit, as find_orbit gives it", orbit)
    if not orbit.impacts.count:
        check.require_spring(orbit.scene, "margin of an orbit without impacts")
    if orbit.unknowns == "state" and orbit.impacts.count:
        raise OrbitError("the orbit rests on a wall, or chatters", orbit.residual, "margin takes separate impacts")
    units, kinds = units_of(orbit.scene, free), check.sequence("kinds", kinds)
    if not set(kinds) <= set(KINDS) or not kinds:
        raise check.ArgumentError("kinds", f"must be some of {', '.join(KINDS)}", kinds)
    count = check.whole("directions", directions, 2 * len(units))
    space, cycle = _space(orbit.scene, units, bounds or {}), cycle_of(orbit)
    scene = whole(orbit.scene)
    numbers, tree = np.stack([np.asarray(leaf) for leaf in jax.tree.leaves(scene)]), jax.tree.structure(scene)
    ways = directions_of(len(units), count, seed)
    for reach in REACHES:
        ends, lengths = _ends(tree, cycle, numbers, space, ways, reach)
        starts = _starts(tree, cycle, numbers, space, ways, lengths, ends, kinds)
        if starts or limits.expired:
            break
    feet = [_foot(numbers, space, *start) for start in takewhile(lambda start: not limits.expired, starts)]
    late = len(feet) < len(starts) or limits.expired
    stopped = f"{EXPIRED}: {len(feet)} of {len(starts)} points near it looked for" if late else ""
    feet += [] if late else _edges(numbers, space, starts, feet)
    found = [_near(orbit, tree, cycle, numbers, space, *foot) for foot in feet if foot is not None]
    found = _distinct(sorted((one for one in found if one), key=lambda one: (one.status == BEHIND, one.distance)))
    first = [next((one for one in found if one.kind == kind), None) for kind in kinds]
    points = sorted((one for one in first if one), key=lambda one: one.distance)
    others = tuple(one for one in found if one not in points)
    return Margin(orbit, units, tuple(points), others, (reach, count), stopped)


def _space(scene, free, bounds):
    units = np.stack([mark(scene, name) * unit for name, unit in free.items()])
    symmetric = np.array([float(stays_symmetric(scene, name)) for name in free])
    return _Space(tuple(free), units, *room_of(scene, free, bounds), symmetric)


def cycle_of(orbit):
    """The `Cycle` of an orbit, without empty rows, times since phase 0."""
    impacts, scene = orbit.impacts, orbit.scene
    span = orbit.periods * 2.0 * np.pi / float(scene.frequency)
    late = np.mod(np.asarray(impacts.time) + float(orbit.state.phase) / float(scene.frequency), span)
    order = np.argsort(late)
    rows = (jnp.asarray(np.asarray(each, float)[order]) for each in (late, impacts.speed, impacts.side))
    return Cycle(*rows, jnp.zeros(()), jnp.asarray(float(orbit.periods)))


def directions_of(size, count, seed):
    """Unit vectors, (count, size): the axes both ways, then random ones."""
    axes = np.concatenate([np.eye(size), -np.eye(size)])
    more = np.random.default_rng(seed).normal(size=(count - len(axes), size))
    return np.concatenate([axes, more / np.linalg.norm(more, axis=1, keepdims=True)])


def _ends(tree, cycle, numbers, space, ways, reach):
    """(the `Ray`s, NumPy's, how long each way is): to the reach, or to where a bound is."""
    with np.errstate(divide="ignore", invalid="ignore"):
        room = np.where(ways > 0, space.high / ways, np.where(ways < 0, space.low / ways, np.inf))
    lengths = np.minimum(reach, np.nan_to_num(room, nan=0.0, posinf=np.inf).min(axis=1))
    found = rays(tree, cycle, numbers, (lengths[:, None] * ways) @ space.units)
    return jax.device_get(found), lengths


def _starts(tree, cycle, numbers, space, ways, lengths, ends, kinds):
    """(`PointEquations`, unknowns, offset) where to look for the nearest points from: of each kind and touched wall the
    nearest ends of ways."""
    found, taken = [], {}
    for k in np.argsort(ends.share * lengths):
        if ends.end[k] == RayEnd.NONE or lengths[k] == 0:
            continue
        offset = ends.share[k] * lengths[k] * ways[k]
        end = type(ends)(*(each[k] for each in ends))
        kind, point, unknowns = point_at(tree, cycle, numbers + offset @ space.units, end)
        key = kind, point.grazes and int(point.cycle.sides[0])
        if kind not in kinds or taken.get(key, 0) == MOST or not offset.any():
            continue
        taken[key] = taken.get(key, 0) + 1
        unknowns[point.size] = np.linalg.norm(offset)
        found.append((point, unknowns, offset))
    return found


def _foot(numbers, space, point, unknowns, offset):
    """(the `Foot` within the bounds, which numbers are at one) on a boundary, or its `Edge`; None where Newton's method
    leads to none."""
    held = np.zeros(len(offset), bool)
    if point.kind == "SB":
        held = space.symmetric == 0
    find = nearest_on if isinstance(point, Edge) else nearest
    fixed, bound = np.where(held, 0.0, np.nan), np.zeros(len(offset), bool)
    while not held.all():
        base = numbers + np.where(held, fixed, 0.0) @ space.units
        found = find(point, unknowns, base, space.units[~held], offset[~held])
        if found is None or found.status == SolutionStatus.NONE:
            return None
        offset = np.where(held, fixed, 0.0)
        offset[~held] = found.offset
        out = np.where(held, 0.0, np.maximum(offset - space.high, space.low - offset))
        place = int(np.argmax(out))
        if out[place] <= ROUNDING * (1.0 + abs(offset[place])):
            return found._replace(offset=np.clip(offset, space.low, space.high)), bound
        limit = space.high[place] if offset[place] > space.high[place] else space.low[place]
        held[place], fixed[place], bound[place] = True, limit, True
        if isinstance(point, Edge):
            unknowns, offset[place] = found.unknowns, limit
            continue
        unknowns, offset = _brought(found, numbers, space, offset, place, limit, held)
        if unknowns is None:
            return None
    return None


def _edges(numbers, space, starts, feet):
    """[(`Foot`, which numbers are at a bound)] where no nearest point was found, none of a real orbit, or one that
    is farther than where it was looked for from."""
    found, tried = [], []
    for (point, unknowns, offset), here in zip(starts, feet, strict=True):
        foot = None if here is None else here[0]
        if foot is not None and foot.status == SolutionStatus.VIRTUAL:
            guesses, offset = edges_of(point, foot.unknowns, numbers + foot.offset @ space.units), foot.offset
        elif point.kind == "SN" and (foot is None or foot.distance > (1.0 + SLACK) * np.linalg.norm(offset)):
            guesses = [cusp(point, unknowns, numbers + offset @ space.units)]
        else:
            continue
        for edge, plain in guesses:
            key = edge.kind, edge.end, int(edge.row), int(edge.wall)
            if any(key == other and np.linalg.norm(offset - there) < NEAR for other, there in tried):
                continue
            tried.append((key, offset))
            found.append(_foot(numbers, space, edge, plain, offset))
    return found


def _brought(foot, numbers, space, offset, place, limit, held):
    """(unknowns, offset) on the boundary where one number is at its bound; None where there is none."""
    rest = np.where(held, 0.0, offset)
    size = np.linalg.norm(rest)
    if size == 0:
        return None, offset
    direction = rest / size @ space.units
    start = np.array(foot.unknowns)
    start[foot.point.size] = size
    begin = numbers + np.where(held, offset, 0.0) @ space.units
    offset = np.array(offset)
    offset[place] = limit
    end = numbers + np.where(held, offset, 0.0) @ space.units
    found, seen = jax.device_get(solved(foot.point, start, begin, end[None], direction))
    if found.status[0] in (SolutionStatus.NONE, SolutionStatus.JUMPED):
        return None, offset
    return seen[0], np.where(held, offset, rest / size * found.value[0])


def _near(orbit, tree, cycle, numbers, space, foot, bound):
    """The `NearPoint` of a `Foot`, None where its orbit is none."""
    if foot.status == SolutionStatus.VIRTUAL or (foot.bends <= 0).any():
        return None
    way = jax.device_get(rays(tree, cycle, numbers, (1.0 + SLACK) * (foot.offset @ space.units)[None]))
    status = REACHED if way.share[0] * (1.0 + SLACK) >= 1.0 - SLACK else BEHIND
    if status == REACHED and way.end[0] == RayEnd.NONE and not _is_tip(foot, way):
        return None  # a boundary of another orbit
    names, scene, changes = space.names, orbit.scene, foot.offset * abs(space.units).max(axis=1)
    values = [float(scene.parameter(name)) + change for name, change in zip(names, changes, strict=True)]
    ends = (domain(scene, name) for name in names)
    values = [min(max(value, low), high) for value, (low, high) in zip(values, ends, strict=True)]  # a rounding beyond
    scene = scene.replace(**dict(zip(names, values, strict=True)))
    there = foot.point.cycle_at(jnp.asarray(foot.unknowns))
    return NearPoint(
        kind=foot.point.kind,
        distance=foot.distance,
        change=dict(zip(names, map(float, changes), strict=True)),
        direction=dict(zip(names, map(float, foot.offset / foot.distance), strict=True)),
        scene=scene,
        times=np.asarray(there.times),
        speeds=np.asarray(there.speeds),
        sides=tuple(int(side) for side in np.asarray(there.sides)),
        residual=foot.residual,
        slope=foot.slope,
        status=status,
        at_bound=tuple(name for name, is_held in zip(names, bound, strict=True) if is_held),
        edge=foot.point.end if isinstance(foot.point, Edge) else "",
    )


def _is_tip(foot, way):
    """Whether a way that went on led through a cusp, by the orbit just after it."""
    if not isinstance(foot.point, Edge) or foot.point.end != CUSP:
        return False
    there = foot.unknowns[: foot.point.point.size]
    return bool(abs(way.unknowns[0] - there).max() <= APART * (1.0 + abs(there).max()))


def _distinct(found):
    kept = []
    for one in found:
        apart = [
            np.linalg.norm([(one.change[n] - other.change[n]) for n in one.change])
            for other in kept
            if other.kind == one.kind
        ]
        if min(apart, default=np.inf) > ALIKE * (1.0 + one.distance):
            kept.append(one)
    return kept
