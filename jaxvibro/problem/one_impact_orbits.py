"""Orbits that graze but for one impact in n returns, in their equations: from the grazing to where they graze again."""

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

N_STEPS = 8  # to where the square-root map has the next touch
MAX_SPEED_RATIO = 3.0  # times as far as that it is looked for
PASS_TOLERANCE = 0.25  # of a return: so near to where it was at the grazing a pass is looked for
MAX_BISECTIONS = 6  # of a step in which a touch is looked for


class OneImpactOrbits(NamedTuple):
    """Orbits along the speed of one impact. along; grazing_z: z where that is zero; speed_index: of the speed in z;
    passes: (row, wall, share of the flight after it) of each return in which there is no impact; control; length_scale:
    the scene's."""

    problem: OrbitEquations
    grazing_z: Float[np.ndarray, " unknowns"]
    speed_index: int
    pass_locations: tuple[tuple[int, int, float], ...]
    control: StepControl
    length_scale: float

    def point_at_speed(self, z: Float[np.ndarray, " unknowns"], speed: float) -> Point:
        """The `Point` near z where the impact has a speed."""
        return event_search.solve_with_fixed_entry(
            continuation_problem(self.problem), z, self.speed_index, speed, self.control, self.problem
        )

    def closest_approach(self, z: Float[np.ndarray, " unknowns"]) -> tuple[bool, tuple[int, int, float]]:
        """(whether the orbit keeps to its walls; (row, wall, time) where a flight is nearest to one, or deepest).

        Where it passes the touch it is asked for itself: as many passes are alike, the least of all turning points
        is not told from the next to a part of their distance.
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
            ):  # else it is no pass any more, or another one
                approaches.append((float(distance), (row, wall, float(time_in_flight))))
        min_distance, location = min(approaches)
        return bool(admissible(self.problem, z, diagnostics)[0] and min_distance >= 0), location

    def orbit_row_at(self, z: Float[np.ndarray, " unknowns"], residual: float) -> OrbitPoint:
        """The `OrbitPoint` of z."""
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
    """How often the orbit of a `TouchReturn` is gone through by those with one impact in n returns: if a return is half
    of it these close after an even number of returns, and else as their own mirror image."""
    return n // 2 if grazing_return.is_half and n % 2 == 0 else n


def impact_indices(grazing_return, n):
    """(return, place among the touches) of each such impact, once round."""
    return [(0, 0), (n, 1)] if grazing_return.is_half and n % 2 else [(0, 0)]


def one_impact_orbits(grazing_return, n, length_scale):
    """The `OneImpactOrbits` with one impact in n returns beside those of the orbit of a `TouchReturn`; length_scale:
    the scene's."""
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
    """(z, the wall's side) where the orbits, followed along the speed of the impact, first touch a wall, None
    where they do not soon; predicted_speed: about that there."""
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
    """(z, the wall's side) of the first touch between two orbits, None where none is found; location: where the bad one
    is deepest behind a wall."""
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
