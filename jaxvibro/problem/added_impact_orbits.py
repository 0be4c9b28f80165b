"""Follow orbits with one additional impact in n returns, from a grazing to the next grazing of these orbits."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from continuation.arclength import Point

from .grazing_contact import (
    GRAZING_TOLERANCE,
    are_admissible,
    contact_durations_at,
    flight_durations_at,
    locate_grazing,
    refine_turning_point,
    scene_wall_sides,
    set_slow_speeds_to_zero,
)
from .orbit_diagnostics import diagnose
from .orbit_point import OrbitPoint, point_of_solution
from .orbit_problem import OrbitProblem

N_STEPS = 8  # steps to the speed that the square-root map predicts
MAX_SPEED_RATIO = 3.0  # largest speed relative to the prediction
PASS_TOLERANCE = 0.25  # relative to a return; largest shift of a pass from its time at the grazing
MAX_BISECTIONS = 6  # of a step that contains a grazing


class AddedImpactOrbits(NamedTuple):
    """Orbits with one additional impact in n returns, parametrised by the speed of this impact.

    Attributes
    ----------
    problem : OrbitProblem
        Equations of the orbits.
    grazing_z : ndarray
        Unknowns at the grazing, where the speed of the additional impact is zero.
    speed_index : int
        Index of this speed in z.
    pass_locations : tuple
        (row, wall, fraction) of each return to the grazing contact without an impact. The mass passes the wall at this
        fraction of the flight that begins at the row.
    """

    problem: OrbitProblem
    grazing_z: Float[np.ndarray, " unknowns"]
    speed_index: int
    pass_locations: tuple[tuple[int, int, float], ...]

    def point_at_speed(self, z: Float[np.ndarray, " unknowns"], speed: float) -> Point:
        """Solve for the `Point` near z at which the additional impact has the given speed."""
        return self.problem.solve_at(z, self.speed_index, speed)

    def closest_approach(self, z: Float[np.ndarray, " unknowns"]) -> tuple[bool, tuple[int, int, float]]:
        """Return (True if the orbit is admissible, location at which the distance from a wall is least).

        The location is (row, wall, time since the start of the flight). The passes near the grazing contact are refined
        separately, because the sampled turning points do not resolve the differences between many similar passes.
        """
        diagnostics = diagnose(self.problem, z[None])
        nearest_row, nearest_wall = np.unravel_index(
            np.argmin(diagnostics.clearance[0]), diagnostics.clearance[0].shape
        )
        distances_at_locations = [
            (
                float(diagnostics.clearance[0, nearest_row, nearest_wall]),
                (int(nearest_row), int(nearest_wall), float(diagnostics.turning_time[0, nearest_row, nearest_wall])),
            )
        ]
        flight_durations, return_time = (
            flight_durations_at(self.problem, z),
            self.problem.duration(z) / (len(self.pass_locations) + 1),
        )
        for row, wall, flight_fraction in self.pass_locations:
            guess_time = flight_fraction * flight_durations[row]
            time_in_flight, distance, _ = refine_turning_point(self.problem, z, row, wall, guess_time)
            if (
                abs(time_in_flight - guess_time) < PASS_TOLERANCE * return_time
            ):  # else the pass has vanished, or another one was found
                distances_at_locations.append((float(distance), (row, wall, float(time_in_flight))))
        min_distance, location = min(distances_at_locations)
        return bool(are_admissible(self.problem, z, diagnostics)[0] and min_distance >= 0), location

    def orbit_point_at(self, z: Float[np.ndarray, " unknowns"], residual: float) -> OrbitPoint:
        """Return the `OrbitPoint` of z."""
        times, speeds, sides = self.problem.impacts(z)
        times = np.mod(times, self.problem.duration(z))
        time_order = np.argsort(times)
        sorted_columns = times[time_order], speeds[time_order], sides[time_order]
        problem, z = self.problem.with_impacts(z, list(zip(*sorted_columns, strict=True)))
        return point_of_solution(problem, z, (np.nan, np.nan), residual).with_section_state()


def grazing_traversal_count(grazing_return, n_returns):
    """Return the number of traversals of the grazing orbit in an orbit with one additional impact in n returns.

    If a return is half of the grazing orbit, n returns are n / 2 traversals for even n. For odd n the orbit is its own
    mirror image and closes after 2 n returns.

    Parameters
    ----------
    grazing_return : GrazingReturn
        Return map at the grazing.
    n_returns : int
        Number of returns.

    Returns
    -------
    int
        Number of traversals.
    """
    return n_returns // 2 if grazing_return.is_half_orbit and n_returns % 2 == 0 else n_returns


def added_impact_indices(grazing_return, n_returns):
    """Return (return, index of the grazing contact) of each additional impact in an orbit.

    Parameters
    ----------
    grazing_return : GrazingReturn
        Return map at the grazing.
    n_returns : int
        Number of returns.

    Returns
    -------
    list of tuple of int
        Number of returns before the impact, and index of the grazing contact, for each additional impact.
    """
    return [(0, 0), (n_returns, 1)] if grazing_return.is_half_orbit and n_returns % 2 else [(0, 0)]


def added_impact_orbits(grazing_return, n_returns):
    """Set up the orbits with one additional impact in n returns.

    Parameters
    ----------
    grazing_return : GrazingReturn
        Return map at the grazing.
    n_returns : int
        Number of returns.

    Returns
    -------
    AddedImpactOrbits
        The orbits.
    """
    reduced_problem, reduced_z, first_contact = (
        grazing_return.reduced_problem,
        grazing_return.z,
        grazing_return.omitted_grazings[0],
    )
    n_reduced_rows, orbit_duration, n_traversals = (
        len(reduced_problem.sequence.sides),
        reduced_problem.duration(reduced_z),
        grazing_traversal_count(grazing_return, n_returns),
    )
    impacts = [
        (first_contact.time + k * grazing_return.return_time, 0.0, grazing_return.omitted_grazings[index].depth.side)
        for k, index in added_impact_indices(grazing_return, n_returns)
    ]
    for k in reduced_problem.impact_rows if n_reduced_rows else ():
        event_time = first_contact.time + (reduced_z[k] - first_contact.time) % orbit_duration
        impacts += [
            (
                event_time + traversal_index * orbit_duration,
                reduced_z[n_reduced_rows + k],
                reduced_problem.sequence.sides[k],
            )
            for traversal_index in range(n_traversals)
        ]
    impacts, n_periods = sorted(impacts), float(n_traversals) * float(reduced_problem.sequence.periods)
    problem, grazing_z = reduced_problem.with_impacts(reduced_z, impacts, periods=n_periods)
    flight_durations, wall_sides, pass_locations = (
        flight_durations_at(problem, grazing_z),
        scene_wall_sides(problem.scene),
        [],
    )
    contact_durations = contact_durations_at(problem, grazing_z)
    for k in range(1, round(n_traversals * orbit_duration / grazing_return.return_time)):
        event_time, wall_side = (
            first_contact.time + k * grazing_return.return_time,
            grazing_return.omitted_grazings[k % 2 if grazing_return.is_half_orbit else 0].depth.side,
        )
        row = int(sum(time < event_time for time, *_ in impacts)) - 1
        if (k, 1) not in added_impact_indices(grazing_return, n_returns):
            pass_locations.append(
                (
                    row,
                    wall_sides.index(wall_side),
                    float((event_time - impacts[row][0] - contact_durations[row]) / flight_durations[row]),
                )
            )
    return AddedImpactOrbits(problem, grazing_z, problem.n_rows, tuple(pass_locations))


def locate_next_grazing(orbit_family, predicted_speed):
    """Locate the first grazing of the orbits as the speed of the additional impact increases.

    Parameters
    ----------
    orbit_family : AddedImpactOrbits
        The orbits.
    predicted_speed : float
        Speed predicted by the square-root map.

    Returns
    -------
    tuple or None
        (unknowns z, side of the wall); None if no grazing is located up to three times the predicted speed.
    """
    previous_z, current_z, speed_step = None, orbit_family.grazing_z, predicted_speed / N_STEPS
    for k in range(1, round(MAX_SPEED_RATIO * N_STEPS) + 1):
        point = orbit_family.point_at_speed(
            current_z if previous_z is None else 2.0 * current_z - previous_z, k * speed_step
        )
        if not point.converged:
            return None
        is_admissible, deepest_location = orbit_family.closest_approach(point.z)
        if not is_admissible:
            return _locate_grazing_between(orbit_family, current_z, point.z, deepest_location)
        previous_z, current_z = current_z, point.z
    return None


def _locate_grazing_between(orbit_family, admissible_z, inadmissible_z, deepest_location):
    """Return (z, side of the wall) of the first grazing between two orbits; None if it is not located.

    `deepest_location` is the (row, wall, time) at which the inadmissible orbit is deepest behind a wall.
    """
    n_rows = len(orbit_family.problem.sequence.sides)
    for _ in range(MAX_BISECTIONS):
        solution = locate_grazing(orbit_family.problem, inadmissible_z, *deepest_location)
        if (
            solution.z is not None
            and admissible_z[orbit_family.speed_index]
            < solution.z[orbit_family.speed_index]
            <= inadmissible_z[orbit_family.speed_index]
        ):
            grazing_z = set_slow_speeds_to_zero(orbit_family.problem, solution.z)
            least_clearance = diagnose(orbit_family.problem, grazing_z[None]).clearance.min()
            if (
                least_clearance > -GRAZING_TOLERANCE * orbit_family.problem.length_scale
                and grazing_z[n_rows + orbit_family.problem.impact_rows].min() > 0
            ):
                return grazing_z, scene_wall_sides(orbit_family.problem.scene)[deepest_location[1]]
        middle_point = orbit_family.point_at_speed(
            0.5 * (admissible_z + inadmissible_z), 0.5 * (admissible_z + inadmissible_z)[orbit_family.speed_index]
        )
        if not middle_point.converged:
            return None
        is_admissible, middle_location = orbit_family.closest_approach(middle_point.z)
        if is_admissible:
            admissible_z = middle_point.z
        else:
            inadmissible_z, deepest_location = middle_point.z, middle_location
    return None
