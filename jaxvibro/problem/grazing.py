"""Find the branches that emanate from a grazing and keep the admissible ones.

At a grazing the orbit belongs to every itinerary that contains its grazing contacts as impacts with zero speed, or
omits them. On each of these branches it is a regular point. The branches along which speeds and clearances become
positive meet there.
"""

from functools import singledispatch
from itertools import product
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from continuation import augmented_systems, event_search
from continuation.arclength import Point, StepControl
from continuation.intermediate_points import start_point

from .diagnostics import Diagnostics, diagnose
from .equations import OrbitEquations, are_releases, continuation_problem, side_codes
from .grazing_contact import (
    admissible,
    arclength_weights,
    contact_durations_at,
    distance_and_speed,
    find_grazing_contacts,
    orbit_duration_at,
    wall_sides,
)
from .same_orbit import match_repeated_contacts

EXIT_STEPS = 1e-5, 1e-7  # arclengths at which a branch that emanates from a grazing is checked
TIGHT_TOLERANCE, LOOSE_TOLERANCE = (
    1e-12,
    1e-10,
)  # Newton's tolerance with and without added impacts; slow impacts amplify rounding
ZERO_RATE = 1e-6  # derivatives of speeds and distances along a branch below this count as zero
NEWTON_STEPS = 12  # Newton steps to an orbit without impacts
SINGULAR_RATIO = 1e-7  # relative to the largest singular value; directions below this are not solved for
MAX_FREE_CHOICES = 4  # number of grazing contacts up to which every choice is tried


class GrazingExit(NamedTuple):
    """Admissible branch that emanates from a grazing.

    Attributes
    ----------
    problem : OrbitEquations
        Equations of its orbits.
    point : Point
        The grazing, with the tangent that leads away.
    nearby_z : ndarray
        Unknowns of an orbit close to the grazing.
    diagnostics : Diagnostics
        Diagnostics at `nearby_z`.
    included : tuple of bool
        True for each grazing contact that counts as an impact.
    """

    problem: OrbitEquations
    point: Point
    nearby_z: Float[np.ndarray, " unknowns"]
    diagnostics: Diagnostics
    included: tuple[bool, ...]


def try_all_choices(problem, z, grazing_contacts, length_scale):
    """Yield the result of `find_exit` in both directions for each choice of grazing contacts as impacts."""
    for included in _distinct_choices(problem, z, grazing_contacts):
        choice_problem, start_z, omitted = with_grazing_contacts(problem, z, grazing_contacts, included)
        tangent = event_search.unit_tangent(
            continuation_problem(choice_problem),
            start_z,
            arclength_weights(choice_problem, length_scale),
            choice_problem,
        )
        rates = growth_rates(choice_problem, start_z, tangent, omitted)
        for sign in (1.0, -1.0):
            yield find_exit(choice_problem, start_z, sign * tangent, sign * rates, length_scale, included)


def find_exits(problem, z, length_scale, generate_exits=try_all_choices):
    """Find the exits of a grazing.

    Returns the `GrazingContact` list, the `GrazingExit` list, which includes the branch that came to the grazing, and
    whether all exits are known; Newton's method may fail at some. `generate_exits` is a function like
    `try_all_choices`.
    """
    grazing_contacts = find_grazing_contacts(problem, z, length_scale)
    outcomes = list(generate_exits(problem, z, grazing_contacts, length_scale))
    return (
        grazing_contacts,
        [grazing_exit for grazing_exit, _ in outcomes if grazing_exit],
        all(is_sure for _, is_sure in outcomes),
    )


def with_grazing_contacts(problem, z, grazing_contacts, included):
    """Return (equations, z, `omitted_contacts`) of the orbit with some grazing contacts as impacts."""
    all_impacts = list_impacts(problem, z, grazing_contacts, included)
    kept_impacts = [impact for impact in all_impacts if impact.is_kept]
    new_problem, start_z = with_impacts(problem, z, kept_impacts)
    return new_problem, start_z, omitted_contacts(new_problem, start_z, all_impacts, kept_impacts)


def with_impacts(problem, z, impacts, source_rows=()):
    """Return the equations of orbits with given impacts, and z of the current one.

    `source_rows` are the rows in which these impacts were.
    """
    new_problem = replace_sequence(
        problem, padded_sequence(problem, [(impact.time, impact.speed, impact.side) for impact in impacts]), source_rows
    )
    if not impacts:
        return new_problem, solve_free_orbit(new_problem, z[-1], _section_state(problem, z))
    return new_problem, np.concatenate(
        [new_problem.sequence.times, new_problem.sequence.speeds, z[2 * len(problem.sequence.sides) or 2 :]]
    )


