"""Find bifurcations in a box of scenes without an initial orbit: `search`.

Random scenes of the box are iterated from random states. Each orbit on which a motion settles is moved towards zeros of
the test functions of the requested kinds, along their gradients with respect to the free parameters
(`differentiate_tests`). A ray is 1.5 times the step of Newton's method. A ray that ends has met a boundary; otherwise
the next ray starts at its end. The points of each boundary that are nearest to the scene are passed to `follow`, which
locates the special point.
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
LANES = 32  # orbits per compiled call
MAX_PER_ITINERARY = 16  # largest number of orbits of one itinerary
MAX_STEPS = 4  # largest number of rays in sequence
STEP_FACTOR = 1.5  # length of a ray relative to a Newton step
MAX_IMPACTS = 16  # largest number of impacts of an orbit
MAX_ATTEMPTS = 3  # points of a boundary that are passed to `follow`
STEP_SETTINGS = {"first_step": 0.01, "largest_step": 0.05, "tolerance": 1e-10, "monitors": ()}


@dataclass(frozen=True, eq=False)
class Search:
    """Result of `search`.

    Attributes
    ----------
    scene : Scene
        Scene from which distances are measured.
    free : dict of str to float
        Unit of each free parameter.
    points : tuple of Special
        Special point of each boundary, sorted by distance. Its parameter is the free parameter that moves the orbit
        most towards the boundary.
    distances : tuple of float
        Distance of each point from the scene, in units of the free parameters.
    met : tuple of int
        Number of rays that ended on each boundary.
    starts : int
        Number of random scenes.
    settled : int
        Number of random scenes whose motion settled within `max_period` periods.
    followed : int
        Number of rays.
    stopped : str
        Reason why the search is incomplete, or an empty string.

    Examples
    --------
    >>> result = jv.search(scene, ("SN", "SB"), {"amplitude": 1.0}, {"amplitude": (0.5, 5.0)}, starts=32, max_period=1)
    >>> result.starts, result.stopped
    (32, '')
    """

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
        """Format the points and the extent of the search as text.

        Returns
        -------
        str
            Table with one line per point, followed by the number of scenes and rays.
        """
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
    """Orbit on which a random start settled: offset of its scene in units, periods, (times, speeds, sides)."""

    offset: Float[np.ndarray, " free"]
    periods: int
    impacts: tuple[Float[np.ndarray, " impacts"], ...]


class _BoundaryHit(NamedTuple):
    """End of a ray: possible kinds, orbit just before the end, displacement of the ray in units."""

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
    """Find bifurcations of the attractors in a box of scenes.

    Parameters
    ----------
    scene : Scene
        A single scene in the box.
    kinds : str or sequence of str
        Kinds of bifurcation: ``"SN"``, ``"SB"``, ``"PD"``, ``"GR"``.
    free : dict of str to float
        Free parameters, each with its unit.
    bounds : dict of str to sequence of float
        Lower and upper bound of free parameters, by name, which must contain the scene. Required for parameters whose
        domain is unbounded.
    starts : int, optional
        Number of random scenes of the box, each with a random state.
    max_period : int, optional
        Number of drive periods of the longest orbits.
    seed : int, optional
        Seed of the random scenes and states.
    max_seconds : float, optional
        Wall-clock time in s after which no further rays are followed and no further boundaries are located. By default
        the time is unlimited.

    Returns
    -------
    Search
        One special point for each boundary that was met.

    Raises
    ------
    ArgumentError
        If `kinds`, `free`, `bounds` or a number is invalid.

    See Also
    --------
    margin : Find the nearest bifurcations of an orbit.
    locus : Continue a special point in two parameters.

    Notes
    -----
    The points can be passed to `located`, `locus` and `switch`. Boundaries are distinguished by kind, number of periods
    and itinerary. Boundaries of motions on which no start settles are missed. If no boundary is met, the table states
    the extent of the search.

    Examples
    --------
    >>> result = jv.search(scene, ("SN", "SB"), {"amplitude": 1.0}, {"amplitude": (0.5, 5.0)}, starts=32, max_period=1)
    >>> result.settled <= result.starts
    True
    """
    limits = limits_of(None, max_seconds, None, check.ArgumentError)
    check.require_single(scene)
    check.require_spring(scene, "search")
    kinds = check.name_tuple("kinds", kinds)
    if not kinds or not set(kinds) <= set(TESTS_OF_KIND):
        raise check.ArgumentError("kinds", f"must be one or more of {', '.join(TESTS_OF_KIND)}", kinds)
    units = check_units(scene, free)
    change_bounds = allowed_changes(scene, units, bounds)
    for name, lower, upper in zip(units, *change_bounds, strict=True):
        if not np.isfinite([lower, upper]).all():
            raise check.ArgumentError(
                f"bounds.{name}", "must be given because the domain of the parameter is unbounded", None
            )
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
    """Shift the free parameters of a scene by an offset in units; rows of offsets give a batch."""
    values = np.asarray(offset).T
    unit_values = zip(units.items(), values, strict=True)
    return scene.replace(**{name: float(scene.parameter(name)) + unit * value for (name, unit), value in unit_values})


def _settle_starts(scene, units, change_bounds, n_starts, max_period, seed):
    """Iterate random states in random scenes; return an `_OrbitSeed` for each that settles."""
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
    """Keep at most `MAX_PER_ITINERARY` orbits of each itinerary, and none with more than `MAX_IMPACTS` impacts."""
    counts, thinned_seeds = {}, []
    for seed in seeds:
        key = _itinerary_key(seed)
        counts[key] = counts.get(key, 0) + 1
        if counts[key] <= MAX_PER_ITINERARY and len(seed.impacts[0]) <= MAX_IMPACTS:
            thinned_seeds.append(seed)
    return thinned_seeds


def _itinerary_key(seed):
    """Return the periods of an orbit and the smallest rotation of its sides, independent of the first impact."""
    sides = tuple(int(side) for side in seed.impacts[2])
    return seed.periods, min((sides[k:] + sides[:k] for k in range(len(sides))), default=())


def _follow_seeds(scene, units, change_bounds, seeds, kinds, limits=UNLIMITED):
    """Follow rays from orbits; return the `_BoundaryHit` records, the number of rays, and the completeness."""
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
    """Follow one ray from each (`_OrbitSeed`, test); all orbits have the same number of impacts.

    Returns the lanes that continue, the `_BoundaryHit` of each ray that ended, the number of rays, and whether all
    lanes were followed in time.
    """
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
    """Follow a block of lanes; return the displacements in units and the `Ray` records."""
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
    """Return the tree structure of a scene, its numbers, and their change for one unit of each free parameter."""
    full_scene = complete_scene(scene)
    unit_vectors = np.stack([parameter_mask(scene, name) * unit for name, unit in units.items()])
    return (
        jax.tree.structure(full_scene),
        np.stack([np.asarray(leaf) for leaf in jax.tree.leaves(full_scene)]),
        unit_vectors,
    )


def _newton_displacements(values, gradients, offsets, change_bounds):
    """Return 1.5 Newton steps towards the zero of each test, truncated at the box; 0 where a step is not finite."""
    with np.errstate(all="ignore"):
        displacements = -STEP_FACTOR * values[:, None] * gradients / np.sum(gradients**2, axis=1, keepdims=True)
        displacements = np.where(np.isfinite(displacements).all(axis=1, keepdims=True), displacements, 0.0)
        bound_distances = np.where(displacements > 0, change_bounds[1] - offsets, change_bounds[0] - offsets)
        fractions = np.nan_to_num(
            np.where(displacements == 0, 1.0, bound_distances / displacements), nan=1.0, posinf=1.0
        )
    return displacements * np.clip(fractions.min(axis=1, keepdims=True), 0.0, 1.0)


def _locate_boundaries(scene, units, change_bounds, boundary_hits, kinds, limits=UNLIMITED):
    """Locate the boundaries that rays met.

    Returns the `Special` points sorted by distance, their distances, the number of rays on each, and the number of
    boundaries that were not located in time.
    """
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
    """Locate the `Special` of one of the kinds next to a `_BoundaryHit`, or return None."""
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
