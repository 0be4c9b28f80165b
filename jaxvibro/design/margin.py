"""Find the nearest bifurcations of an orbit in the space of several parameters of its scene: `margin`."""

from collections.abc import Mapping, Sequence
from itertools import takewhile
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from continuation.branch_segment import EXPIRED_REASON, make_limits

from ..orbits.impact_equations import ImpactSequence
from ..orbits.orbit import Orbit, OrbitError
from ..scene import check
from ..scene.scene_parameters import parameter_domain
from ..scene.scene_properties import stays_symmetric
from ..scene.state import SolutionStatus
from .free_parameters import FreeParameters, SceneSpace, bounds_of_changes, check_free_parameters
from .located import solve_points
from .margin_result import BEHIND, REACHED, Margin, NearPoint
from .nearest_boundary import (
    CUSP,
    BoundaryEdge,
    find_crossed_edges,
    find_nearest_edge_point,
    find_nearest_point,
    make_cusp_edge,
)
from .parameter_rays import (
    RayEnd,
    RayResult,
    equations_at_ray_end,
    follow_rays,
    impact_sequence_of,
    sample_unit_directions,
)

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


class _MarginProblem(NamedTuple):
    """Orbit and the scenes that the free parameters of its scene span.

    Attributes
    ----------
    sequence : ImpactSequence
        Impacts of the orbit.
    parameters : FreeParameters
        Free parameters of the scene.
    space : SceneSpace
        Scenes that they span.
    """

    sequence: ImpactSequence
    parameters: FreeParameters
    space: SceneSpace

    def follow_rays(self, offsets: Float[np.ndarray, "rays free"]) -> RayResult:
        """Continue the orbit along rays to scenes at offsets, in units."""
        return jax.device_get(
            follow_rays(self.space.treedef, self.sequence, self.space.scene_vector, offsets @ self.space.unit_changes)
        )


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
    if not orbit.impacts.count:
        check.require_spring(orbit.scene, "margin of an orbit without impacts")
    if orbit.unknowns == "state" and orbit.impacts.count:
        raise OrbitError("the orbit sticks to a wall or chatters", orbit.residual, "separate impacts are required")
    parameter_units, kinds = check_free_parameters(orbit.scene, free), check.make_name_tuple("kinds", kinds)
    if not set(kinds) <= set(KINDS) or not kinds:
        raise check.ArgumentError("kinds", f"must be one or more of {', '.join(KINDS)}", kinds)
    n_directions = check.check_whole_number("directions", directions, 2 * len(parameter_units))
    change_bounds = bounds_of_changes(orbit.scene, parameter_units, bounds or {})
    parameters = FreeParameters(orbit.scene, parameter_units, *change_bounds)
    problem = _MarginProblem(impact_sequence_of(orbit), parameters, parameters.scene_space())
    unit_directions = sample_unit_directions(len(parameter_units), n_directions, seed)
    for radius in SEARCH_RADII:
        search_starts = _find_search_starts(problem, unit_directions, radius, kinds)
        if search_starts or limits.expired:
            break
    near_points, stop_reason = _find_near_points(problem, search_starts, limits)
    nearest_by_kind = [
        next((near_point for near_point in near_points if near_point.kind == kind), None) for kind in kinds
    ]
    points = sorted(
        (near_point for near_point in nearest_by_kind if near_point), key=lambda near_point: near_point.distance
    )
    further_points = tuple(near_point for near_point in near_points if near_point not in points)
    return Margin(orbit, parameter_units, tuple(points), further_points, (radius, n_directions), stop_reason)


def _find_near_points(problem, search_starts, limits):
    """Find the nearest points from all starts within the time limit.

    Returns the distinct `NearPoint` records, those that the orbit reaches first and the others after them, each group
    by distance, and the reason why the search is incomplete, or an empty string.
    """
    nearest_results = [
        _find_nearest_in_bounds(problem, *search_start)
        for search_start in takewhile(lambda start: not limits.expired, search_starts)
    ]
    stop_reason = ""
    if len(nearest_results) < len(search_starts) or limits.expired:
        stop_reason = f"{EXPIRED_REASON}: {len(nearest_results)} of {len(search_starts)} nearest points computed"
    else:
        nearest_results += _find_nearest_on_edges(problem, search_starts, nearest_results)
    near_points = [_make_near_point(problem, *result) for result in nearest_results if result is not None]
    near_points = [near_point for near_point in near_points if near_point is not None]
    near_points.sort(key=lambda near_point: (near_point.status == BEHIND, near_point.distance))
    return _drop_duplicate_points(near_points), stop_reason