@singledispatch
def replace_sequence(problem, sequence, source_rows):
    """Replace the impact sequence of the equations.

    Parameters
    ----------
    problem : OrbitEquations
        Equations; other classes are registered.
    sequence : ImpactSequence
        New sequence.
    source_rows : sequence of int
        Rows of `problem` in which the impacts of `sequence` were.

    Returns
    -------
    OrbitEquations
        Equations with the new sequence.
    """
    return problem._replace(sequence=sequence)


def _distinct_choices(problem, z, grazing_contacts):
    """List the choices of grazing contacts as impacts that lead to different orbits.

    Choices that are equal when counted from another period lead to the same orbit. The branch's own choice represents
    them if it is among them, else the first one.
    """
    branch_choice, choices = tuple(entry.is_impact for entry in grazing_contacts), []
    if not grazing_contacts:  # the samples did not resolve which turning point touches the wall
        return [branch_choice]
    contact_times = np.array(
        [entry.delay + (z[entry.row] if len(problem.sequence.sides) else 0.0) for entry in grazing_contacts]
    )
    image_table = match_repeated_contacts(
        problem, z, contact_times, np.array([entry.side for entry in grazing_contacts])
    )
    for included in _candidate_choices(grazing_contacts):
        equivalent_choices = [tuple(included[k] for k in image_indices) for image_indices in image_table]
        if (included == branch_choice or branch_choice not in equivalent_choices) and not any(
            entry in choices for entry in equivalent_choices
        ):
            choices.append(included)
    return choices


def _candidate_choices(grazing_contacts):
    """List choices of grazing contacts as impacts.

    All choices are listed for few grazing contacts. For many the list contains the branch's own choice, its complement,
    none and all.
    """
    if len(grazing_contacts) <= MAX_FREE_CHOICES:
        return list(product((False, True), repeat=len(grazing_contacts)))
    branch_choice = tuple(entry.is_impact for entry in grazing_contacts)
    return list(
        dict.fromkeys(
            [
                branch_choice,
                tuple(not entry for entry in branch_choice),
                (False,) * len(grazing_contacts),
                (True,) * len(grazing_contacts),
            ]
        )
    )


class ImpactEntry(NamedTuple):
    """Impact or grazing contact of an orbit; `is_kept` is true if it is kept as an impact."""

    time: float
    speed: float
    side: int
    is_kept: bool


def list_impacts(problem, z, grazing_contacts, included):
    """List all impacts and grazing contacts as `ImpactEntry` records, in order along the orbit."""
    n_rows, is_included = len(problem.sequence.sides), dict(zip(grazing_contacts, included, strict=True))
    contact_of_row = {contact.row: contact for contact in grazing_contacts if contact.is_impact}
    entries = []
    sides = side_codes(problem.sequence)
    for row in np.flatnonzero(sides):
        contact, side = contact_of_row.get(int(row)), int(sides[row])
        entry = ImpactEntry(
            z[row], 0.0 if contact else z[n_rows + row], side, is_included[contact] if contact else True
        )
        entries.append(((int(row), 0.0), entry))
    for contact in grazing_contacts:
        if not contact.is_impact:
            impact_time = z[contact.row] if n_rows else 0.0
            entries.append(
                (
                    (contact.row, contact.delay),
                    ImpactEntry(impact_time + contact.delay, 0.0, contact.side, is_included[contact]),
                )
            )
    return [entry for _, entry in sorted(entries)]


def omitted_contacts(problem, z, all_impacts, kept_impacts):
    """Return (row, wall, time since the start of the flight after that row) of each grazing contact that is not kept.

    `problem` and `z` belong to the orbit with the impacts kept, in rows in this order.
    """
    side_of_wall, omitted, contact_durations = wall_sides(problem.scene), [], contact_durations_at(problem, z)
    orbit_duration = orbit_duration_at(problem, z)
    index = len(kept_impacts) - 1  # grazings before the first impact follow the last one
    for impact in all_impacts:
        if impact.is_kept:
            index = kept_impacts.index(impact)
        else:
            impact_time, row = kept_impacts[index].time if kept_impacts else 0.0, max(index, 0)
            omitted.append(
                (
                    row,
                    side_of_wall.index(impact.side),
                    (impact.time - impact_time) % orbit_duration - float(contact_durations[row]),
                )
            )
    return omitted


