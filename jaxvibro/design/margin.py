"""Find the nearest bifurcations of an orbit in the space of several parameters of its scene: `margin`."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import takewhile
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from continuation.computation_limits import EXPIRED_REASON, make_limits

from ..orbits.orbit import Orbit, OrbitError
from ..output.table_text import align_columns, column_header
from ..output.units import unit_in_system, unit_of
from ..scene import check
from ..scene.codes import SolutionStatus
from ..scene.scene import Scene
from ..scene.scene_parameters import parameter_domain
from ..scene.symmetry import stays_symmetric
from .boundary_edge import CUSP, BoundaryEdge, find_crossed_edges, make_cusp_edge
from .free_parameter_checks import bounds_of_changes, check_free_parameters
from .located_point import solve_points
from .nearest_boundary_edge import find_nearest_edge_point
from .nearest_boundary_point import find_nearest_point
from .parameter_rays import RayEnd, follow_rays, impact_sequence_of, sample_unit_directions
from .ray_end_equations import equations_at_ray_end
from .special_point_equations import complete_scene, parameter_mask

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
        Times of the impacts of the orbit; at an SB, of the impacts of one half of the orbit. Array of shape (impacts,).
    speeds : numpy.ndarray
        Speeds before these impacts. Array of shape (impacts,).
    sides : tuple of int
        Side of each of these impacts, -1 left, 1 right.
    residual : float
        Largest residual of the equations.
    slope : float
        Largest derivative of the distance perpendicular to the direction, or at an edge the residual of the optimality
        condition; 0 at a minimum.
    status : {"reached", "behind another"}
        ``"reached"`` if the orbit was continued along the straight path to the point without another bifurcation.
        ``"behind another"`` if another bifurcation lies on this path.
    at_bound : tuple of str
        Names of the free parameters that are at a bound.
    edge : {"", "a touch", "an impact without speed", "a cusp"}
        Condition that ends the boundary at the point, or an empty string if the boundary does not end there.

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
        Nearest bifurcation of each kind with the status ``"reached"``, sorted by distance. If a kind has no such
        bifurcation, the nearest one behind another.
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

        def format_parameters(scene):
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
            rows.append((near_point.kind, f"{near_point.distance:.9g}", *format_parameters(near_point.scene), status))
        rows.append((self.orbit.label, "0", *format_parameters(self.orbit.scene), "the orbit itself"))
        units_text = ", ".join(f"{name} {column_units[name][1] * unit_step:g}" for name, unit_step in self.free.items())
        radius, n_directions = self.searched
        search_text = f"followed to a distance of {radius:g} in {n_directions} directions"
        return "\n".join(
            [align_columns(rows), f"units: {units_text}", search_text, *([self.stopped] if self.stopped else [])]
        )


class _FreeParameterSpace(NamedTuple):
    """Space of the free parameters.

    Attributes
    ----------
    names : tuple of str
        Names of the free parameters.
    unit_changes : numpy.ndarray
        Change of the numbers of the scene for one unit of each free parameter. Array of shape (free, numbers).
    lower, upper : numpy.ndarray
        Bounds of the change in units. Arrays of shape (free,).
    keeps_symmetry : numpy.ndarray
        1 for free parameters that keep a symmetric scene symmetric, else 0. Array of shape (free,).
    """

    names: tuple[str, ...]
    unit_changes: Float[np.ndarray, "free numbers"]
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
        Wall-clock time in s after which the search stops. The attribute ``stopped`` then states that the search is
        incomplete. By default the time is unlimited.

    Returns
    -------
    Margin
        The nearest bifurcations.

    Raises
    ------
    ArgumentError
        If a free parameter is not a parameter of the scene, if a unit is not a positive number, if `bounds` does not
        contain the values of the scene, or if another argument is invalid.
    OrbitError
        If the orbit sticks to a wall or chatters.

    See Also
    --------
    find_attractors : Find other motions of the scene.
    search : Find bifurcations in a box of scenes without an initial orbit.

    Notes
    -----
    The orbit is continued in each direction up to a bifurcation. From these bifurcations, Newton's method solves the
    Karush-Kuhn-Tucker conditions of the nearest point, with multipliers for the bounds. An SB is located in the
    subspace of the free parameters that keep the scene symmetric.

    The margin refers to the given orbit. Within the margin, another attractor may still attract most initial states
    (`find_attractors`). The search may miss bifurcations between the directions of continuation (``searched``).

    Examples
    --------
    >>> near = jv.margin(orbit, {"amplitude": 0.1, "frequency": 0.1}, directions=8)
    >>> [point.kind for point in near.points]
    ['SB', 'SN']
    """
    limits = make_limits(None, max_seconds, None, check.ArgumentError)
    if not isinstance(orbit, Orbit):
        raise check.ArgumentError("orbit", "must be an Orbit, as find_orbit gives it", orbit)
    if not orbit.impacts.count:
        check.require_spring(orbit.scene, "margin of an orbit without impacts")
    if orbit.unknowns == "state" and orbit.impacts.count:
        raise OrbitError("the orbit sticks to a wall or chatters", orbit.residual, "separate impacts are required")
    parameter_units, kinds = check_free_parameters(orbit.scene, free), check.make_name_tuple("kinds", kinds)
    if not set(kinds) <= set(KINDS) or not kinds:
        raise check.ArgumentError("kinds", f"must be one or more of {', '.join(KINDS)}", kinds)
    n_directions = check.check_whole_number("directions", directions, 2 * len(parameter_units))
    parameter_space, sequence = (
        _make_parameter_space(orbit.scene, parameter_units, bounds or {}),
        impact_sequence_of(orbit),
    )
    scene = complete_scene(orbit.scene)
    scene_vector, scene_treedef = (
        np.stack([np.asarray(leaf) for leaf in jax.tree.leaves(scene)]),
        jax.tree.structure(scene),
    )
    unit_directions = sample_unit_directions(len(parameter_units), n_directions, seed)
    for radius in SEARCH_RADII:
        rays, ray_limits = _follow_rays_to_limit(
            scene_treedef, sequence, scene_vector, parameter_space, unit_directions, radius
        )
        search_starts = _select_search_starts(
            scene_treedef, sequence, scene_vector, parameter_space, unit_directions, ray_limits, rays, kinds
        )
        if search_starts or limits.expired:
            break
    nearest_results = [
        _find_nearest_in_bounds(scene_vector, parameter_space, *search_start)
        for search_start in takewhile(lambda start: not limits.expired, search_starts)
    ]
    is_incomplete = len(nearest_results) < len(search_starts) or limits.expired
    stop_reason = (
        f"{EXPIRED_REASON}: {len(nearest_results)} of {len(search_starts)} nearest points computed"
        if is_incomplete
        else ""
    )
    nearest_results += (
        [] if is_incomplete else _find_nearest_on_edges(scene_vector, parameter_space, search_starts, nearest_results)
    )
    near_points = [
        _make_near_point(orbit, scene_treedef, sequence, scene_vector, parameter_space, *nearest_result)
        for nearest_result in nearest_results
        if nearest_result is not None
    ]
    near_points = _drop_duplicate_points(
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
    further_points = tuple(near_point for near_point in near_points if near_point not in points)
    return Margin(orbit, parameter_units, tuple(points), further_points, (radius, n_directions), stop_reason)


def _make_parameter_space(scene, parameter_units, bounds):
    unit_changes = np.stack([parameter_mask(scene, name) * unit for name, unit in parameter_units.items()])
    keeps_symmetry = np.array([float(stays_symmetric(scene, name)) for name in parameter_units])
    return _FreeParameterSpace(
        tuple(parameter_units), unit_changes, *bounds_of_changes(scene, parameter_units, bounds), keeps_symmetry
    )


def _follow_rays_to_limit(scene_treedef, sequence, scene_vector, parameter_space, unit_directions, radius):
    """Continue the orbit along rays up to the radius or a bound; return the `RayResult` records and the ray lengths."""
    with np.errstate(divide="ignore", invalid="ignore"):
        distances_to_bounds = np.where(
            unit_directions > 0,
            parameter_space.upper / unit_directions,
            np.where(unit_directions < 0, parameter_space.lower / unit_directions, np.inf),
        )
    ray_limits = np.minimum(radius, np.nan_to_num(distances_to_bounds, nan=0.0, posinf=np.inf).min(axis=1))
    rays = follow_rays(
        scene_treedef, sequence, scene_vector, (ray_limits[:, None] * unit_directions) @ parameter_space.unit_changes
    )
    return jax.device_get(rays), ray_limits


def _select_search_starts(
    scene_treedef, sequence, scene_vector, parameter_space, unit_directions, ray_limits, rays, kinds
):
    """Return (`SpecialPointEquations`, unknowns, offset) of the nearest ray ends of each kind and grazed wall."""
    search_starts, n_starts_by_key = [], {}
    for ray_index in np.argsort(rays.fraction * ray_limits):
        if rays.end[ray_index] == RayEnd.NONE or ray_limits[ray_index] == 0:
            continue
        offset = rays.fraction[ray_index] * ray_limits[ray_index] * unit_directions[ray_index]
        ray = type(rays)(*(field_values[ray_index] for field_values in rays))
        kind, equations, unknowns = equations_at_ray_end(
            scene_treedef, sequence, scene_vector + offset @ parameter_space.unit_changes, ray
        )
        start_key = kind, equations.is_grazing and int(equations.sequence.sides[0])
        if kind not in kinds or n_starts_by_key.get(start_key, 0) == MAX_STARTS or not offset.any():
            continue
        n_starts_by_key[start_key] = n_starts_by_key.get(start_key, 0) + 1
        unknowns[equations.n_orbit_unknowns] = np.linalg.norm(offset)
        search_starts.append((equations, unknowns, offset))
    return search_starts


def _find_nearest_in_bounds(scene_vector, parameter_space, equations, unknowns, offset):
    """Find the nearest point of a boundary or edge within the bounds of the free parameters.

    Returns (`NearestBoundaryPoint`, mask of the parameters at a bound), or None if Newton's method fails.
    """
    is_fixed = np.zeros(len(offset), bool)
    if equations.kind == "SB":
        is_fixed = parameter_space.keeps_symmetry == 0
    find_unbounded_nearest = find_nearest_edge_point if isinstance(equations, BoundaryEdge) else find_nearest_point
    fixed_offset, is_at_bound = np.where(is_fixed, 0.0, np.nan), np.zeros(len(offset), bool)
    while not is_fixed.all():
        fixed_scene_vector = scene_vector + np.where(is_fixed, fixed_offset, 0.0) @ parameter_space.unit_changes
        nearest_point = find_unbounded_nearest(
            equations, unknowns, fixed_scene_vector, parameter_space.unit_changes[~is_fixed], offset[~is_fixed]
        )
        if nearest_point is None or nearest_point.status == SolutionStatus.NONE:
            return None
        offset = np.where(is_fixed, fixed_offset, 0.0)
        offset[~is_fixed] = nearest_point.offset
        bound_excess = np.where(
            is_fixed, 0.0, np.maximum(offset - parameter_space.upper, parameter_space.lower - offset)
        )
        most_exceeded_index = int(np.argmax(bound_excess))
        if bound_excess[most_exceeded_index] <= BOUND_TOLERANCE * (1.0 + abs(offset[most_exceeded_index])):
            return nearest_point._replace(
                offset=np.clip(offset, parameter_space.lower, parameter_space.upper)
            ), is_at_bound
        bound_value = (
            parameter_space.upper[most_exceeded_index]
            if offset[most_exceeded_index] > parameter_space.upper[most_exceeded_index]
            else parameter_space.lower[most_exceeded_index]
        )
        is_fixed[most_exceeded_index], fixed_offset[most_exceeded_index], is_at_bound[most_exceeded_index] = (
            True,
            bound_value,
            True,
        )
        if isinstance(equations, BoundaryEdge):
            unknowns, offset[most_exceeded_index] = nearest_point.unknowns, bound_value
            continue
        unknowns, offset = _move_to_bound(
            nearest_point, scene_vector, parameter_space, offset, most_exceeded_index, bound_value, is_fixed
        )
        if unknowns is None:
            return None
    return None


def _find_nearest_on_edges(scene_vector, parameter_space, search_starts, nearest_results):
    """Find the nearest points on edges, for starts whose nearest point on the boundary is unsuitable.

    The nearest point is unsuitable if its orbit is inadmissible. At an SN it is also unsuitable if Newton's method
    failed or if the point is farther than the start. Returns a list of results of `_find_nearest_in_bounds`.
    """
    edge_results, earlier_attempts = [], []
    for (equations, unknowns, offset), nearest_result in zip(search_starts, nearest_results, strict=True):
        nearest_point = None if nearest_result is None else nearest_result[0]
        if nearest_point is not None and nearest_point.status == SolutionStatus.VIRTUAL:
            edge_guesses, offset = (
                find_crossed_edges(
                    equations,
                    nearest_point.unknowns,
                    scene_vector + nearest_point.offset @ parameter_space.unit_changes,
                ),
                nearest_point.offset,
            )
        elif equations.kind == "SN" and (
            nearest_point is None or nearest_point.distance > (1.0 + RAY_TOLERANCE) * np.linalg.norm(offset)
        ):
            edge_guesses = [make_cusp_edge(equations, unknowns, scene_vector + offset @ parameter_space.unit_changes)]
        else:
            continue
        for edge, edge_unknowns in edge_guesses:
            edge_key = edge.kind, edge.edge_kind, int(edge.row), int(edge.wall)
            if any(
                edge_key == earlier_key and np.linalg.norm(offset - earlier_offset) < EDGE_TOLERANCE
                for earlier_key, earlier_offset in earlier_attempts
            ):
                continue
            earlier_attempts.append((edge_key, offset))
            edge_results.append(_find_nearest_in_bounds(scene_vector, parameter_space, edge, edge_unknowns, offset))
    return edge_results


def _move_to_bound(nearest_point, scene_vector, parameter_space, offset, bound_index, bound_value, is_fixed):
    """Return (unknowns, offset) on the boundary with one parameter at its bound; unknowns are None on failure."""
    free_offset = np.where(is_fixed, 0.0, offset)
    free_distance = np.linalg.norm(free_offset)
    if free_distance == 0:
        return None, offset
    scene_direction = free_offset / free_distance @ parameter_space.unit_changes
    start_unknowns = np.array(nearest_point.unknowns)
    start_unknowns[nearest_point.equations.n_orbit_unknowns] = free_distance
    start_scene_vector = scene_vector + np.where(is_fixed, offset, 0.0) @ parameter_space.unit_changes
    offset = np.array(offset)
    offset[bound_index] = bound_value
    end_scene_vector = scene_vector + np.where(is_fixed, offset, 0.0) @ parameter_space.unit_changes
    located_points, solution_unknowns = jax.device_get(
        solve_points(
            nearest_point.equations, start_unknowns, start_scene_vector, end_scene_vector[None], scene_direction
        )
    )
    if located_points.status[0] in (SolutionStatus.NONE, SolutionStatus.JUMPED):
        return None, offset
    return solution_unknowns[0], np.where(is_fixed, offset, free_offset / free_distance * located_points.value[0])


def _make_near_point(orbit, scene_treedef, sequence, scene_vector, parameter_space, nearest_point, is_at_bound):
    """Make the `NearPoint` of a `NearestBoundaryPoint`.

    Returns None if the orbit at the point is inadmissible, if the distance has no minimum there, or if the boundary is
    that of another orbit.
    """
    if nearest_point.status == SolutionStatus.VIRTUAL or (nearest_point.curvatures <= 0).any():
        return None
    ray = jax.device_get(
        follow_rays(
            scene_treedef,
            sequence,
            scene_vector,
            (1.0 + RAY_TOLERANCE) * (nearest_point.offset @ parameter_space.unit_changes)[None],
        )
    )
    status = REACHED if ray.fraction[0] * (1.0 + RAY_TOLERANCE) >= 1.0 - RAY_TOLERANCE else BEHIND
    if status == REACHED and ray.end[0] == RayEnd.NONE and not _is_ray_near_cusp(nearest_point, ray):
        return None  # a boundary of another orbit: no event ends the ray
    names, scene, parameter_changes = (
        parameter_space.names,
        orbit.scene,
        nearest_point.offset * abs(parameter_space.unit_changes).max(axis=1),
    )
    values = [float(scene.parameter(name)) + change for name, change in zip(names, parameter_changes, strict=True)]
    domains = (parameter_domain(scene, name) for name in names)
    # Rounding may exceed a domain.
    values = [min(max(value, lower), upper) for value, (lower, upper) in zip(values, domains, strict=True)]
    scene = scene.replace(**dict(zip(names, values, strict=True)))
    point_sequence = nearest_point.equations.sequence_at(jnp.asarray(nearest_point.unknowns))
    return NearPoint(
        kind=nearest_point.equations.kind,
        distance=nearest_point.distance,
        change=dict(zip(names, map(float, parameter_changes), strict=True)),
        direction=dict(zip(names, map(float, nearest_point.offset / nearest_point.distance), strict=True)),
        scene=scene,
        times=np.asarray(point_sequence.times),
        speeds=np.asarray(point_sequence.speeds),
        sides=tuple(int(side) for side in np.asarray(point_sequence.sides)),
        residual=nearest_point.residual,
        slope=nearest_point.slope,
        status=status,
        at_bound=tuple(
            name for name, is_parameter_at_bound in zip(names, is_at_bound, strict=True) if is_parameter_at_bound
        ),
        edge=nearest_point.equations.edge_kind if isinstance(nearest_point.equations, BoundaryEdge) else "",
    )


def _is_ray_near_cusp(nearest_point, ray):
    """Check that the nearest point is a cusp, and that the ray, which no event ended, passed close to the cusp."""
    if not isinstance(nearest_point.equations, BoundaryEdge) or nearest_point.equations.edge_kind != CUSP:
        return False
    orbit_unknowns = nearest_point.unknowns[: nearest_point.equations.boundary_equations.n_orbit_unknowns]
    return bool(abs(ray.unknowns[0] - orbit_unknowns).max() <= MAX_TIP_CHANGE * (1.0 + abs(orbit_unknowns).max()))


def _drop_duplicate_points(near_points):
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
