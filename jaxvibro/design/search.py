"""Find bifurcations in a box of scenes without an initial orbit: `search`.

Random states are iterated in random scenes of the box. Each orbit on which a motion settles is continued along rays
towards the zeros of the test functions of the requested kinds. A ray is parallel to the gradient of a test function
with respect to the free parameters (`evaluate_test_gradients`). A ray is 1.5 times as long as a Newton step. If a
bifurcation ends a ray, the ray has met a boundary. Otherwise the next ray starts at the end of this ray. On each
boundary, `follow` locates the special point from the ray ends that are nearest to the scene."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from continuation.branch_segment import EXPIRED_REASON, make_limits

from ..branches.branch import Special
from ..branches.follow import branch_through, check_follow_settings
from ..branches.seed_orbits import SETTLING_PERIODS, settled_orbits
from ..maps.initial_conditions import draw_initial_states
from ..maps.iterate import iterate
from ..orbits.impact_equations import ImpactSequence
from ..output.table_text import align_columns
from ..problem.orbit_problem import make_orbit_problem
from ..scene import check
from ..scene.scene import Scene
from .bifurcation_gradients import FLIP, FOLD, TOUCH, ZERO_SPEED, evaluate_test_gradients
from .free_parameters import FreeParameters, bounds_of_changes, check_free_parameters
from .parameter_rays import RayEnd, follow_rays

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
        Special point of each boundary, sorted by distance. The parameter of a point is the free parameter with the
        largest change, in its unit, along the ray that met the boundary.
    distances : tuple of float
        Distance of each point from the scene, in units of the free parameters.
    met : tuple of int
        Number of rays that ended on each boundary.
    starts : int
        Number of random scenes.
    settled : int
        Number of random scenes whose motion settles on a periodic orbit of at most `max_period` drive periods.
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
        for special_point, distance, n_rays_to_boundary in zip(self.points, self.distances, self.met, strict=True):
            itinerary_text = " ".join(itinerary_word or "." for itinerary_word in special_point.itinerary)
            value_texts = (f"{float(special_point.scene.parameter(name)):.9g}" for name in self.free)
            rows.append(
                (
                    special_point.kind,
                    special_point.label,
                    itinerary_text,
                    f"{distance:.6g}",
                    *value_texts,
                    str(n_rays_to_boundary),
                )
            )
        summary = f"{self.starts} random scenes, {self.settled} of them settled; {self.followed} rays"
        stop_lines = [self.stopped] if self.stopped else []
        return "\n".join([align_columns(rows) if self.points else "nothing found", summary, *stop_lines])


class _RayStartOrbit(NamedTuple):
    """Orbit from which a ray starts.

    Attributes
    ----------
    offset : numpy.ndarray
        Offset of the scene of the orbit, in units. Array of shape (free,).
    periods : int
        Number of drive periods.
    impacts : tuple of numpy.ndarray
        Times, speeds and sides of the impacts; x, v and no sides if the orbit has no impacts.
    """

    offset: Float[np.ndarray, " free"]
    periods: int
    impacts: tuple[Float[np.ndarray, " impacts"], ...]


class _BoundaryHit(NamedTuple):
    """End of a ray on a boundary.

    Attributes
    ----------
    kinds : tuple of str
        Possible kinds of the bifurcation.
    orbit_seed : _RayStartOrbit
        Orbit just before the end of the ray.
    displacement : numpy.ndarray
        Displacement from the start to the target of the ray, in units. Array of shape (free,).
    """

    kinds: tuple[str, ...]
    orbit_seed: _RayStartOrbit
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
        Lower and upper bound of free parameters, by name. The bounds must contain the values of the scene, and are
        required for parameters whose domain is unbounded.
    starts : int, optional
        Number of random scenes of the box, each with a random state.
    max_period : int, optional
        Largest number of drive periods of the orbits from which rays start.
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
        If the scene is a batch or under a user-defined force, or if `kinds`, `free`, `bounds` or a number is invalid.

    See Also
    --------
    margin : Find the nearest bifurcations of an orbit.
    locus : Continue a special point in two parameters.

    Notes
    -----
    The points can be passed to `located`, `locus` and `switch`. Boundaries are distinguished by kind, number of periods
    and itinerary. Boundaries of orbits on which no start settles, or that have more than 16 impacts, are missed. If no
    boundary is met, the table states the extent of the search.

    Examples
    --------
    >>> result = jv.search(scene, ("SN", "SB"), {"amplitude": 1.0}, {"amplitude": (0.5, 5.0)}, starts=32, max_period=1)
    >>> result.settled <= result.starts
    True
    """
    limits = make_limits(None, max_seconds, None, check.ArgumentError)
    check.require_single_scene(scene)
    check.require_spring(scene, "search")
    kinds = check.make_name_tuple("kinds", kinds)
    if not kinds or not set(kinds) <= set(TESTS_OF_KIND):
        raise check.ArgumentError("kinds", f"must be one or more of {', '.join(TESTS_OF_KIND)}", kinds)
    parameter_units = check_free_parameters(scene, free)
    parameters = FreeParameters(scene, parameter_units, *bounds_of_changes(scene, parameter_units, bounds))
    for name, lower, upper in zip(parameters.names, parameters.lower, parameters.upper, strict=True):
        if not np.isfinite([lower, upper]).all():
            raise check.ArgumentError(
                f"bounds.{name}", "must be given because the domain of the parameter is unbounded", None
            )
    starts = check.check_whole_number("starts", starts, 1)
    max_period = check.check_whole_number("max_period", max_period, 1, check.MAX_ORBIT_PERIODS)
    orbit_seeds = _settled_orbit_seeds(parameters, starts, max_period, check.check_whole_number("seed", seed, 0))
    boundary_hits, n_rays, is_complete = _follow_rays_from_seeds(
        parameters, _limit_per_itinerary(orbit_seeds), kinds, limits
    )
    points, distances_from_scene, ray_counts_by_boundary, n_boundaries_skipped = _locate_boundaries(
        parameters, boundary_hits, kinds, limits
    )
    stop_reason = (
        ""
        if is_complete and not n_boundaries_skipped
        else f"{EXPIRED_REASON}: {n_rays} rays followed, {n_boundaries_skipped} boundaries not located"
    )
    return Search(
        scene,
        parameter_units,
        points,
        distances_from_scene,
        ray_counts_by_boundary,
        starts,
        len(orbit_seeds),
        n_rays,
        stop_reason,
    )


