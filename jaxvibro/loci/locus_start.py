"""Set up the start of a locus: special point as plain numbers, equations, and settings."""

from typing import NamedTuple

import numpy as np

from continuation.arclength import StepControl
from continuation.event_search import take_step, unit_tangent
from continuation.intermediate_points import start_point
from continuation.limits import UNLIMITED

from ..branches.branch import Special
from ..branches.follow import MIN_STEP, check_settings
from ..orbits.impact_equations import ImpactSequence
from ..problem import soft_grazing, sticking_limits
from ..problem.equations import are_impacts, are_releases, continuation_problem, side_codes
from ..problem.grazing import padded_sequence
from ..problem.grazing_contact import GRAZING_TOLERANCE, GrazingContact, arclength_weights, find_grazing_contacts
from ..problem.orbit_point import OrbitPoint, is_own_mirror_image, set_up_problem
from ..scene import check
from ..scene.parameters import check_bounds, common_value, flatten_names, mark_parameters, parameter_domain
from ..scene.scene import Scene
from ..scene.symmetry import stays_symmetric
from ..scene.typical_scales import scene_length
from .chatter_completion import ChatterEquations
from .extended_system import GrazingEquations, SingularEquations
from .track import LocusDirection, LocusSettings

KINDS = "SN", "PD", "SB", "GR"  # kinds that `follow_loci` continues by default
STICKING_KINDS = "CH", "RL"  # limits of a sticking phase; a CH that ends a branch has no locus


class LocusStart(NamedTuple):
    """Special point as plain numbers.

    `kind` of the point; `name` of the parameter of ``orbit_row.value``; `scene` at the point; `orbit_row`, its orbit.
    """

    kind: str
    name: str
    scene: Scene
    orbit_row: OrbitPoint

    @property
    def grazing_contacts(self) -> list[GrazingContact]:
        """`GrazingContact` records of a GR."""
        problem, z = set_up_problem(self.scene, self.name, self.orbit_row)
        return find_grazing_contacts(problem, z, scene_length(self.scene))


def make_locus_start(special, kinds=KINDS):
    """Make the `LocusStart` of a `Special` of one of the given kinds. Raises ArgumentError for other points."""
    if not isinstance(special, Special) or special.kind not in kinds:
        actual_value = special.kind if isinstance(special, Special) else special
        raise check.ArgumentError("special", f"must be a special point of kind {', '.join(kinds)}", actual_value)
    if special.kind in STICKING_KINDS and not are_releases(special.spot.sides).any():
        rule = "must have a sticking phase; a chatter that ends its branch has no locus"
        raise check.ArgumentError("special", rule, f"{special.kind} at {special.value:.12g}")
    return LocusStart(special.kind, special.name, special.scene, special.spot)


def locus_directions(start, names, bounds, first_step, largest_step, tolerance, limits=UNLIMITED):
    """Return the `LocusDirection` records from a `LocusStart` in two parameters: one, or at a GR one for each contact.

    Raises ArgumentError if an argument is invalid.
    """
    settings = locus_settings(start.scene, names, bounds, first_step, largest_step, tolerance, limits)
    return [_locus_direction(problem, z, settings) for problem, z in locus_problems(start, settings.names)]


def locus_settings(scene, names, bounds, first_step, largest_step, tolerance, limits=UNLIMITED):
    """Make the `LocusSettings` of these arguments, without arclength weights. Raises ArgumentError."""
    names = check_parameter_pair(scene, names)
    if not isinstance(bounds, dict) or set(bounds) != set(names):
        raise check.ArgumentError("bounds", f"must give (low, high) for {names[0]} and for {names[1]}, by name", bounds)
    bounds = {name: check_bounds(scene, name, bounds[name]) for name in names}
    step_settings = check_settings(first_step, largest_step, tolerance, (), ())
    domains = [parameter_domain(scene, name) for name in names]
    box = [
        (max(lower, domain_lower), min(upper, domain_upper))
        for (lower, upper), (domain_lower, domain_upper) in zip(bounds.values(), domains, strict=True)
    ]
    domain_ends = tuple(
        tuple(value for value in domain_bounds if value not in bounds[name])
        for domain_bounds, name in zip(domains, names, strict=True)
    )
    control_values = [
        np.float64(value) for value in (min(MIN_STEP, first_step), largest_step, step_settings["tolerance"], *box[1])
    ]
    control, initial_step = StepControl(np.ones(1), *control_values), min(first_step, largest_step)
    return LocusSettings(control, initial_step, names, bounds, tuple(box), domain_ends, scene_length(scene), limits)


