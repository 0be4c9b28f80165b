"""Bifurcations looked for in a box of scenes, without an orbit to begin with: `search`.

Random scenes of the box are settled from random states. What comes back is an orbit; each is taken towards where the
tests of the kinds asked for vanish, along their gradients by the free numbers (`differentiate_tests`): a step of
Newton's method and a half more, followed as a ray. A ray that ends has met a boundary; otherwise the next step begins
where it came to. Of each boundary met the places nearest to the scene are handed to `follow`, which locates the point.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from continuation.limits import EXPIRED_REASON, UNLIMITED, limits_of

from ..branches.branch import Special
from ..branches.follow import branch_through, check_settings
from ..branches.seed_orbits import SETTLING_PERIODS, settled_orbits
from ..maps.initial_conditions import draw_initial_states
from ..maps.iterate import iterate
from ..orbits.impact_equations import ImpactSequence
from ..output.table_text import align_columns
from ..problem.orbit_point import OrbitPoint, set_up_problem
from ..scene import check
from ..scene.scene import Scene
from .bifurcation_tests import FLIP, FOLD, TOUCH, ZERO_SPEED, differentiate_tests
from .free_parameters import allowed_changes, check_units
from .point_equations import complete_scene, parameter_mask
from .rays import RayEnd, follow_rays

TESTS_OF_KIND = {"SN": (FOLD,), "SB": (FOLD,), "PD": (FLIP,), "GR": (TOUCH, ZERO_SPEED)}
KINDS_OF_RAY_END = {RayEnd.FOLD: ("SN", "SB"), RayEnd.FLIP: ("PD",), RayEnd.TOUCH: ("GR",), RayEnd.ZERO_SPEED: ("GR",)}
LANES = 32  # of a compiled call
MAX_PER_ITINERARY = 16  # orbits of one itinerary that are taken on
MAX_STEPS = 4  # of steps
STEP_FACTOR = 1.5  # times the step of Newton's method, that a ray goes
MAX_IMPACTS = 16  # of an orbit
MAX_ATTEMPTS = 3  # places of a boundary that are handed to `follow`
STEP_SETTINGS = {"first_step": 0.01, "largest_step": 0.05, "tolerance": 1e-10, "monitors": ()}


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
        for special_point, distance, n_rays in zip(self.points, self.distances, self.met, strict=True):
            itinerary_text = " ".join(word or "." for word in special_point.itinerary)
            value_texts = (f"{float(special_point.scene.parameter(name)):.9g}" for name in self.free)
            rows.append(
                (special_point.kind, special_point.label, itinerary_text, f"{distance:.6g}", *value_texts, str(n_rays))
            )
        summary = f"{self.starts} random scenes, {self.settled} of them settled; {self.followed} rays"
        stop_lines = [self.stopped] if self.stopped else []
        return "\n".join([align_columns(rows) if self.points else "nothing found", summary, *stop_lines])


class _OrbitSeed(NamedTuple):
    """An orbit that a start settled on. offset: of its scene, in units; periods; impacts: times, speeds, sides."""

    offset: Float[np.ndarray, " free"]
    periods: int
    impacts: tuple[Float[np.ndarray, " impacts"], ...]


class _BoundaryHit(NamedTuple):
    """Where a ray ended. kinds: that it may be; seed: the orbit just before; displacement: the way, in units."""

    kinds: tuple[str, ...]
    seed: _OrbitSeed
    displacement: Float[np.ndarray, " free"]


@check.host_only("use the function that located gives")
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
    kinds = check.name_tuple("kinds", kinds)
    if not kinds or not set(kinds) <= set(TESTS_OF_KIND):
        raise check.ArgumentError("kinds", f"must be some of {', '.join(TESTS_OF_KIND)}", kinds)
    units = check_units(scene, free)
    change_bounds = allowed_changes(scene, units, bounds)
    for name, lower, upper in zip(units, *change_bounds, strict=True):
        if not np.isfinite([lower, upper]).all():
            raise check.ArgumentError(f"bounds.{name}", "must be given, as the number's domain has no end", None)
    starts, max_period = check.whole_number("starts", starts, 1), check.whole_number("max_period", max_period, 1)
    if max_period > check.MAX_ORBIT_PERIODS:
        raise check.ArgumentError("max_period", f"must be at most {check.MAX_ORBIT_PERIODS}", max_period)
    seeds = _settle_starts(scene, units, change_bounds, starts, max_period, check.whole_number("seed", seed, 0))
    boundary_hits, n_rays, is_complete = _follow_seeds(scene, units, change_bounds, _thin_seeds(seeds), kinds, limits)
    points, distances, ray_counts, n_unexplored = _locate_boundaries(
        scene, units, change_bounds, boundary_hits, kinds, limits
    )
    stop_reason = (
        ""
        if is_complete and not n_unexplored
        else f"{EXPIRED_REASON}: {n_rays} rays followed, {n_unexplored} boundaries not located"
    )
    return Search(scene, units, points, distances, ray_counts, starts, len(seeds), n_rays, stop_reason)


def _shift_scene(scene, units, offset):
    """The scene moved by so many units of each free number, a row each for many."""
    values = np.asarray(offset).T
    unit_values = zip(units.items(), values, strict=True)
    return scene.replace(**{name: float(scene.parameter(name)) + unit * value for (name, unit), value in unit_values})


def _settle_starts(scene, units, change_bounds, n_starts, max_period, seed):
    """The `_OrbitSeed`s of random starts in random scenes."""
    lower, upper = change_bounds
    offsets = lower + (upper - lower) * np.random.default_rng(seed).random((n_starts, len(units)))
    scenes = _shift_scene(scene, units, offsets)
    iterates = iterate(scenes, draw_initial_states(scenes, n_starts, (seed, 1)), SETTLING_PERIODS)
    period_lengths = np.broadcast_to(2.0 * np.pi / np.asarray(scenes.frequency), n_starts)
    return [
        _OrbitSeed(offsets[lane], *orbit_data)
        for lane, *orbit_data in settled_orbits(iterates, period_lengths, max_period)
    ]


def _thin_seeds(seeds):
    """At most so many of each itinerary, and none with more impacts than are followed."""
    counts, thinned_seeds = {}, []
    for seed in seeds:
        key = _itinerary_key(seed)
        counts[key] = counts.get(key, 0) + 1
        if counts[key] <= MAX_PER_ITINERARY and len(seed.impacts[0]) <= MAX_IMPACTS:
            thinned_seeds.append(seed)
    return thinned_seeds


def _itinerary_key(seed):
    """The periods of an orbit and the sides of its impacts, begun where they are least, so that any start is alike."""
    sides = tuple(int(side) for side in seed.impacts[2])
    return seed.periods, min((sides[k:] + sides[:k] for k in range(len(sides))), default=())


def _follow_seeds(scene, units, change_bounds, seeds, kinds, limits=UNLIMITED):
    """(the `_BoundaryHit`s where rays from some orbits end in one of the kinds, how many rays there were, whether the
    time was enough for all)."""
    tests = sorted({test for kind in kinds for test in TESTS_OF_KIND[kind]})
    seed_groups, boundary_hits, n_rays = {}, [], 0
    for entry in seeds:
        seed_groups.setdefault(len(entry.impacts[0]), []).append(entry)
    for n_impacts, seed_group in seed_groups.items():
        lanes = [(entry, test) for entry in seed_group for test in (tests if n_impacts else [TOUCH]) if test in tests]
        for _ in range(MAX_STEPS):
            lanes, new_hits, n_followed, is_complete = _step_lanes(scene, units, change_bounds, lanes, limits)
            boundary_hits += [entry for entry in new_hits if set(entry.kinds) & set(kinds)]
            n_rays += n_followed
            if not is_complete:
                return boundary_hits, n_rays, False
    return boundary_hits, n_rays, True


def _step_lanes(scene, units, change_bounds, lanes, limits):
    """(what is to go on, the `_BoundaryHit`s of rays that have ended, how many rays there were, whether the time was
    enough for all) of (`_OrbitSeed`, test)s; the orbits have as many impacts."""
    next_lanes, boundary_hits, n_rays = [], [], 0
    for block_start in range(0, len(lanes), LANES):
        if limits.expired:
            return next_lanes, boundary_hits, n_rays, False
        block = lanes[block_start : block_start + LANES]
        displacements, ray_results = _follow_block(
            scene, units, change_bounds, block + block[-1:] * (LANES - len(block))
        )
        for k, (seed, test) in enumerate(block):
            if not displacements[k].any():
                continue
            n_rays += 1
            orbit_columns = np.split(ray_results.unknowns[k], 2) if len(seed.impacts[0]) else seed.impacts[:2]
            new_seed = _OrbitSeed(
                seed.offset + ray_results.fraction[k] * displacements[k],
                seed.periods,
                (*orbit_columns, seed.impacts[2]),
            )
            if ray_results.end[k] == RayEnd.NONE:
                next_lanes.append((new_seed, test))
            else:
                boundary_hits.append(
                    _BoundaryHit(KINDS_OF_RAY_END[RayEnd(int(ray_results.end[k]))], new_seed, displacements[k])
                )
    return next_lanes, boundary_hits, n_rays, True


def _follow_block(scene, units, change_bounds, lanes):
    """(the ways of a block of lanes, in units, the `Ray`s along them)."""
    treedef, base_vector, unit_vectors = _flatten_scene(scene, units)
    offsets = np.stack([seed.offset for seed, _ in lanes])
    impact_columns = [np.stack([seed.impacts[k] for seed, _ in lanes]) for k in range(3)]
    periods = np.array([float(seed.periods) for seed, _ in lanes])
    sequences, scene_vectors = (
        ImpactSequence(*impact_columns, np.zeros(len(lanes)), periods),
        base_vector + offsets @ unit_vectors,
    )
    test_indices = np.arange(len(lanes)), np.array([test for _, test in lanes])
    values, gradients = (
        array[test_indices]
        for array in jax.device_get(differentiate_tests(treedef, sequences, scene_vectors, unit_vectors))
    )
    displacements = _newton_displacements(values, gradients, offsets, change_bounds)
    return displacements, jax.device_get(follow_rays(treedef, sequences, scene_vectors, displacements @ unit_vectors))


def _flatten_scene(scene, units):
    """(the tree of a scene's numbers, these, what a unit of each free number is of them)."""
    full_scene = complete_scene(scene)
    unit_vectors = np.stack([parameter_mask(scene, name) * unit for name, unit in units.items()])
    return (
        jax.tree.structure(full_scene),
        np.stack([np.asarray(leaf) for leaf in jax.tree.leaves(full_scene)]),
        unit_vectors,
    )


def _newton_displacements(values, gradients, offsets, change_bounds):
    """A step of Newton's method and a half more towards where each test vanishes, cut where it leaves the box; 0 where
    there is no such step."""
    with np.errstate(all="ignore"):
        displacements = -STEP_FACTOR * values[:, None] * gradients / np.sum(gradients**2, axis=1, keepdims=True)
        displacements = np.where(np.isfinite(displacements).all(axis=1, keepdims=True), displacements, 0.0)
        bound_distances = np.where(displacements > 0, change_bounds[1] - offsets, change_bounds[0] - offsets)
        fractions = np.nan_to_num(
            np.where(displacements == 0, 1.0, bound_distances / displacements), nan=1.0, posinf=1.0
        )
    return displacements * np.clip(fractions.min(axis=1, keepdims=True), 0.0, 1.0)


def _locate_boundaries(scene, units, change_bounds, boundary_hits, kinds, limits=UNLIMITED):
    """(`Special`s, distances, how many rays met each), the nearest first; how many boundaries the time was not enough
    for."""
    hits_by_boundary = {}
    for hit in sorted(boundary_hits, key=lambda hit: np.linalg.norm(hit.seed.offset)):
        hits_by_boundary.setdefault((hit.kinds, *_itinerary_key(hit.seed)), []).append(hit)
    best_by_key, n_unexplored = {}, 0
    for boundary_group in hits_by_boundary.values():
        if limits.expired:
            n_unexplored += 1
            continue
        for hit in boundary_group[:MAX_ATTEMPTS]:
            special = _locate_special(scene, units, change_bounds, hit, kinds)
            if special is None:
                continue
            scaled_changes = (
                (float(special.scene.parameter(name)) - float(scene.parameter(name))) / unit
                for name, unit in units.items()
            )
            distance, orbit_row = float(np.linalg.norm(list(scaled_changes))), special.spot
            key = (
                special.kind,
                *_itinerary_key(
                    _OrbitSeed(hit.seed.offset, orbit_row.periods, (orbit_row.times, orbit_row.speeds, orbit_row.sides))
                ),
            )
            previous = best_by_key.get(key, (special, np.inf, 0))
            best_point = min((previous[:2], (special, distance)), key=lambda candidate: candidate[1])
            best_by_key[key] = (*best_point, previous[2] + len(boundary_group))
            break
    ordered_points = sorted(best_by_key.values(), key=lambda entry: entry[1])
    return *(tuple(hit[k] for hit in ordered_points) for k in range(3)), n_unexplored


def _locate_special(scene, units, change_bounds, hit, kinds):
    """The `Special` of one of the kinds next to a `_BoundaryHit`, None where it is none."""
    parameter_index = int(np.argmax(abs(hit.displacement)))
    name, hit_scene = tuple(units)[parameter_index], _shift_scene(scene, units, hit.seed.offset)
    value = float(hit_scene.parameter(name))
    orbit_row = OrbitPoint(value, *hit.seed.impacts, hit.seed.periods, np.nan, np.nan, np.nan)
    bounds = tuple(
        float(scene.parameter(name)) + units[name] * float(change[parameter_index]) for change in change_bounds
    )
    follow_direction = "forward" if hit.displacement[parameter_index] > 0 else "backward"
    follow_settings = check_settings(**STEP_SETTINGS, stop=kinds)
    branch = branch_through(
        hit_scene, name, bounds, set_up_problem(hit_scene, name, orbit_row), follow_direction, follow_settings
    )
    return next((special_point for special_point in branch.special if special_point.kind in kinds), None)
