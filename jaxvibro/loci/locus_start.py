"""Set up the start of a locus: the special point, its problem, and the task of the continuation."""

from typing import NamedTuple

import numpy as np

from continuation.arclength import make_control, make_start_point
from continuation.computation_limits import UNLIMITED
from continuation.continuation_loop import ContinuationTask
from continuation.event_search import unit_tangent

from ..branches.branch import Special
from ..branches.follow import check_follow_settings
from ..problem import soft_wall_grazing, sticking_limits
from ..problem.grazing_contact import GRAZING_TOLERANCE, GrazingContact, find_grazing_contacts
from ..problem.orbit_equations import are_releases, mark_impact_rows
from ..problem.orbit_point import OrbitPoint, is_own_mirror_image
from ..problem.orbit_problem import make_orbit_problem
from ..scene import check
from ..scene.scene import Scene
from ..scene.scene_parameters import (
    check_parameter_bounds,
    common_parameter_value,
    flatten_names,
    limit_bounds_to_domains,
)
from ..scene.symmetry import stays_symmetric
from .locus_equations import GrazingCondition, SingularCondition
from .locus_tracking import LocusDirection, LocusEventDetector
from .sticking_limit_equations import StickingLimitCondition

KINDS = "SN", "PD", "SB", "GR"  # kinds that `follow_loci` continues by default
STICKING_KINDS = "CH", "RL"  # limits of a sticking phase; a CH that ends a branch has no locus


class LocusStart(NamedTuple):
    """Special point at which a locus starts.

    Attributes
    ----------
    kind : str
        Kind of the point.
    name : str
        Parameter whose value is ``point.value``.
    scene : Scene
        Scene at the point.
    point : OrbitPoint
        Orbit at the point.
    """

    kind: str
    name: str
    scene: Scene
    point: OrbitPoint

    @property
    def grazing_contacts(self) -> list[GrazingContact]:
        """`GrazingContact` records of the orbit."""
        return find_grazing_contacts(self.point.problem, self.point.z)


def make_locus_start(special, kinds=KINDS):
    """Make the `LocusStart` of a `Special`.

    Raises ArgumentError if the kind of the point is not one of `kinds`, or for a CH or RL without a sticking phase.
    """
    if not isinstance(special, Special) or special.kind not in kinds:
        refused_value = special.kind if isinstance(special, Special) else special
        raise check.ArgumentError("special", f"must be a special point of kind {', '.join(kinds)}", refused_value)
    if special.kind in STICKING_KINDS and not are_releases(special.spot.sides).any():
        rule = "must have a sticking phase; a chatter that ends its branch has no locus"
        raise check.ArgumentError("special", rule, f"{special.kind} at {special.value:.12g}")
    return LocusStart(special.kind, special.name, special.scene, special.spot)


def forward_locus_directions(locus_start, names, bounds, first_step, largest_step, tolerance, limits=UNLIMITED):
    """Return the `LocusDirection` records from a `LocusStart` in two parameters.

    The list has one record, or at a GR one record for each grazing contact. Each direction is that of increasing values
    of the second parameter. Raises ArgumentError if an argument is invalid.
    """
    step_settings = first_step, largest_step, tolerance
    names, bounds = check_locus_arguments(locus_start.scene, names, bounds, *step_settings)
    directions = []
    for problem, z in problems_at_locus_start(locus_start, names):
        task = make_locus_task(locus_start.scene, problem, z, names, bounds, *step_settings, limits)
        tangent = unit_tangent(problem.equations, z, task.control.scale, problem)
        solution = problem.take_step(make_start_point(z, tangent), 0.0, task.control)
        direction = LocusDirection(task, make_start_point(z, tangent), names, bounds)
        directions.append(direction.from_point(solution.z if solution.converged else z, tangent))
    return directions