def weight_settings(problem, z, settings):
    """Return the `LocusSettings` with the arclength weights of a curve at z."""
    weights = arclength_weights(problem, settings.scene_length)
    for k, name in enumerate(settings.names, -2):
        if name.endswith(".stiffness"):  # it varies over orders of magnitude
            weights[k] = 1.0 / (1.0 + abs(z[k]))
    return settings._replace(control=settings.control._replace(scale=weights))


def _locus_direction(problem, z, settings):
    """Return the `LocusDirection` from z towards greater values of the second parameter."""
    settings = weight_settings(problem, z, settings)
    tangent_vector = unit_tangent(continuation_problem(problem), z, settings.control.scale, problem)
    return LocusDirection(
        problem, start_point(_correct_point(problem, z, tangent_vector, settings.control), tangent_vector), settings
    )


def reverse_direction(direction):
    """Reverse a `LocusDirection`."""
    return direction._replace(start=start_point(direction.start.z, -direction.start.tangent))


def check_parameter_pair(scene, names):
    """Check that names are two different parameters of a scene. Raises ArgumentError."""
    pair = tuple(names) if isinstance(names, tuple | list) else ()
    for name in pair:
        check.require_parameter(name, scene.names, name)
    if len(pair) != 2 or pair[0] == pair[1]:
        raise check.ArgumentError("names", "must be two different parameters of the scene", names)
    check.require_independent(*pair)
    return pair


