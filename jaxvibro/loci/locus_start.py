"""Set up the start of a locus: the special point as plain numbers, its equations, and the settings."""

from typing import NamedTuple

import numpy as np

from continuation.arclength import StepControl
from continuation.computation_limits import UNLIMITED
from continuation.event_search import take_step, unit_tangent
from continuation.intermediate_points import make_start_point

from ..branches.branch import Special
from ..branches.follow import MIN_STEP, check_follow_settings
from ..orbits.impact_equations import ImpactSequence
from ..problem import soft_wall_grazing, sticking_limits
from ..problem.branches_from_grazing import make_padded_sequence
from ..problem.grazing_contact import GRAZING_TOLERANCE, GrazingContact, arclength_weights, find_grazing_contacts
from ..problem.orbit_equations import are_releases, continuation_problem, mark_impact_rows, sides_with_release_codes
from ..problem.orbit_point import OrbitPoint, is_own_mirror_image, set_up_equations
from ..scene import check
from ..scene.scene import Scene
from ..scene.scene_parameters import (
    check_parameter_bounds,
    common_parameter_value,
    flatten_names,
    mark_parameters,
    parameter_domain,
)
from ..scene.symmetry import stays_symmetric
from ..scene.typical_scales import typical_length
from .locus_equations import GrazingEquations, SingularEquations
from .locus_tracking import LocusDirection, LocusSettings
from .sticking_limit_equations import StickingLimitEquations

KINDS = "SN", "PD", "SB", "GR"  # kinds that `follow_loci` continues by default
STICKING_KINDS = "CH", "RL"  # limits of a sticking phase; a CH that ends a branch has no locus


class LocusStart(NamedTuple):
    """Special point at which a locus starts, as plain numbers.

    Attributes
    ----------
    kind : str
        Kind of the point.
    name : str
        Parameter whose value is ``orbit_row.value``.
    scene : Scene
        Scene at the point.
    orbit_row : OrbitPoint
        Orbit at the point.
    """

    kind: str
    name: str
    scene: Scene
    orbit_row: OrbitPoint

    @property
    def grazing_contacts(self) -> list[GrazingContact]:
        """`GrazingContact` records of the orbit."""
        problem, z = set_up_equations(self.scene, self.name, self.orbit_row)
        return find_grazing_contacts(problem, z, typical_length(self.scene))


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
    settings = make_locus_settings(locus_start.scene, names, bounds, first_step, largest_step, tolerance, limits)
    return [
        _direction_from_point(problem, z, settings)
        for problem, z in problems_at_locus_start(locus_start, settings.names)
    ]


def make_locus_settings(scene, names, bounds, first_step, largest_step, tolerance, limits=UNLIMITED):
    """Check the arguments of a locus and make its `LocusSettings`, without arclength weights. Raises ArgumentError."""
    names = check_parameter_pair(scene, names)
    if not isinstance(bounds, dict) or set(bounds) != set(names):
        raise check.ArgumentError("bounds", f"must give (low, high) for {names[0]} and for {names[1]}, by name", bounds)
    bounds = {name: check_parameter_bounds(scene, name, bounds[name]) for name in names}
    step_settings = check_follow_settings(first_step, largest_step, tolerance, (), ())
    parameter_domains = [parameter_domain(scene, name) for name in names]
    bounds_in_domains = [
        (max(lower, domain_lower), min(upper, domain_upper))
        for (lower, upper), (domain_lower, domain_upper) in zip(bounds.values(), parameter_domains, strict=True)
    ]
    domain_end_values = tuple(
        tuple(value for value in domain_bounds if value not in bounds[name])
        for domain_bounds, name in zip(parameter_domains, names, strict=True)
    )
    step_control_values = [
        np.float64(value)
        for value in (min(MIN_STEP, first_step), largest_step, step_settings["tolerance"], *bounds_in_domains[1])
    ]
    step_control, initial_step = StepControl(np.ones(1), *step_control_values), min(first_step, largest_step)
    return LocusSettings(
        step_control,
        initial_step,
        names,
        bounds,
        tuple(bounds_in_domains),
        domain_end_values,
        typical_length(scene),
        limits,
    )


