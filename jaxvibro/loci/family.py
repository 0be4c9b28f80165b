"""Continue a special point in two parameters for several values of a third parameter: `family`."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import ArrayLike, Real

from continuation.branch_segment import EXPIRED_REASON, Results, make_limits, partial_result_reason
from continuation.event_search import truncate_at_value

from ..branches.branch import Special
from ..problem.orbit_point import make_orbit_point
from ..problem.orbit_problem import make_orbit_problem
from ..scene import check
from ..scene.scene_parameters import check_parameter_values
from ..scene.scene_properties import stays_symmetric
from .grazing_switchover import opposite_directions, track_across_walls
from .locus import Locus, locus_through_orbit
from .locus_start import KINDS, STICKING_KINDS, check_parameter_pair, check_special_point, whole_orbit_impacts


@check.host_only("use strobe or monodromy")
def family(
    special: Special,
    names: Sequence[str],
    bounds: Mapping[str, tuple[float, float]],
    third: str,
    values: Real[ArrayLike, " values"] | Sequence[float],
    first_step: float = 0.02,
    largest_step: float = 0.1,
    tolerance: float = 1e-12,
    *,
    max_points: int | None = None,
    max_seconds: float | None = None,
) -> Results[Locus | None]:
    """Continue a special point in two parameters for several values of a third parameter.

    Parameters
    ----------
    special : Special
        Special point of a branch, as in `locus`.
    names : sequence of str
        Names of the two parameters, as in `locus`.
    bounds : dict of str to tuple of float
        Lower and upper bound of each of the two parameters, by name.
    third : str
        Name of a parameter of the scene that is not one of `names`.
    values : array_like
        Values of the third parameter in any order. Array of shape (n,) with n at least 1.
    first_step : float, optional
        First arclength step, as in `locus`.
    largest_step : float, optional
        Largest arclength step, as in `locus`.
    tolerance : float, optional
        Tolerance of Newton's method, as in `locus`.
    max_points : int, optional
        Largest number of points of each locus. At most half of them, rounded up, are computed forward, and the rest
        backward. By default the number is unlimited.
    max_seconds : float, optional
        Wall-clock time in s for all loci together. By default the time is unlimited.

    Returns
    -------
    tuple of Locus or None
        The locus of each value, in the order of `values`. An entry is None if the point cannot be continued to the
        value. The attribute ``stopped`` of the tuple is empty, or states how many values are complete if the time
        expired.

    Raises
    ------
    ArgumentError
        If `special` is not of kind SN, PD, SB, GR, CH or RL, or if another argument is invalid.

    See Also
    --------
    locus : Locus of a single special point.

    Notes
    -----
    The point is continued to each value along a locus in the third parameter and one of `names`: the parameter of the
    branch of the point if `names` contains this parameter, otherwise the first of `names`. The remaining parameter is
    fixed.
    If this locus passes a value several times, the crossing with the smallest arclength is used. The point does not
    reach a value if this locus ends before the value: at a bound, at a grazing, or where the point ceases to exist.

    Each locus is the one that `locus` computes from the point at that value. The loci are computed one after the other:
    if the time expires, the later ones have only their first points.

    If the time expires, the `reasons` of a locus state that the locus is incomplete. An entry may then also be None
    because the point was not continued to its value in time.

    Examples
    --------
    >>> special = branch.points("SN")[0]
    >>> bounds = {"amplitude": (0.0, 6.0), "frequency": (2.05, 2.15)}
    >>> curves = jv.family(special, ("amplitude", "frequency"), bounds, "damping", [0.05, 0.06])
    >>> [curve.kind for curve in curves]
    ['SN', 'SN']
    """
    limits = make_limits(max_points, max_seconds, None, check.ArgumentError)
    check_special_point(special, (*KINDS, *STICKING_KINDS))
    step_settings = first_step, largest_step, tolerance, limits
    names, values = (
        check_parameter_pair(special.scene, names),
        check_parameter_values(special.scene, third, values),
    )
    if third in names:
        raise check.ArgumentError("third", "must not be one of names", third)
    if special.kind == "SB" and not stays_symmetric(special.scene, third):
        raise check.ArgumentError("third", "must keep the scene symmetric, as an SB requires", third)
    # raises ArgumentError for invalid arguments
    opposite_directions(special.kind, special.scene, special.spot, names, bounds, *step_settings)
    orbits_by_value = continue_orbit_to_values(
        special, names, bounds, third, values, *step_settings[:-1], replace(limits, points=None)
    )
    is_time_expired = limits.expired
    results = [
        None
        if orbit_point is None
        else locus_through_orbit(special.kind, scene, orbit_point, names, bounds, step_settings)
        for scene, orbit_point in orbits_by_value
    ]
    n_complete = sum(
        not is_time_expired if entry is None else not any(EXPIRED_REASON in element for element in entry.reasons)
        for entry in results
    )
    return Results(
        results, "" if n_complete == len(results) else partial_result_reason(n_complete, len(results), "values")
    )


def continue_orbit_to_values(special, names, bounds, third_name, values, *step_settings):
    """Return (scene, `OrbitPoint`) of a special point at each value of a third parameter, or (None, None)."""
    free_name = special.name if special.name in names else names[0]
    start_value = float(special.scene.parameter(third_name))
    scene = special.scene.replace(**{third_name: start_value})  # A wall then has its own restitution.
    lower, upper = min(start_value, *values), max(start_value, *values)
    if lower == upper:
        return [(scene, special.spot)] * len(values)
    directions = opposite_directions(
        special.kind,
        scene,
        special.spot,
        (free_name, third_name),
        {free_name: bounds[free_name], third_name: (lower, upper)},
        *step_settings,
    )
    direction_parts = [track_across_walls(locus_direction, step_settings) for locus_direction in directions]
    return [
        (scene, special.spot)
        if value == start_value
        else _orbit_at_value(scene, direction_parts, (free_name, third_name), value)
        for value in values
    ]


def _orbit_at_value(scene, direction_parts, names, value):
    """Return (scene, `OrbitPoint`) at the first crossing of a value of the second parameter, or (None, None).

    The first crossing is the one with the smallest arclength from the start.
    """
    crossings = []
    for locus_parts in direction_parts:
        length_before = 0.0
        for locus_direction, segment in locus_parts:
            points = segment.points
            arclengths, distances_to_value = length_before + np.cumsum(points.step), points.z[:, -1] - value
            for row_index in np.flatnonzero(distances_to_value[:-1] * distances_to_value[1:] <= 0):
                fraction = distances_to_value[row_index] / (
                    (distances_to_value[row_index] - distances_to_value[row_index + 1]) or 1.0
                )
                crossings.append(
                    (
                        arclengths[row_index] + fraction * points.step[row_index + 1],
                        int(row_index),
                        points,
                        locus_direction,
                    )
                )
            length_before = arclengths[-1]
    for _, row_index, points, locus_direction in sorted(crossings, key=lambda crossing: crossing[0]):
        truncated_points, is_reached = truncate_at_value(locus_direction.task, points, row_index + 1, -1, value)
        if is_reached:
            return _orbit_of_row(
                scene,
                locus_direction.problem,
                names,
                truncated_points.z[-1],
                float(truncated_points.residual[-1]),
            )
    return None, None


def _orbit_of_row(scene, problem, names, z, residual):
    """Return (scene, `OrbitPoint`) at a point of a locus."""
    times, speeds, sides, periods = whole_orbit_impacts(problem, z[None])
    scene = scene.replace(**dict(zip(names, z[-2:].tolist(), strict=True)))
    template = make_orbit_problem(scene, names[0], periods=periods)
    impacts = list(zip(times[0], speeds[0], sides, strict=True))
    return scene, make_orbit_point(template, float(z[-2]), impacts, periods, residual=residual)