def _settled_orbit_seeds(parameters, n_starts, max_period, random_seed):
    """Iterate random states in random scenes; return a `_RayStartOrbit` for each motion that settles."""
    random_fractions = np.random.default_rng(random_seed).random((n_starts, len(parameters.names)))
    offsets = parameters.lower + (parameters.upper - parameters.lower) * random_fractions
    scenes = parameters.scene_after(offsets)
    iterates = iterate(scenes, draw_initial_states(scenes, n_starts, (random_seed, 1)), SETTLING_PERIODS)
    drive_period_durations = np.broadcast_to(2.0 * np.pi / np.asarray(scenes.frequency), n_starts)
    return [
        _RayStartOrbit(offsets[lane], *orbit_fields)
        for lane, *orbit_fields in settled_orbits(iterates, drive_period_durations, max_period)
    ]


def _limit_per_itinerary(orbit_seeds):
    """Return at most `MAX_PER_ITINERARY` orbits of each itinerary, each with at most `MAX_IMPACTS` impacts."""
    itinerary_counts, remaining_seeds = {}, []
    for orbit_seed in orbit_seeds:
        itinerary_key = _itinerary_key(orbit_seed)
        itinerary_counts[itinerary_key] = itinerary_counts.get(itinerary_key, 0) + 1
        if itinerary_counts[itinerary_key] <= MAX_PER_ITINERARY and len(orbit_seed.impacts[0]) <= MAX_IMPACTS:
            remaining_seeds.append(orbit_seed)
    return remaining_seeds


def _itinerary_key(orbit_seed):
    """Return (number of periods of an orbit, lexicographically smallest cyclic permutation of its sides).

    The key is therefore independent of the choice of the first impact.
    """
    sides = tuple(int(side) for side in orbit_seed.impacts[2])
    return orbit_seed.periods, min((sides[rotation:] + sides[:rotation] for rotation in range(len(sides))), default=())


