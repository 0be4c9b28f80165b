"""Follow orbits with one additional impact in n returns, from a grazing to their next one."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from continuation import event_search
from continuation.arclength import Point, StepControl

from .diagnostics import diagnose
from .equations import OrbitEquations, continuation_problem
from .grazing import padded_sequence
from .grazing_contact import (
    GRAZING_TOLERANCE,
    admissible,
    arclength_weights,
    contact_durations_at,
    flight_durations_at,
    locate_grazing,
    orbit_duration_at,
    refine_turning_point,
    wall_sides,
    zero_slow_speeds,
)
from .orbit_point import OrbitPoint

N_STEPS = 8  # steps to the speed that the square-root map predicts
MAX_SPEED_RATIO = 3.0  # largest speed relative to the prediction
PASS_TOLERANCE = 0.25  # relative to a return; largest shift of a pass from its time at the grazing
MAX_BISECTIONS = 6  # of a step that contains a grazing


class OneImpactOrbits(NamedTuple):
    """Orbits parametrised by the speed of one impact.

    Attributes
    ----------
    problem : OrbitEquations
        Equations of the orbits.
    grazing_z : ndarray
        Unknowns at the grazing, where the speed is zero.
    speed_index : int
        Index of the speed in z.
    pass_locations : tuple
        (row, wall, fraction of the flight after it) of each return without an impact.
    control : StepControl
        Weights of the arclength.
    length_scale : float
        Length of the scene.
    """

    problem: OrbitEquations
    grazing_z: Float[np.ndarray, " unknowns"]
    speed_index: int
    pass_locations: tuple[tuple[int, int, float], ...]
    control: StepControl
    length_scale: float

    def point_at_speed(self, z: Float[np.ndarray, " unknowns"], speed: float) -> Point:
        """Solve for the `Point` near z at which the impact has a speed."""
        return event_search.solve_with_fixed_entry(
            continuation_problem(self.problem), z, self.speed_index, speed, self.control, self.problem
        )

    def closest_approach(self, z: Float[np.ndarray, " unknowns"]) -> tuple[bool, tuple[int, int, float]]:
        """Return whether the orbit is admissible, and (row, wall, time) where a flight is nearest to a wall or deepest.

        The passes at the grazing contact are refined separately. Many passes are alike, and the sampled turning points
        do not separate them to a fraction of their distance.
        """
        diagnostics = diagnose(self.problem, z[None])
        nearest_row, nearest_wall = np.unravel_index(
            np.argmin(diagnostics.clearance[0]), diagnostics.clearance[0].shape
        )
        approaches = [
            (
                float(diagnostics.clearance[0, nearest_row, nearest_wall]),
                (int(nearest_row), int(nearest_wall), float(diagnostics.turning_time[0, nearest_row, nearest_wall])),
            )
        ]
        flight_durations, return_time = (
            flight_durations_at(self.problem, z),
            orbit_duration_at(self.problem, z) / (len(self.pass_locations) + 1),
        )
        for row, wall, fraction in self.pass_locations:
            guess_time = fraction * flight_durations[row]
            time_in_flight, distance, _ = refine_turning_point(self.problem, z, row, wall, guess_time)
            if (
                abs(time_in_flight - guess_time) < PASS_TOLERANCE * return_time
            ):  # else the pass has vanished, or another one was found
                approaches.append((float(distance), (row, wall, float(time_in_flight))))
        min_distance, location = min(approaches)
        return bool(admissible(self.problem, z, diagnostics)[0] and min_distance >= 0), location

    def orbit_row_at(self, z: Float[np.ndarray, " unknowns"], residual: float) -> OrbitPoint:
        """Return the `OrbitPoint` of z."""
        n_rows, impact_rows = len(self.problem.sequence.sides), self.problem.impact_rows
        diagnostics = diagnose(self.problem, z[None])
        times = np.mod(z[impact_rows], orbit_duration_at(self.problem, z))
        order = np.argsort(times)
        sorted_impacts = (
            times[order],
            z[n_rows + impact_rows][order],
            np.asarray(self.problem.sequence.sides)[impact_rows][order],
        )
        x, v, periods = float(diagnostics.x[0, 0]), float(diagnostics.v[0, 0]), int(self.problem.sequence.periods)
        return OrbitPoint(float(z[-1]), *sorted_impacts, periods, x, v, float(residual))


def traversal_count(grazing_return, n):
    """Return the number of traversals of the grazing orbit in an orbit with one impact in n returns.

    If a return is half of the orbit, these orbits close after an even number of returns, or as their own mirror image.

    Parameters
    ----------
    grazing_return : GrazingReturn
        Return map at the grazing.
    n : int
        Number of returns.

    Returns
    -------
    int
        Number of traversals.
    """
    return n // 2 if grazing_return.is_half and n % 2 == 0 else n


def impact_indices(grazing_return, n):
    """Return the return and the index of the grazing contact of each additional impact.

    Parameters
    ----------
    grazing_return : GrazingReturn
        Return map at the grazing.
    n : int
        Number of returns.

    Returns
    -------
    list of tuple of int
        (return, index of the grazing contact) of each impact in one traversal.
    """
    return [(0, 0), (n, 1)] if grazing_return.is_half and n % 2 else [(0, 0)]


def one_impact_orbits(grazing_return, n, length_scale):
    """Set up the orbits with one additional impact in n returns.

    Parameters
    ----------
    grazing_return : GrazingReturn
        Return map at the grazing.
    n : int
        Number of returns.
    length_scale : float
        Length of the scene.

    Returns
    -------
    OneImpactOrbits
        The orbits.
    """
    reduced_problem, z, first_contact = (
        grazing_return.reduced_problem,
        grazing_return.z,
        grazing_return.omitted_grazings[0],
    )
    n_reduced_rows, orbit_duration, n_traversals = (
        len(reduced_problem.sequence.sides),
        orbit_duration_at(reduced_problem, z),
        traversal_count(grazing_return, n),
    )
    impacts = [
        (first_contact.time + k * grazing_return.return_time, 0.0, grazing_return.omitted_grazings[index].depth.side)
        for k, index in impact_indices(grazing_return, n)
    ]
    for k in reduced_problem.impact_rows if n_reduced_rows else ():
        contact_time = first_contact.time + (z[k] - first_contact.time) % orbit_duration
        impacts += [
            (contact_time + j * orbit_duration, z[n_reduced_rows + k], reduced_problem.sequence.sides[k])
            for j in range(n_traversals)
        ]
    impacts = sorted(impacts)
    sequence = padded_sequence(reduced_problem, impacts)._replace(
        periods=np.asarray(float(n_traversals) * float(reduced_problem.sequence.periods))
    )
    problem, n_rows = reduced_problem._replace(sequence=sequence), len(sequence.sides)
    start_z = np.concatenate([sequence.times, sequence.speeds, z[-1:]])
    flight_durations, side_of_wall, pass_locations = (
        flight_durations_at(problem, start_z),
        wall_sides(problem.scene),
        [],
    )
    contact_durations = contact_durations_at(problem, start_z)
    for k in range(1, round(n_traversals * orbit_duration / grazing_return.return_time)):
        contact_time, side = (
            first_contact.time + k * grazing_return.return_time,
            grazing_return.omitted_grazings[k % 2 if grazing_return.is_half else 0].depth.side,
        )
        row = sum(time < contact_time for time, *_ in impacts) - 1
        if (k, 1) not in impact_indices(grazing_return, n):
            pass_locations.append(
                (
                    row,
                    side_of_wall.index(side),
                    float((contact_time - impacts[row][0] - contact_durations[row]) / flight_durations[row]),
                )
            )
    control_values = (np.float64(value) for value in (0.0, 1.0, 1.0, -np.inf, np.inf))
    return OneImpactOrbits(
        problem,
        start_z,
        n_rows,
        tuple(pass_locations),
        StepControl(arclength_weights(problem, length_scale), *control_values),
        length_scale,
    )


def locate_next_grazing(orbits, predicted_speed):
    """Locate the first grazing of the orbits along the speed of the impact.

    Parameters
    ----------
    orbits : OneImpactOrbits
        The orbits.
    predicted_speed : float
        Speed predicted by the square-root map.

    Returns
    -------
    tuple or None
        Unknowns z and side of the wall; None if no grazing is found within three times the predicted speed.
    """
    previous_z, current_z, speed_step = None, orbits.grazing_z, predicted_speed / N_STEPS
    for k in range(1, round(MAX_SPEED_RATIO * N_STEPS) + 1):
        point = orbits.point_at_speed(current_z if previous_z is None else 2.0 * current_z - previous_z, k * speed_step)
        if not point.converged:
            return None
        is_admissible, location = orbits.closest_approach(point.z)
        if not is_admissible:
            return _locate_grazing_between(orbits, current_z, point.z, location)
        previous_z, current_z = current_z, point.z
    return None


def _locate_grazing_between(orbits, good_z, bad_z, location):
    """Return (z, side of the wall) of the first grazing between two orbits, None if not found.

    `location` is where the inadmissible orbit is deepest behind a wall.
    """
    n_rows = len(orbits.problem.sequence.sides)
    for _ in range(MAX_BISECTIONS):
        solution = locate_grazing(orbits.problem, bad_z, *location)
        if (
            solution.z is not None
            and good_z[orbits.speed_index] < solution.z[orbits.speed_index] <= bad_z[orbits.speed_index]
        ):
            z = zero_slow_speeds(orbits.problem, solution.z, orbits.length_scale)
            clearance = diagnose(orbits.problem, z[None]).clearance.min()
            if (
                clearance > -GRAZING_TOLERANCE * orbits.length_scale
                and z[n_rows + orbits.problem.impact_rows].min() > 0
            ):
                return z, wall_sides(orbits.problem.scene)[location[1]]
        middle_point = orbits.point_at_speed(0.5 * (good_z + bad_z), 0.5 * (good_z + bad_z)[orbits.speed_index])
        if not middle_point.converged:
            return None
        is_admissible, middle_location = orbits.closest_approach(middle_point.z)
        if is_admissible:
            good_z = middle_point.z
        else:
            bad_z, location = middle_point.z, middle_location
    return None