def _find_search_starts(problem, unit_directions, radius, kinds):
    """Continue the orbit along rays up to the radius or a bound.

    Returns (`SpecialPointEquations`, unknowns, offset) of the nearest ray ends of each kind and grazed wall.
    """
    lower, upper = problem.parameters.lower, problem.parameters.upper
    with np.errstate(divide="ignore", invalid="ignore"):
        distances_to_bounds = np.where(
            unit_directions > 0,
            upper / unit_directions,
            np.where(unit_directions < 0, lower / unit_directions, np.inf),
        )
    ray_limits = np.minimum(radius, np.nan_to_num(distances_to_bounds, nan=0.0, posinf=np.inf).min(axis=1))
    rays = problem.follow_rays(ray_limits[:, None] * unit_directions)
    search_starts, n_starts_by_key = [], {}
    for ray_index in np.argsort(rays.fraction * ray_limits):
        if rays.end[ray_index] == RayEnd.NONE or ray_limits[ray_index] == 0:
            continue
        offset = rays.fraction[ray_index] * ray_limits[ray_index] * unit_directions[ray_index]
        ray = type(rays)(*(field_values[ray_index] for field_values in rays))
        kind, equations, unknowns = equations_at_ray_end(
            problem.space.treedef, problem.sequence, problem.space.vector_after(offset), ray
        )
        start_key = kind, equations.is_grazing and int(equations.sequence.sides[0])
        if kind not in kinds or n_starts_by_key.get(start_key, 0) == MAX_STARTS or not offset.any():
            continue
        n_starts_by_key[start_key] = n_starts_by_key.get(start_key, 0) + 1
        unknowns[equations.n_orbit_unknowns] = np.linalg.norm(offset)
        search_starts.append((equations, unknowns, offset))
    return search_starts


def _find_nearest_in_bounds(problem, equations, unknowns, offset):
    """Find the nearest point of a boundary or edge within the bounds of the free parameters.

    Returns (`NearestBoundaryPoint`, mask of the parameters at a bound), or None if Newton's method fails.
    """
    lower, upper = problem.parameters.lower, problem.parameters.upper
    is_fixed, is_at_bound = np.zeros(len(offset), bool), np.zeros(len(offset), bool)
    if equations.kind == "SB":
        scene = problem.parameters.scene
        is_fixed = np.array([not stays_symmetric(scene, name) for name in problem.parameters.names])
    find_unbounded_nearest = find_nearest_edge_point if isinstance(equations, BoundaryEdge) else find_nearest_point
    fixed_offset = np.where(is_fixed, 0.0, np.nan)
    while not is_fixed.all():
        nearest_point = find_unbounded_nearest(
            equations,
            unknowns,
            problem.space.vector_after(np.where(is_fixed, fixed_offset, 0.0)),
            problem.space.unit_changes[~is_fixed],
            offset[~is_fixed],
        )
        if nearest_point is None or nearest_point.status == SolutionStatus.NONE:
            return None
        offset = np.where(is_fixed, fixed_offset, 0.0)
        offset[~is_fixed] = nearest_point.offset
        bound_excess = np.where(is_fixed, 0.0, np.maximum(offset - upper, lower - offset))
        worst_index = int(np.argmax(bound_excess))
        if bound_excess[worst_index] <= BOUND_TOLERANCE * (1.0 + abs(offset[worst_index])):
            return nearest_point._replace(offset=np.clip(offset, lower, upper)), is_at_bound
        bound_value = np.clip(offset, lower, upper)[worst_index]
        is_fixed[worst_index], fixed_offset[worst_index], is_at_bound[worst_index] = True, bound_value, True
        if isinstance(equations, BoundaryEdge):
            unknowns, offset[worst_index] = nearest_point.unknowns, bound_value
            continue
        unknowns, offset = _move_to_bound(problem.space, nearest_point, offset, worst_index, bound_value, is_fixed)
        if unknowns is None:
            return None
    return None