def check_locus_arguments(scene, names, bounds, *step_settings):
    """Check the arguments of a locus; return the pair of names and the bounds by name. Raises ArgumentError."""
    names = check_parameter_pair(scene, names)
    if not isinstance(bounds, dict) or set(bounds) != set(names):
        raise check.ArgumentError("bounds", f"must give (low, high) for {names[0]} and for {names[1]}, by name", bounds)
    bounds = {name: check_parameter_bounds(scene, name, bounds[name]) for name in names}
    check_follow_settings(*step_settings, (), ())
    return names, bounds


def make_locus_task(scene, problem, z, names, bounds, first_step, largest_step, tolerance, limits=UNLIMITED):
    """Make the `ContinuationTask` of a locus that starts at z."""
    bounds_in_domains, domain_ends = limit_bounds_to_domains(scene, names, bounds.values())
    weights = problem.weights()
    for k, name in enumerate(names, -2):
        if name.endswith(".stiffness"):  # it varies over orders of magnitude
            weights[k] = 1.0 / (1.0 + abs(z[k]))
    return ContinuationTask(
        problem.equations,
        problem,
        make_control(weights, first_step, largest_step, tolerance, bounds_in_domains[1]),
        min(first_step, largest_step),
        bounds_in_domains,
        domain_ends,
        LocusEventDetector(problem),
        starts=(z,),
        limits=limits,
    )


def check_parameter_pair(scene, names):
    """Check that names are two different parameters of a scene. Raises ArgumentError."""
    pair = tuple(names) if isinstance(names, tuple | list) else ()
    for name in pair:
        check.require_parameter(name, scene.names, name)
    if len(pair) != 2 or pair[0] == pair[1]:
        raise check.ArgumentError("names", "must be two different parameters of the scene", names)
    check.require_independent(*pair)
    return pair