def padded_sequence(problem, impacts):
    """Make an impact sequence whose number of rows is a power of two.

    Parameters
    ----------
    problem : OrbitEquations
        Equations whose phase and periods are kept.
    impacts : sequence of tuple
        (time, speed, side) of each impact. The side is +-2 for a release, and +-3 if the mass lifts before that
        sticking phase (``ImpactSequence.releases``).

    Returns
    -------
    ImpactSequence
        Sequence; without rows if there are no impacts.
    """
    n_rows = 0 if not impacts else max(2, 1 << (len(impacts) - 1).bit_length())
    columns = np.zeros((3, n_rows))
    for k, impact in enumerate(impacts):
        columns[:, k] = impact
    times, speeds, sides = columns
    release_codes = np.where(are_releases(sides), abs(sides) - 1.0, 0.0)
    releases = release_codes if release_codes.any() else None
    return problem.sequence._replace(times=times, speeds=speeds, sides=np.sign(sides), releases=releases)


def _section_state(problem, z):
    """Return (x, v) at the section; only orbits under a user-defined force need it."""
    if problem.scene.force is None or not len(problem.sequence.sides):
        return z[:2]
    diagnostics = diagnose(problem, z[None])
    return diagnostics.x[0, 0], diagnostics.v[0, 0]


def solve_free_orbit(problem, parameter_value, guess_state):
    """Return z of the orbit without impacts.

    Under spring and damper it is unique, else it is the one near a guess of (x, v).
    """
    has_force = problem.scene.force is not None
    z = np.array([*(guess_state if has_force and np.isfinite(guess_state).all() else (0.0, 0.0)), parameter_value])
    for _ in range(NEWTON_STEPS if has_force else 1):
        residual, jacobian = (
            np.asarray(array) for array in augmented_systems.evaluate(continuation_problem(problem), z, problem)
        )
        state_jacobian = jacobian[
            :, :2
        ]  # under a force it may be singular, at a fold or branch point; no step is taken along the null vector
        step = (
            np.linalg.lstsq(state_jacobian, residual, SINGULAR_RATIO)[0]
            if has_force
            else np.linalg.solve(state_jacobian, residual)
        )
        z[:2] -= step
        if abs(step).max() <= augmented_systems.STEP_TOLERANCE * (1.0 + abs(z).max()):
            break
    return z


def opening_rate(problem, z, direction, row, wall, time_in_flight):
    """Return the derivative of the distance from a wall in a direction of z.

    Parameters
    ----------
    problem : OrbitEquations
        Equations of the orbit.
    z : ndarray
        Unknowns.
    direction : ndarray
        Direction in the space of unknowns.
    row : int
        Row of the impact before the flight.
    wall : int
        Index of the wall.
    time_in_flight : float
        Time since the start of the flight.

    Returns
    -------
    float
        Directional derivative, by a central difference.
    """
    offset_distances = (
        distance_and_speed(
            problem, row, wall, np.append(z + sign * augmented_systems.DIFFERENCE_STEP * direction, time_in_flight)
        )[0]
        for sign in (1, -1)
    )
    return float(np.subtract(*offset_distances) / (2.0 * augmented_systems.DIFFERENCE_STEP))


def growth_rates(problem, z, tangent, omitted):
    """Return the derivatives of zero speeds and of the distances of omitted grazing contacts along a tangent."""
    n_rows = len(problem.sequence.sides)
    speed_rates = [tangent[n_rows + k] for k in problem.impact_rows if z[n_rows + k] == 0.0]
    return np.array(speed_rates + [opening_rate(problem, z, tangent, *location) for location in omitted])


def find_exit(problem, z, tangent, rates, length_scale, included):
    """Return the `GrazingExit` along a tangent, or None, and whether this is certain.

    `rates` are those of `growth_rates`.
    """
    if (rates < -ZERO_RATE).any():
        return None, True
    grazing_exit, converged = step_along_exit(
        problem, z, tangent, length_scale, included, TIGHT_TOLERANCE if any(included) else LOOSE_TOLERANCE, EXIT_STEPS
    )
    return grazing_exit, converged or rates.min(initial=0.0) <= 0


def step_along_exit(problem, z, tangent, length_scale, included, tolerance, offsets):
    """Return the `GrazingExit` along a tangent, or None, and whether Newton's method converged.

    Each offset is tried until the orbit is admissible.
    """
    point = start_point(z, tangent)
    control_values = (np.float64(value) for value in (0.0, 1.0, tolerance, -np.inf, np.inf))
    control, converged = StepControl(arclength_weights(problem, length_scale), *control_values), False
    for offset in offsets:
        nearby_point = event_search.take_step(continuation_problem(problem), point, offset, control, problem)
        converged |= bool(nearby_point.converged)
        diagnostics = diagnose(problem, nearby_point.z[None])
        if nearby_point.converged and admissible(problem, nearby_point.z, diagnostics)[0]:
            return GrazingExit(problem, point, nearby_point.z, diagnostics, included), True
    return None, converged