def _find_nearest_on_edges(problem, search_starts, nearest_results):
    """Find the nearest points on edges, for starts whose nearest point on the boundary is unsuitable.

    The nearest point is unsuitable if its orbit is inadmissible. At an SN it is also unsuitable if Newton's method
    failed or if the point is farther than the start. Returns a list of results of `_find_nearest_in_bounds`.
    """
    edge_results, earlier_attempts = [], []
    for (equations, unknowns, offset), nearest_result in zip(search_starts, nearest_results, strict=True):
        nearest_point = None if nearest_result is None else nearest_result[0]
        if nearest_point is not None and nearest_point.status == SolutionStatus.VIRTUAL:
            offset = nearest_point.offset
            edge_guesses = find_crossed_edges(equations, nearest_point.unknowns, problem.space.vector_after(offset))
        elif equations.kind == "SN" and (
            nearest_point is None or nearest_point.distance > (1.0 + RAY_TOLERANCE) * np.linalg.norm(offset)
        ):
            edge_guesses = [make_cusp_edge(equations, unknowns, problem.space.vector_after(offset))]
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
            edge_results.append(_find_nearest_in_bounds(problem, edge, edge_unknowns, offset))
    return edge_results


def _move_to_bound(space, nearest_point, offset, bound_index, bound_value, is_fixed):
    """Return (unknowns, offset) on the boundary with one parameter at its bound; unknowns are None on failure."""
    free_offset = np.where(is_fixed, 0.0, offset)
    free_distance = np.linalg.norm(free_offset)
    if free_distance == 0:
        return None, offset
    scene_direction = free_offset / free_distance @ space.unit_changes
    start_unknowns = np.array(nearest_point.unknowns)
    start_unknowns[nearest_point.equations.n_orbit_unknowns] = free_distance
    start_scene_vector = space.vector_after(np.where(is_fixed, offset, 0.0))
    offset = np.array(offset)
    offset[bound_index] = bound_value
    end_scene_vector = space.vector_after(np.where(is_fixed, offset, 0.0))
    located_points, solution_unknowns = jax.device_get(
        solve_points(
            nearest_point.equations, start_unknowns, start_scene_vector, end_scene_vector[None], scene_direction
        )
    )
    if located_points.status[0] in (SolutionStatus.NONE, SolutionStatus.JUMPED):
        return None, offset
    return solution_unknowns[0], np.where(is_fixed, offset, free_offset / free_distance * located_points.value[0])


def _make_near_point(problem, nearest_point, is_at_bound):
    """Make the `NearPoint` of a `NearestBoundaryPoint`.

    Returns None if the orbit at the point is inadmissible, if the distance has no minimum there, or if the boundary is
    that of another orbit.
    """
    if nearest_point.status == SolutionStatus.VIRTUAL or (nearest_point.curvatures <= 0).any():
        return None
    parameters, offset = problem.parameters, nearest_point.offset
    ray = problem.follow_rays((1.0 + RAY_TOLERANCE) * offset[None])
    status = REACHED if ray.fraction[0] * (1.0 + RAY_TOLERANCE) >= 1.0 - RAY_TOLERANCE else BEHIND
    if status == REACHED and ray.end[0] == RayEnd.NONE and not _is_ray_near_cusp(nearest_point, ray):
        return None  # a boundary of another orbit: no event ends the ray
    domains = {name: parameter_domain(parameters.scene, name) for name in parameters.names}
    # Rounding may exceed a domain.
    values = {
        name: min(max(value, domains[name][0]), domains[name][1])
        for name, value in parameters.values_after(offset).items()
    }
    point_sequence = nearest_point.equations.sequence_at(jnp.asarray(nearest_point.unknowns))
    return NearPoint(
        kind=nearest_point.equations.kind,
        distance=nearest_point.distance,
        change=parameters.changes_by_name(offset),
        direction=dict(zip(parameters.names, map(float, offset / nearest_point.distance), strict=True)),
        scene=parameters.scene.replace(**values),
        times=np.asarray(point_sequence.times),
        speeds=np.asarray(point_sequence.speeds),
        sides=tuple(int(side) for side in np.asarray(point_sequence.sides)),
        residual=nearest_point.residual,
        slope=nearest_point.slope,
        status=status,
        at_bound=parameters.select_names(is_at_bound),
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