def with_arclength_weights(problem, z, locus_settings):
    """Return the `LocusSettings` with the arclength weights of a locus that starts at z."""
    weights = arclength_weights(problem, locus_settings.scene_length)
    for k, name in enumerate(locus_settings.names, -2):
        if name.endswith(".stiffness"):  # it varies over orders of magnitude
            weights[k] = 1.0 / (1.0 + abs(z[k]))
    return locus_settings._replace(control=locus_settings.control._replace(scale=weights))


def _direction_from_point(problem, z, locus_settings):
    """Return the `LocusDirection` from z towards greater values of the second parameter."""
    locus_settings = with_arclength_weights(problem, z, locus_settings)
    tangent_vector = unit_tangent(continuation_problem(problem), z, locus_settings.control.scale, problem)
    return LocusDirection(
        problem,
        make_start_point(_correct_point(problem, z, tangent_vector, locus_settings.control), tangent_vector),
        locus_settings,
    )


def reverse_direction(locus_direction):
    """Reverse a `LocusDirection`."""
    return locus_direction._replace(start=make_start_point(locus_direction.start.z, -locus_direction.start.tangent))


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

    Returns a list of (equations, z). The list has one entry, or at a GR one entry for each grazing contact, in which
    the other contacts are omitted. The equations are `GrazingEquations`, `SingularEquations` or
    `StickingLimitEquations`. Raises ArgumentError if none of these describes the point."""
    scene, orbit_row = locus_start.scene, locus_start.orbit_row
    if locus_start.kind != "GR" and not len(orbit_row.times):
        rule = "must belong to an orbit with impacts; without impacts only a GR has derivatives and a locus"
        raise check.ArgumentError("special", rule, f"{locus_start.kind} without impacts")
    impact_entries = _impacts_and_contacts(locus_start)
    values = [common_parameter_value(scene, name) for name in names]
    marked_scene, parameter_marks = mark_parameters(scene, *names)
    use_half_orbit = orbit_stays_symmetric(locus_start, names)
    if locus_start.kind == "SB" and not use_half_orbit:
        raise check.ArgumentError("names", "must keep the scene symmetric, as an SB requires", names)
    use_half_orbit = use_half_orbit and not (use_whole_orbit and locus_start.kind != "SB")
    closure_sign, periods = (-1.0, 0.5 * orbit_row.periods) if use_half_orbit else (1.0, float(orbit_row.periods))
    if use_half_orbit:
        impact_entries = impact_entries[: len(impact_entries) // 2]
    empty_column = np.zeros(0)
    sequence_scalars = (np.asarray(item) for item in (0.0, periods, closure_sign))
    problem_template = SingularEquations(
        marked_scene,
        parameter_marks,
        ImpactSequence(empty_column, empty_column, empty_column, *sequence_scalars),
        np.asarray(1.0),
    )
    if locus_start.kind in STICKING_KINDS:
        return [_sticking_limit_problem(problem_template, impact_entries, values, locus_start.kind)]
    if locus_start.kind != "GR":
        multiplier = 1.0 if locus_start.kind == "SN" else -1.0
        return [_singular_problem(problem_template._replace(multiplier=np.asarray(multiplier)), impact_entries, values)]
    slack = GRAZING_TOLERANCE * typical_length(scene)
    grazing_indices = [
        k for k, (_, speed, side) in enumerate(impact_entries) if speed <= slack and not are_releases(side)
    ]
    if not grazing_indices:
        raise check.ArgumentError("special", "must touch a wall", locus_start.orbit_row.value)
    impact_lists = (
        [impact for k, impact in enumerate(impact_entries) if k == grazing_index or k not in grazing_indices]
        for grazing_index in grazing_indices
    )
    return [_grazing_problem(problem_template, item, values, slack) for item in impact_lists]


def _singular_problem(problem_template, impact_entries, values):
    """Return (`SingularEquations`, z) with these impacts."""
    sequence = make_padded_sequence(problem_template, impact_entries)
    return problem_template._replace(sequence=sequence), np.concatenate([sequence.times, sequence.speeds, values])


def _sticking_limit_problem(problem_template, impact_entries, values, kind):
    """Return (`StickingLimitEquations`, z) with these impacts; mark the row whose sticking phase is at its limit."""
    is_release, slack = kind == "RL", GRAZING_TOLERANCE * typical_length(problem_template.scene)
    sequence = make_padded_sequence(problem_template, impact_entries)
    z = np.concatenate([sequence.times, sequence.speeds, values])
    problem = StickingLimitEquations(
        problem_template.scene,
        problem_template.parameter_marks,
        sequence,
        np.zeros(len(sequence.sides)),
        np.asarray(float(is_release)),
        np.asarray(slack),
    )
    problem.special_row_mask[
        np.argmin(
            abs((sticking_limits.min_contact_forces if is_release else sticking_limits.excess_speeds)(problem, z))
        )
    ] = 1.0
    return problem, z


def _grazing_problem(problem_template, impact_entries, values, slack):
    """Return (`GrazingEquations`, z) with these impacts, one of which has zero speed."""
    sequence = make_padded_sequence(problem_template, impact_entries)
    special_row_mask = np.where(mark_impact_rows(sequence) & (sequence.speeds <= slack), 1.0, 0.0)
    z = np.concatenate([sequence.times, sequence.speeds, values])
    if soft_wall_grazing.is_smooth_soft_wall(problem_template.scene, sequence.sides[np.argmax(special_row_mask)]):
        sequence = sequence._replace(grazing=special_row_mask)
    return GrazingEquations(
        problem_template.scene, problem_template.parameter_marks, sequence, special_row_mask, np.asarray(slack)
    ), z


def _impacts_and_contacts(locus_start):
    """Return (time, speed, side) of each impact and grazing contact in order of time.

    The times are shifted so that the first is within the first drive period.
    """
    orbit_row = locus_start.orbit_row
    impact_contact_entries = [
        ((k, 0.0), contact)
        for k, contact in enumerate(zip(orbit_row.times, orbit_row.speeds, orbit_row.sides, strict=True))
    ]
    if locus_start.kind == "GR":
        for contact in locus_start.grazing_contacts:
            if not contact.is_impact:
                row_time = orbit_row.times[contact.row] if len(orbit_row.times) else 0.0
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
    times, speeds, sides = np.array(impact_entries).T
    orbit_row = locus_start.orbit_row._replace(times=times, speeds=speeds, sides=sides)
    return is_own_mirror_image(locus_start.scene, orbit_row)


def whole_orbit_impacts(problem, zs):
    """Return (times, speeds, sides, periods) of the whole orbits at points of a curve.

    `zs` has shape (points, unknowns). Times and speeds have shape (points, impacts), sides have shape (impacts,). If
    the equations represent one half of a symmetric orbit, the mirror image completes the orbit.
    """
    n_rows, n_impacts = len(problem.sequence.sides), int(np.sum(problem.sequence.sides != 0))
    times, speeds, sides = (
        zs[:, :n_impacts],
        zs[:, n_rows : n_rows + n_impacts],
        sides_with_release_codes(problem.sequence)[:n_impacts],
    )
    periods = float(problem.sequence.periods)
    if float(problem.sequence.closure_sign) < 0:
        half_duration = periods * 2.0 * np.pi / _drive_frequencies(problem, zs)
        times, speeds, sides = (
            np.hstack([times, times + half_duration]),
            np.hstack([speeds] * 2),
            np.append(sides, -sides),
        )
        periods *= 2
    return times, speeds, sides, int(periods)


def _drive_frequencies(problem, zs):
    """Return the drive frequencies, (points, 1), or a float if the frequency is not a parameter of the curve."""
    parameter_index = int(problem.parameter_marks.frequency)
    return (
        zs[:, [2 * len(problem.sequence.sides) + parameter_index - 1]]
        if parameter_index
        else float(problem.scene.frequency)
    )


def _correct_point(problem, z, tangent_vector, step_control):
    """Return z after Newton's method, or z itself if it does not converge."""
    solution = take_step(continuation_problem(problem), make_start_point(z, tangent_vector), 0.0, step_control, problem)
    return solution.z if solution.converged else z