def problems_at_locus_start(locus_start, names, use_whole_orbit=False):
    """Set up the equations and the solution z of a `LocusStart` with some parameters as unknowns.

    An entry of `names` may be a tuple of names: several numbers of the scene that share one value are then one
    parameter. With `use_whole_orbit`, a symmetric orbit is not reduced to one half, except at an SB.

    Returns a list of (`OrbitProblem`, z). The list has one entry, or at a GR one entry for each grazing contact, in
    which the other contacts are omitted. The condition is a `GrazingCondition`, a `SingularCondition` or a
    `StickingLimitCondition`. Raises ArgumentError if none of these describes the point."""
    scene, point = locus_start.scene, locus_start.point
    if locus_start.kind != "GR" and not point.problem.n_rows:
        rule = "must belong to an orbit with impacts; without impacts only a GR has derivatives and a locus"
        raise check.ArgumentError("special", rule, f"{locus_start.kind} without impacts")
    impact_entries = _impacts_and_contacts(locus_start)
    values = [common_parameter_value(scene, name) for name in names]
    use_half_orbit = orbit_stays_symmetric(locus_start, names)
    if locus_start.kind == "SB" and not use_half_orbit:
        raise check.ArgumentError("names", "must keep the scene symmetric, as an SB requires", names)
    use_half_orbit = use_half_orbit and not (use_whole_orbit and locus_start.kind != "SB")
    closure_sign, periods = (-1.0, 0.5 * point.periods) if use_half_orbit else (1.0, float(point.periods))
    if use_half_orbit:
        impact_entries = impact_entries[: len(impact_entries) // 2]
    template, z = (
        make_orbit_problem(scene, *names, periods=periods, closure_sign=closure_sign),
        np.array([0.0, 0.0, *values]),
    )
    if locus_start.kind in STICKING_KINDS:
        return [_sticking_limit_problem(*template.with_impacts(z, impact_entries), locus_start.kind)]
    if locus_start.kind != "GR":
        condition = SingularCondition(np.asarray(1.0 if locus_start.kind == "SN" else -1.0))
        problem, z = template.with_impacts(z, impact_entries)
        return [(problem._replace(condition=condition), z)]
    slack = GRAZING_TOLERANCE * template.length_scale
    grazing_indices = [
        k for k, (_, speed, side) in enumerate(impact_entries) if speed <= slack and not are_releases(side)
    ]
    if not grazing_indices:
        raise check.ArgumentError("special", "must touch a wall", point.value)
    impact_lists = (
        [impact for k, impact in enumerate(impact_entries) if k == grazing_index or k not in grazing_indices]
        for grazing_index in grazing_indices
    )
    return [_grazing_problem(*template.with_impacts(z, impacts), slack) for impacts in impact_lists]


def _sticking_limit_problem(problem, z, kind):
    """Return the problem with a `StickingLimitCondition` at the row whose sticking phase is at its limit, and z."""
    is_release = kind == "RL"
    condition = StickingLimitCondition(np.zeros(problem.n_rows), np.asarray(float(is_release)))
    problem = problem._replace(condition=condition)
    row_values_of = sticking_limits.min_contact_forces if is_release else sticking_limits.excess_speeds
    condition.row_mask[np.argmin(abs(row_values_of(problem, z)))] = 1.0
    return problem, z


def _grazing_problem(problem, z, slack):
    """Return the problem with a `GrazingCondition` at the impact of zero speed, and z."""
    sequence = problem.sequence
    row_mask = np.where(mark_impact_rows(sequence) & (sequence.speeds <= slack), 1.0, 0.0)
    if soft_wall_grazing.is_smooth_soft_wall(problem.scene, sequence.sides[np.argmax(row_mask)]):
        sequence = sequence._replace(grazing=row_mask)
    return problem._replace(sequence=sequence, condition=GrazingCondition(row_mask)), z


def _impacts_and_contacts(locus_start):
    """Return (time, speed, side) of each impact and grazing contact in order of time.

    The times are shifted so that the first is within the first drive period.
    """
    times, speeds, sides = locus_start.point.problem.impacts(locus_start.point.z)
    impact_contact_entries = [((k, 0.0), contact) for k, contact in enumerate(zip(times, speeds, sides, strict=True))]
    if locus_start.kind == "GR":
        for contact in locus_start.grazing_contacts:
            if not contact.is_impact:
                row_time = times[contact.row] if len(times) else 0.0
                impact_contact_entries.append(
                    (
                        (contact.row, contact.time_since_impact),
                        (row_time + contact.time_since_impact, 0.0, contact.side),
                    )
                )
    impact_contact_entries = [contact for _, contact in sorted(impact_contact_entries)]
    drive_period = 2.0 * np.pi / float(locus_start.scene.frequency)
    time_shift = drive_period * np.floor(impact_contact_entries[0][0] / drive_period)
    return [(time - time_shift, speed, side) for time, speed, side in impact_contact_entries]


def orbit_stays_symmetric(locus_start, names):
    """Check that an orbit is its own mirror image and that the parameters preserve the symmetry."""
    impact_entries = _impacts_and_contacts(locus_start)
    if len(impact_entries) % 2 or not stays_symmetric(locus_start.scene, *flatten_names(names)):
        return False
    return is_own_mirror_image(*locus_start.point.problem.with_impacts(locus_start.point.z, impact_entries))


def whole_orbit_impacts(problem, zs):
    """Return (times, speeds, sides, periods) of the whole orbits at points of a curve.

    `zs` has shape (points, unknowns). Times and speeds have shape (points, impacts), sides have shape (impacts,). If
    the equations represent one half of a symmetric orbit, the mirror image completes the orbit.
    """
    (times, speeds, sides), periods = problem.impacts(zs), float(problem.sequence.periods)
    if float(problem.sequence.closure_sign) < 0:
        mark = int(problem.parameter_marks.frequency)
        frequencies = zs[:, [problem.n_orbit_unknowns + mark - 1]] if mark else float(problem.scene.frequency)
        half_duration = periods * 2.0 * np.pi / frequencies
        times, speeds, sides = (
            np.hstack([times, times + half_duration]),
            np.hstack([speeds] * 2),
            np.append(sides, -sides),
        )
        periods *= 2
    return times, speeds, sides, int(periods)