def _follow_rays_from_seeds(parameters, orbit_seeds, kinds, limits):
    """Follow rays from orbits; return (`_BoundaryHit` records, number of rays, whether all rays were followed)."""
    test_codes = sorted({test_code for kind in kinds for test_code in TESTS_OF_KIND[kind]})
    seeds_by_n_impacts, boundary_hits, n_rays = {}, [], 0
    for seed_or_hit in orbit_seeds:
        seeds_by_n_impacts.setdefault(len(seed_or_hit.impacts[0]), []).append(seed_or_hit)
    for n_impacts, orbit_seeds_of_group in seeds_by_n_impacts.items():
        seeds_and_tests = [
            (seed_or_hit, test_code)
            for seed_or_hit in orbit_seeds_of_group
            for test_code in (test_codes if n_impacts else [TOUCH])
            if test_code in test_codes
        ]
        for _ in range(MAX_STEPS):
            seeds_and_tests, new_hits, n_new_rays, is_complete = _follow_next_rays(parameters, seeds_and_tests, limits)
            boundary_hits += [seed_or_hit for seed_or_hit in new_hits if set(seed_or_hit.kinds) & set(kinds)]
            n_rays += n_new_rays
            if not is_complete:
                return boundary_hits, n_rays, False
    return boundary_hits, n_rays, True


def _follow_next_rays(parameters, seeds_and_tests, limits):
    """Follow one ray from each lane (`_RayStartOrbit`, test); all orbits have the same number of impacts.

    Returns the lanes whose rays met no boundary, the `_BoundaryHit` of each other ray, the number of rays, and whether
    all rays were followed in time.
    """
    next_seeds_and_tests, boundary_hits, n_rays = [], [], 0
    for block_start in range(0, len(seeds_and_tests), LANES):
        if limits.expired:
            return next_seeds_and_tests, boundary_hits, n_rays, False
        lane_block = seeds_and_tests[block_start : block_start + LANES]
        padded_block = lane_block + lane_block[-1:] * (LANES - len(lane_block))
        displacements, rays = _follow_rays_of_block(parameters, padded_block)
        for lane, (orbit_seed, test_code) in enumerate(lane_block):
            if not displacements[lane].any():
                continue
            n_rays += 1
            orbit_columns = np.split(rays.unknowns[lane], 2) if len(orbit_seed.impacts[0]) else orbit_seed.impacts[:2]
            ray_end_seed = _RayStartOrbit(
                orbit_seed.offset + rays.fraction[lane] * displacements[lane],
                orbit_seed.periods,
                (*orbit_columns, orbit_seed.impacts[2]),
            )
            if rays.end[lane] == RayEnd.NONE:
                next_seeds_and_tests.append((ray_end_seed, test_code))
            else:
                boundary_hits.append(
                    _BoundaryHit(KINDS_OF_RAY_END[RayEnd(int(rays.end[lane]))], ray_end_seed, displacements[lane])
                )
    return next_seeds_and_tests, boundary_hits, n_rays, True


def _follow_rays_of_block(parameters, seeds_and_tests):
    """Follow a block of lanes; return the displacements in units and the `RayResult` records."""
    space = parameters.scene_space()
    scene_offsets = np.stack([orbit_seed.offset for orbit_seed, _ in seeds_and_tests])
    impact_columns = [np.stack([orbit_seed.impacts[k] for orbit_seed, _ in seeds_and_tests]) for k in range(3)]
    periods = np.array([float(orbit_seed.periods) for orbit_seed, _ in seeds_and_tests])
    sequences, scene_vectors = (
        ImpactSequence(*impact_columns, np.zeros(len(seeds_and_tests)), periods),
        space.vector_after(scene_offsets),
    )
    lane_test_indices = np.arange(len(seeds_and_tests)), np.array([test_code for _, test_code in seeds_and_tests])
    tests_and_gradients = evaluate_test_gradients(space.treedef, sequences, scene_vectors, space.unit_changes)
    test_values, test_gradients = (lane_tests[lane_test_indices] for lane_tests in jax.device_get(tests_and_gradients))
    displacements = _newton_displacements(parameters, test_values, test_gradients, scene_offsets)
    rays = follow_rays(space.treedef, sequences, scene_vectors, displacements @ space.unit_changes)
    return displacements, jax.device_get(rays)