def locus_problems(start, names, whole_orbit=False):
    """Set up the equations and the solution z of a `LocusStart` along any number of parameters.

    Returns a list of (equations, z) with one entry, or at a GR one entry for each contact, without the other contacts.
    The equations are `GrazingEquations`, `SingularEquations` or `ChatterEquations`. A tuple of names is one parameter
    of several numbers that share a value. With `whole_orbit` a symmetric orbit is not reduced to one half, unless an SB
    requires it. Raises ArgumentError.
    """
    scene, orbit_row = start.scene, start.orbit_row
    if start.kind != "GR" and not len(orbit_row.times):
        rule = "must belong to an orbit with impacts; without impacts only a GR has derivatives and a locus"
        raise check.ArgumentError("special", rule, f"{start.kind} without impacts")
    impacts = _impact_list(start)
    values = [common_value(scene, name) for name in names]
    marked_scene, parameter_marks = mark_parameters(scene, *names)
    use_half_orbit = keeps_symmetry(start, names)
    if start.kind == "SB" and not use_half_orbit:
        raise check.ArgumentError("names", "must keep the scene symmetric, as an SB requires", names)
    use_half_orbit = use_half_orbit and not (whole_orbit and start.kind != "SB")
    closure_sign, periods = (-1.0, 0.5 * orbit_row.periods) if use_half_orbit else (1.0, float(orbit_row.periods))
    if use_half_orbit:
        impacts = impacts[: len(impacts) // 2]
    no_rows = np.zeros(0)
    sequence_scalars = (np.asarray(item) for item in (0.0, periods, closure_sign))
    problem_template = SingularEquations(
        marked_scene, parameter_marks, ImpactSequence(no_rows, no_rows, no_rows, *sequence_scalars), np.asarray(1.0)
    )
    if start.kind in STICKING_KINDS:
        return [_chatter_problem(problem_template, impacts, values, start.kind)]
    if start.kind != "GR":
        multiplier = 1.0 if start.kind == "SN" else -1.0
        return [_singular_problem(problem_template._replace(multiplier=np.asarray(multiplier)), impacts, values)]
    slack = GRAZING_TOLERANCE * scene_length(scene)
    grazing_indices = [k for k, (_, speed, side) in enumerate(impacts) if speed <= slack and not are_releases(side)]
    if not grazing_indices:
        raise check.ArgumentError("special", "must touch a wall", start.orbit_row.value)
    impact_lists = (
        [impact for k, impact in enumerate(impacts) if k == grazing_index or k not in grazing_indices]
        for grazing_index in grazing_indices
    )
    return [_grazing_problem(problem_template, item, values, slack) for item in impact_lists]


def _singular_problem(problem_template, impacts, values):
    """Return (`SingularEquations`, z) with these impacts."""
    sequence = padded_sequence(problem_template, impacts)
    return problem_template._replace(sequence=sequence), np.concatenate([sequence.times, sequence.speeds, values])


def _chatter_problem(problem_template, impacts, values, kind):
    """Return (`ChatterEquations`, z) with these impacts, at the row whose sticking phase is at its limit."""
    is_release, slack = kind == "RL", GRAZING_TOLERANCE * scene_length(problem_template.scene)
    sequence = padded_sequence(problem_template, impacts)
    z = np.concatenate([sequence.times, sequence.speeds, values])
    problem = ChatterEquations(
        problem_template.scene,
        problem_template.parameter_marks,
        sequence,
        np.zeros(len(sequence.sides)),
        np.asarray(float(is_release)),
        np.asarray(slack),
    )
    problem.row_mask[
        np.argmin(
            abs((sticking_limits.min_contact_forces if is_release else sticking_limits.excess_speeds)(problem, z))
        )
    ] = 1.0
    return problem, z


def _grazing_problem(problem_template, impacts, values, slack):
    """Return (`GrazingEquations`, z) with these impacts, one of which has zero speed."""
    sequence = padded_sequence(problem_template, impacts)
    row_mask = np.where(are_impacts(sequence) & (sequence.speeds <= slack), 1.0, 0.0)
    z = np.concatenate([sequence.times, sequence.speeds, values])
    if soft_grazing.is_smooth_wall(problem_template.scene, sequence.sides[np.argmax(row_mask)]):
        sequence = sequence._replace(grazing=row_mask)
    return GrazingEquations(
        problem_template.scene, problem_template.parameter_marks, sequence, row_mask, np.asarray(slack)
    ), z


def _impact_list(start):
    """Return (time, speed, side) of each impact and grazing contact in order, the first within the first period."""
    orbit_row = start.orbit_row
    entries = [
        ((k, 0.0), contact)
        for k, contact in enumerate(zip(orbit_row.times, orbit_row.speeds, orbit_row.sides, strict=True))
    ]
    if start.kind == "GR":
        for contact in start.grazing_contacts:
            if not contact.is_impact:
                start_time = orbit_row.times[contact.row] if len(orbit_row.times) else 0.0
                entries.append(((contact.row, contact.delay), (start_time + contact.delay, 0.0, contact.side)))
    entries = [contact for _, contact in sorted(entries)]
    period = 2.0 * np.pi / float(start.scene.frequency)
    time_shift = period * np.floor(entries[0][0] / period)
    return [(time - time_shift, speed, side) for time, speed, side in entries]


def keeps_symmetry(start, names):
    """Check that an orbit is its own mirror image and remains so for all values of the parameters."""
    impacts = _impact_list(start)
    if len(impacts) % 2 or not stays_symmetric(start.scene, *flatten_names(names)):
        return False
    times, speeds, sides = np.array(impacts).T
    orbit_row = start.orbit_row._replace(times=times, speeds=speeds, sides=sides)
    return is_own_mirror_image(start.scene, orbit_row)


def whole_orbit_impacts(problem, zs):
    """Return (times, speeds, sides, periods) of the whole orbits at points of a curve.

    `zs` has shape (points, unknowns), times and speeds have shape (points, impacts), sides has shape (impacts,). One
    half of an orbit is completed by its mirror image.
    """
    n_rows, n_impacts = len(problem.sequence.sides), int(np.sum(problem.sequence.sides != 0))
    times, speeds, sides = (
        zs[:, :n_impacts],
        zs[:, n_rows : n_rows + n_impacts],
        side_codes(problem.sequence)[:n_impacts],
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
    """Return the drive frequency at each point, (points, 1), or a number if it is not a parameter of the curve."""
    parameter_index = int(problem.parameter_marks.frequency)
    return (
        zs[:, [2 * len(problem.sequence.sides) + parameter_index - 1]]
        if parameter_index
        else float(problem.scene.frequency)
    )


def _correct_point(problem, z, tangent_vector, control):
    """Return z after Newton's method, or z itself if it does not converge."""
    solution = take_step(continuation_problem(problem), start_point(z, tangent_vector), 0.0, control, problem)
    return solution.z if solution.converged else z
