"""Find the nearest bifurcations of an orbit in the space of several parameters of its scene: `margin`."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import takewhile
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from continuation.limits import EXPIRED_REASON, limits_of

from ..orbits.impact_equations import ImpactSequence
from ..orbits.orbit import Orbit, OrbitError
from ..output.table_text import align_columns, column_header
from ..output.units import unit_in_system, unit_of
from ..scene import check
from ..scene.codes import SolutionStatus
from ..scene.parameters import parameter_domain
from ..scene.scene import Scene
from ..scene.symmetry import stays_symmetric
from .edge import CUSP, BoundaryEdge, find_edges, make_cusp
from .free_parameters import allowed_changes, check_units
from .located_point import solve_points
from .nearest_edge import find_nearest_edge_point
from .nearest_point import find_nearest_point
from .point_equations import complete_scene, parameter_mask
from .ray_end_equations import equations_at_ray_end
from .rays import RayEnd, follow_rays

KINDS = ("SN", "PD", "SB", "GR")
SEARCH_RADII = 1.0, 4.0, 16.0, 64.0, 256.0  # in units, tried in turn until a boundary is found
MAX_STARTS = 4  # starts of each kind, and of each wall of a grazing
BOUND_TOLERANCE = 1e-12  # relative to 1 + |change|: a parameter closer to its bound is at it
DISTINCT_TOLERANCE = 1e-6  # relative to 1 + distance: points closer than this coincide
RAY_TOLERANCE = 4.0 / 1024.0  # relative accuracy of the end of a ray
EDGE_TOLERANCE = 1e-3  # in units: starts of the same edge closer than this coincide
# Relative to 1 + the largest unknown: largest change of an orbit that has just passed a cusp. The change is of order
# `RAY_TOLERANCE` to the power 1/3.
MAX_TIP_CHANGE = 0.3
REACHED, BEHIND = "reached", "behind another"


@dataclass(frozen=True, eq=False)
class NearPoint:
    """Bifurcation near a scene.

    Attributes
    ----------
    kind : {"SN", "PD", "SB", "GR"}
        Kind of the bifurcation.
    distance : float
        Distance from the scene, in units of the free parameters.
    change : dict of str to float
        Change of each free parameter.
    direction : dict of str to float
        Unit vector that points to the bifurcation, in units of the free parameters.
    scene : Scene
        Scene at the bifurcation.
    times : numpy.ndarray
        Times of the impacts of the orbit; at an SB of one half of the orbit. Array of shape (impacts,).
    speeds : numpy.ndarray
        Speeds before these impacts. Array of shape (impacts,).
    sides : tuple of int
        Side of each of these impacts, -1 left, 1 right.
    residual : float
        Largest residual of the equations.
    slope : float
        Slope of the distance perpendicular to the direction, 0 at a minimum.
    status : {"reached", "behind another"}
        ``"reached"`` if the orbit was continued along the straight path to the point and meets no other bifurcation
        before. ``"behind another"`` if another bifurcation comes before.
    at_bound : tuple of str
        Names of the free parameters that are at a bound.
    edge : {"", "a touch", "an impact without speed", "a cusp"}
        Condition that ends the sheet of bifurcations at the point, or an empty string.

    Examples
    --------
    >>> near = jv.margin(orbit, {"amplitude": 0.1, "frequency": 0.1}, directions=8).points[0]
    >>> near.kind, round(near.distance, 4), near.status
    ('SB', 5.6116, 'reached')
    """

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
    """Bifurcations near an orbit.

    Made by `margin`.

    Attributes
    ----------
    orbit : Orbit
        Orbit at the centre.
    free : dict of str to float
        Unit of each free parameter.
    points : tuple of NearPoint
        Nearest bifurcation of each kind, sorted by distance.
    others : tuple of NearPoint
        Further bifurcations, including those behind another.
    searched : tuple
        Distance in units up to which the orbit was continued, and the number of directions.
    stopped : str
        Reason why the search is incomplete, or an empty string. A nearer bifurcation may then be missing.

    Examples
    --------
    >>> near = jv.margin(orbit, {"amplitude": 0.1, "frequency": 0.1}, directions=8)
    >>> round(near.distance, 4), near.searched
    (5.6116, (16.0, 8))
    """

    orbit: Orbit
    free: dict[str, float]
    points: tuple[NearPoint, ...]
    others: tuple[NearPoint, ...]
    searched: tuple[float, int]
    stopped: str = ""

    @property
    def distance(self) -> float:
        """Distance to the nearest bifurcation, in units of the free parameters; infinite if there is none."""
        return self.points[0].distance if self.points else np.inf

    def table(self, units: str = "scene") -> str:
        """Format the nearest bifurcations as text.

        Parameters
        ----------
        units : {"scene", "physical"}, optional
            Units of the values. Physical units (Hz, N, mm) require a scene with scales.

        Returns
        -------
        str
            Table with one line per bifurcation, followed by the units and the extent of the search.

        Raises
        ------
        ArgumentError
            If `units` is unknown, or if physical units are requested of a scene without scales.
        """
        column_units = {name: unit_in_system(self.orbit.scene, unit_of(name), units) for name in self.free}

        def format_values(scene):
            return (f"{unit_size * float(scene.parameter(name)):.9g}" for name, (_, unit_size) in column_units.items())

        rows = [
            (
                "kind",
                "distance",
                *(column_header(name, unit, units) for name, (unit, _) in column_units.items()),
                "status",
            )
        ]
        for near_point in self.points:
            status = near_point.status + (
                f", at a bound of {', '.join(near_point.at_bound)}" if near_point.at_bound else ""
            )
            status += f", ends there in {near_point.edge}" if near_point.edge else ""
            rows.append((near_point.kind, f"{near_point.distance:.9g}", *format_values(near_point.scene), status))
        rows.append((self.orbit.label, "0", *format_values(self.orbit.scene), "the orbit itself"))
        unit_text = ", ".join(f"{name} {column_units[name][1] * unit_step:g}" for name, unit_step in self.free.items())
        radius, n_directions = self.searched
        search_text = f"followed to a distance of {radius:g} in {n_directions} directions"
        return "\n".join(
            [align_columns(rows), f"units: {unit_text}", search_text, *([self.stopped] if self.stopped else [])]
        )


class _ParameterSpace(NamedTuple):
    """Space of the free parameters.

    Attributes
    ----------
    names : tuple of str
        Names of the free parameters.
    unit_vectors : numpy.ndarray
        Change of the numbers of the scene for one unit of each free parameter. Array of shape (free, numbers).
    lower, upper : numpy.ndarray
        Bounds of the change in units. Arrays of shape (free,).
    keeps_symmetry : numpy.ndarray
        1 for free parameters that keep a symmetric scene symmetric, else 0. Array of shape (free,).
    """

    names: tuple[str, ...]
    unit_vectors: Float[np.ndarray, "free numbers"]
    lower: Float[np.ndarray, " free"]
    upper: Float[np.ndarray, " free"]
    keeps_symmetry: Float[np.ndarray, " free"]


@check.host_only("use the function that located gives")
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
    """Find the nearest bifurcation of each kind in the space of several parameters.

    Parameters
    ----------
    orbit : Orbit
        Stable or unstable orbit with separate impacts or without impacts.
    free : dict of str to float
        Free parameters, each with its unit. The distance is the root of the sum of squares of change / unit.
    bounds : dict of str to sequence of float, optional
        Lower and upper bound of free parameters, by name. By default their domains.
    kinds : str or sequence of str, optional
        Kinds of bifurcation: ``"SN"``, ``"PD"``, ``"SB"``, ``"GR"``.
    directions : int, optional
        Number of directions in which the orbit is continued: the axes and random directions. At least twice the number
        of free parameters.
    seed : int, optional
        Seed of the random directions.
    max_seconds : float, optional
        Wall-clock time in s after which the search stops. By default the time is unlimited. The attribute ``stopped``
        then states that the search is incomplete.

    Returns
    -------
    Margin
        The nearest bifurcations.

    Raises
    ------
    ArgumentError
        If a free parameter is not a parameter of the scene, if a unit is not a positive number, if `bounds` does not
        contain the scene, or if another argument is invalid.
    OrbitError
        If the orbit sticks to a wall or chatters.

    See Also
    --------
    find_attractors : Find other motions of the scene.
    search : Find bifurcations in a box of scenes without an initial orbit.

    Notes
    -----
    The orbit is continued in each direction until a bifurcation ends it. From these ends, Newton's method solves the
    Karush-Kuhn-Tucker conditions of the nearest point, with multipliers for the bounds. An SB is located among the free
    parameters that keep the scene symmetric.

    The margin is that of the given orbit. Another motion may attract most initial states before (`find_attractors`).
    The search proves nothing about directions in which the orbit was not continued (``searched``).

    Examples
    --------
    >>> near = jv.margin(orbit, {"amplitude": 0.1, "frequency": 0.1}, directions=8)
    >>> [point.kind for point in near.points]
    ['SB', 'SN']
    """
    limits = limits_of(None, max_seconds, None, check.ArgumentError)
    if not isinstance(orbit, Orbit):
        raise check.ArgumentError("orbit", "must be an Orbit, as find_orbit gives it", orbit)
    if not orbit.impacts.count:
        check.require_spring(orbit.scene, "margin of an orbit without impacts")
    if orbit.unknowns == "state" and orbit.impacts.count:
        raise OrbitError("the orbit sticks to a wall or chatters", orbit.residual, "separate impacts are required")
    units, kinds = check_units(orbit.scene, free), check.name_tuple("kinds", kinds)
    if not set(kinds) <= set(KINDS) or not kinds:
        raise check.ArgumentError("kinds", f"must be one or more of {', '.join(KINDS)}", kinds)
    n_directions = check.whole_number("directions", directions, 2 * len(units))
    space, sequence = _make_space(orbit.scene, units, bounds or {}), impact_sequence_of(orbit)
    scene = complete_scene(orbit.scene)
    scene_vector, treedef = np.stack([np.asarray(leaf) for leaf in jax.tree.leaves(scene)]), jax.tree.structure(scene)
    unit_directions = sample_directions(len(units), n_directions, seed)
    for radius in SEARCH_RADII:
        ray_results, ray_lengths = _follow_directions(treedef, sequence, scene_vector, space, unit_directions, radius)
        starts = _select_starts(
            treedef, sequence, scene_vector, space, unit_directions, ray_lengths, ray_results, kinds
        )
        if starts or limits.expired:
            break
    nearest_points = [
        _find_nearest(scene_vector, space, *start) for start in takewhile(lambda start: not limits.expired, starts)
    ]
    is_incomplete = len(nearest_points) < len(starts) or limits.expired
    stop_reason = (
        f"{EXPIRED_REASON}: {len(nearest_points)} of {len(starts)} nearest points computed" if is_incomplete else ""
    )
    nearest_points += [] if is_incomplete else _find_on_edges(scene_vector, space, starts, nearest_points)
    near_points = [
        _make_near_point(orbit, treedef, sequence, scene_vector, space, *nearest_point)
        for nearest_point in nearest_points
        if nearest_point is not None
    ]
    near_points = _drop_duplicates(
        sorted(
            (near_point for near_point in near_points if near_point),
            key=lambda near_point: (near_point.status == BEHIND, near_point.distance),
        )
    )
    nearest_by_kind = [
        next((near_point for near_point in near_points if near_point.kind == kind), None) for kind in kinds
    ]
    points = sorted(
        (near_point for near_point in nearest_by_kind if near_point), key=lambda near_point: near_point.distance
    )
    other_points = tuple(near_point for near_point in near_points if near_point not in points)
    return Margin(orbit, units, tuple(points), other_points, (radius, n_directions), stop_reason)


def _make_space(scene, free, bounds):
    unit_vectors = np.stack([parameter_mask(scene, name) * unit for name, unit in free.items()])
    keeps_symmetry = np.array([float(stays_symmetric(scene, name)) for name in free])
    return _ParameterSpace(tuple(free), unit_vectors, *allowed_changes(scene, free, bounds), keeps_symmetry)


def impact_sequence_of(orbit):
    """Return the `ImpactSequence` of an orbit without empty rows, with times since phase 0."""
    impacts, scene = orbit.impacts, orbit.scene
    duration = orbit.periods * 2.0 * np.pi / float(scene.frequency)
    times = np.mod(np.asarray(impacts.time) + float(orbit.state.phase) / float(scene.frequency), duration)
    order = np.argsort(times)
    columns = (jnp.asarray(np.asarray(column, float)[order]) for column in (times, impacts.speed, impacts.side))
    return ImpactSequence(*columns, jnp.zeros(()), jnp.asarray(float(orbit.periods)))


def sample_directions(n_params, n_directions, seed):
    """Return unit vectors of shape (directions, parameters): the axes in both senses, then random ones."""
    axes = np.concatenate([np.eye(n_params), -np.eye(n_params)])
    random_vectors = np.random.default_rng(seed).normal(size=(n_directions - len(axes), n_params))
    return np.concatenate([axes, random_vectors / np.linalg.norm(random_vectors, axis=1, keepdims=True)])


def _follow_directions(treedef, sequence, scene_vector, space, directions, radius):
    """Continue the orbit along rays up to the radius or a bound; return the `Ray` records and the ray lengths."""
    with np.errstate(divide="ignore", invalid="ignore"):
        bound_distances = np.where(
            directions > 0, space.upper / directions, np.where(directions < 0, space.lower / directions, np.inf)
        )
    ray_lengths = np.minimum(radius, np.nan_to_num(bound_distances, nan=0.0, posinf=np.inf).min(axis=1))
    ray_results = follow_rays(treedef, sequence, scene_vector, (ray_lengths[:, None] * directions) @ space.unit_vectors)
    return jax.device_get(ray_results), ray_lengths


def _select_starts(treedef, sequence, scene_vector, space, directions, ray_lengths, ray_results, kinds):
    """Select the nearest ray ends of each kind and touched wall as (`PointEquations`, unknowns, offset)."""
    starts, n_taken = [], {}
    for k in np.argsort(ray_results.fraction * ray_lengths):
        if ray_results.end[k] == RayEnd.NONE or ray_lengths[k] == 0:
            continue
        offset = ray_results.fraction[k] * ray_lengths[k] * directions[k]
        ray_result = type(ray_results)(*(component[k] for component in ray_results))
        kind, equations, unknowns = equations_at_ray_end(
            treedef, sequence, scene_vector + offset @ space.unit_vectors, ray_result
        )
        key = kind, equations.is_grazing and int(equations.sequence.sides[0])
        if kind not in kinds or n_taken.get(key, 0) == MAX_STARTS or not offset.any():
            continue
        n_taken[key] = n_taken.get(key, 0) + 1
        unknowns[equations.n_orbit_unknowns] = np.linalg.norm(offset)
        starts.append((equations, unknowns, offset))
    return starts


def _find_nearest(scene_vector, space, equations, unknowns, offset):
    """Find the nearest point of a boundary or edge within the bounds.

    Returns the `NearestBoundaryPoint` and a mask of the parameters at a bound, or None if Newton's method fails.
    """
    is_fixed = np.zeros(len(offset), bool)
    if equations.kind == "SB":
        is_fixed = space.keeps_symmetry == 0
    find_nearest = find_nearest_edge_point if isinstance(equations, BoundaryEdge) else find_nearest_point
    fixed_offset, is_bounded = np.where(is_fixed, 0.0, np.nan), np.zeros(len(offset), bool)
    while not is_fixed.all():
        base_vector = scene_vector + np.where(is_fixed, fixed_offset, 0.0) @ space.unit_vectors
        nearest_point = find_nearest(equations, unknowns, base_vector, space.unit_vectors[~is_fixed], offset[~is_fixed])
        if nearest_point is None or nearest_point.status == SolutionStatus.NONE:
            return None
        offset = np.where(is_fixed, fixed_offset, 0.0)
        offset[~is_fixed] = nearest_point.offset
        excess = np.where(is_fixed, 0.0, np.maximum(offset - space.upper, space.lower - offset))
        worst_index = int(np.argmax(excess))
        if excess[worst_index] <= BOUND_TOLERANCE * (1.0 + abs(offset[worst_index])):
            return nearest_point._replace(offset=np.clip(offset, space.lower, space.upper)), is_bounded
        bound_value = (
            space.upper[worst_index] if offset[worst_index] > space.upper[worst_index] else space.lower[worst_index]
        )
        is_fixed[worst_index], fixed_offset[worst_index], is_bounded[worst_index] = True, bound_value, True
        if isinstance(equations, BoundaryEdge):
            unknowns, offset[worst_index] = nearest_point.unknowns, bound_value
            continue
        unknowns, offset = _move_to_bound(
            nearest_point, scene_vector, space, offset, worst_index, bound_value, is_fixed
        )
        if unknowns is None:
            return None
    return None


def _find_on_edges(scene_vector, space, starts, nearest_points):
    """Find nearest points on edges for starts whose sheet has no suitable nearest point.

    A sheet is unsuitable if Newton's method failed, if the orbit of the point is inadmissible, or if the point is
    farther than the start. Returns pairs as `_find_nearest` does.
    """
    edge_points, attempts = [], []
    for (equations, unknowns, offset), result in zip(starts, nearest_points, strict=True):
        nearest_point = None if result is None else result[0]
        if nearest_point is not None and nearest_point.status == SolutionStatus.VIRTUAL:
            edge_guesses, offset = (
                find_edges(equations, nearest_point.unknowns, scene_vector + nearest_point.offset @ space.unit_vectors),
                nearest_point.offset,
            )
        elif equations.kind == "SN" and (
            nearest_point is None or nearest_point.distance > (1.0 + RAY_TOLERANCE) * np.linalg.norm(offset)
        ):
            edge_guesses = [make_cusp(equations, unknowns, scene_vector + offset @ space.unit_vectors)]
        else:
            continue
        for edge, orbit_unknowns in edge_guesses:
            key = edge.kind, edge.end_kind, int(edge.row), int(edge.wall)
            if any(
                key == other_key and np.linalg.norm(offset - other_offset) < EDGE_TOLERANCE
                for other_key, other_offset in attempts
            ):
                continue
            attempts.append((key, offset))
            edge_points.append(_find_nearest(scene_vector, space, edge, orbit_unknowns, offset))
    return edge_points


def _move_to_bound(nearest_point, scene_vector, space, offset, bound_index, bound_value, is_fixed):
    """Return (unknowns, offset) on the boundary with one parameter at its bound; unknowns may be None."""
    free_offset = np.where(is_fixed, 0.0, offset)
    free_distance = np.linalg.norm(free_offset)
    if free_distance == 0:
        return None, offset
    direction = free_offset / free_distance @ space.unit_vectors
    start_unknowns = np.array(nearest_point.unknowns)
    start_unknowns[nearest_point.equations.n_orbit_unknowns] = free_distance
    start_vector = scene_vector + np.where(is_fixed, offset, 0.0) @ space.unit_vectors
    offset = np.array(offset)
    offset[bound_index] = bound_value
    end_vector = scene_vector + np.where(is_fixed, offset, 0.0) @ space.unit_vectors
    located_points, solution_unknowns = jax.device_get(
        solve_points(nearest_point.equations, start_unknowns, start_vector, end_vector[None], direction)
    )
    if located_points.status[0] in (SolutionStatus.NONE, SolutionStatus.JUMPED):
        return None, offset
    return solution_unknowns[0], np.where(is_fixed, offset, free_offset / free_distance * located_points.value[0])


def _make_near_point(orbit, treedef, sequence, scene_vector, space, nearest_point, is_bounded):
    """Make the `NearPoint` of a `NearestBoundaryPoint`, or None if it is not a bifurcation of the orbit."""
    if nearest_point.status == SolutionStatus.VIRTUAL or (nearest_point.curvatures <= 0).any():
        return None
    ray_result = jax.device_get(
        follow_rays(
            treedef, sequence, scene_vector, (1.0 + RAY_TOLERANCE) * (nearest_point.offset @ space.unit_vectors)[None]
        )
    )
    status = REACHED if ray_result.fraction[0] * (1.0 + RAY_TOLERANCE) >= 1.0 - RAY_TOLERANCE else BEHIND
    if status == REACHED and ray_result.end[0] == RayEnd.NONE and not _passes_cusp(nearest_point, ray_result):
        return None  # a boundary of another orbit: no event ends the ray
    names, scene, changes = space.names, orbit.scene, nearest_point.offset * abs(space.unit_vectors).max(axis=1)
    values = [float(scene.parameter(name)) + change for name, change in zip(names, changes, strict=True)]
    domains = (parameter_domain(scene, name) for name in names)
    # Rounding may exceed a domain.
    values = [min(max(value, lower), upper) for value, (lower, upper) in zip(values, domains, strict=True)]
    scene = scene.replace(**dict(zip(names, values, strict=True)))
    point_sequence = nearest_point.equations.sequence_at(jnp.asarray(nearest_point.unknowns))
    return NearPoint(
        kind=nearest_point.equations.kind,
        distance=nearest_point.distance,
        change=dict(zip(names, map(float, changes), strict=True)),
        direction=dict(zip(names, map(float, nearest_point.offset / nearest_point.distance), strict=True)),
        scene=scene,
        times=np.asarray(point_sequence.times),
        speeds=np.asarray(point_sequence.speeds),
        sides=tuple(int(side) for side in np.asarray(point_sequence.sides)),
        residual=nearest_point.residual,
        slope=nearest_point.slope,
        status=status,
        at_bound=tuple(name for name, is_at_bound in zip(names, is_bounded, strict=True) if is_at_bound),
        edge=nearest_point.equations.end_kind if isinstance(nearest_point.equations, BoundaryEdge) else "",
    )


def _passes_cusp(nearest_point, ray_result):
    """Check whether a continued ray passed a cusp, by the orbit just beyond it."""
    if not isinstance(nearest_point.equations, BoundaryEdge) or nearest_point.equations.end_kind != CUSP:
        return False
    orbit_unknowns = nearest_point.unknowns[: nearest_point.equations.equations.n_orbit_unknowns]
    return bool(
        abs(ray_result.unknowns[0] - orbit_unknowns).max() <= MAX_TIP_CHANGE * (1.0 + abs(orbit_unknowns).max())
    )


def _drop_duplicates(near_points):
    distinct_points = []
    for near_point in near_points:
        distances = [
            np.linalg.norm([(near_point.change[name] - distinct_point.change[name]) for name in near_point.change])
            for distinct_point in distinct_points
            if distinct_point.kind == near_point.kind
        ]
        if min(distances, default=np.inf) > DISTINCT_TOLERANCE * (1.0 + near_point.distance):
            distinct_points.append(near_point)
    return distinct_points