def _newton_displacements(parameters, test_values, test_gradients, scene_offsets):
    """Return 1.5 Newton steps towards the zero of a test function, in each lane.

    A step is truncated at the boundary of the box. A step that is not finite is replaced by 0.
    """
    with np.errstate(all="ignore"):
        displacements = (
            -STEP_FACTOR * test_values[:, None] * test_gradients / np.sum(test_gradients**2, axis=1, keepdims=True)
        )
        displacements = np.where(np.isfinite(displacements).all(axis=1, keepdims=True), displacements, 0.0)
        bound_distances = np.where(
            displacements > 0, parameters.upper - scene_offsets, parameters.lower - scene_offsets
        )
        bound_fractions = np.nan_to_num(
            np.where(displacements == 0, 1.0, bound_distances / displacements), nan=1.0, posinf=1.0
        )
    return displacements * np.clip(bound_fractions.min(axis=1, keepdims=True), 0.0, 1.0)


def _locate_boundaries(parameters, boundary_hits, kinds, limits):
    """Locate a special point on each boundary that rays met.

    Returns the `Special` points sorted by distance, their distances, the number of rays that met each boundary, and the
    number of boundaries that were not located in time.
    """
    hits_by_boundary = {}
    for hit in sorted(boundary_hits, key=lambda hit: np.linalg.norm(hit.orbit_seed.offset)):
        hits_by_boundary.setdefault((hit.kinds, *_itinerary_key(hit.orbit_seed)), []).append(hit)
    best_point_by_key, n_boundaries_skipped = {}, 0
    for hits_of_boundary in hits_by_boundary.values():
        if limits.expired:
            n_boundaries_skipped += 1
            continue
        for hit in hits_of_boundary[:MAX_ATTEMPTS]:
            special = _locate_special_point(parameters, hit, kinds)
            if special is None:
                continue
            changes_in_units = (
                (float(special.scene.parameter(name)) - float(parameters.scene.parameter(name))) / unit
                for name, unit in parameters.units.items()
            )
            distance, boundary_orbit = float(np.linalg.norm(list(changes_in_units))), special.spot
            boundary_key = (
                special.kind,
                *_itinerary_key(
                    _RayStartOrbit(
                        hit.orbit_seed.offset,
                        boundary_orbit.periods,
                        (boundary_orbit.times, boundary_orbit.speeds, boundary_orbit.sides),
                    )
                ),
            )
            previous_entry = best_point_by_key.get(boundary_key, (special, np.inf, 0))
            best_point = min((previous_entry[:2], (special, distance)), key=lambda candidate: candidate[1])
            best_point_by_key[boundary_key] = (*best_point, previous_entry[2] + len(hits_of_boundary))
            break
    sorted_entries = sorted(best_point_by_key.values(), key=lambda entry: entry[1])
    return *(tuple(hit[k] for hit in sorted_entries) for k in range(3)), n_boundaries_skipped


def _locate_special_point(parameters, hit, kinds):
    """Locate the `Special` of one of the kinds next to a `_BoundaryHit`, or return None."""
    main_parameter_index = int(np.argmax(abs(hit.displacement)))
    name, hit_scene = parameters.names[main_parameter_index], parameters.scene_after(hit.orbit_seed.offset)
    template = make_orbit_problem(hit_scene, name, periods=hit.orbit_seed.periods)
    impacts = list(zip(*hit.orbit_seed.impacts, strict=True))
    start = template.with_impacts(np.array([0.0, 0.0, float(hit_scene.parameter(name))]), impacts)
    bounds = tuple(
        float(parameters.scene.parameter(name)) + parameters.units[name] * float(change_limits[main_parameter_index])
        for change_limits in (parameters.lower, parameters.upper)
    )
    follow_direction = "forward" if hit.displacement[main_parameter_index] > 0 else "backward"
    follow_settings = check_follow_settings(**STEP_SETTINGS, stop=kinds)
    branch = branch_through(hit_scene, name, bounds, start, follow_direction, follow_settings)
    return next((special_point for special_point in branch.special if special_point.kind in kinds), None)
