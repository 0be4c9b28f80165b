"""Orbits with one additional impact in n returns near a grazing: of Nordmark's map, and of the scene.

Nordmark's map near a grazing of a rigid wall, and orbits of this map with one impact in n returns. At the grazing
contact, let y be the difference between (x, v) and the state of the orbit that omits the contact. Let d be the depth of
a contact. From one contact to the next

    y -> M (y + E sqrt(d)),  d = C y + mu,    C y = side x,  E = -side root (0, 1),

without the root if d < 0 (Nordmark, J. Sound Vib. 145, 279, 1991). mu is the depth of the orbit that omits the contact,
and root is `GrazingJump.root`. An orbit with one impact in n returns and s = sqrt(d) at this impact satisfies

    s^2 - q s = mu,  q = C (I - M^n)^-1 M^n E,    and k returns later  d = mu + g_k s,  g_k = C M^k (I - M^n)^-1 E.

The orbit does not reach the wall k returns later while s < q - g_k. With the determinant of M and c_n = C M^n E,

    q = c_n / det(I - M^n),    g_k = (c_k + det(M)^k c_(n-k)) / det(I - M^n).

The multipliers of the orbit are the eigenvalues of M^n (I + E C / 2 s). A multiplier is 1 at s = q / 2, and -1 at s =
-c_n / 2 det(I + M^n).

- If c_n < 0 for all n, the motion remains near the grazing orbit. For real multipliers 0 <= m < l of M and large n, the
  stable orbits with one impact in n returns have windows from s = ``|c_n|`` / 2 to ``|c_(n-1)| - |c_n|``. There are no
  windows if l > 2/3, and each window overlaps the next window if l < 1/4 (Chin, Ott, Nusse and Grebogi, Phys. Rev. E
  50, 4427, 1994). The windows end at values of mu proportional to l^(2 n).
- Let n be the first number with c_n > 0, if there is one. An impact with a small s is then followed by an impact with
  the larger value sqrt(c_n s), until s is about q of this n. The motion leaves the neighbourhood of the grazing orbit,
  and the orbit with one impact in n returns exists on both sides of the grazing.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float

from continuation.arclength import Point

from ..orbits.flight_clearance import GRAZING_TOLERANCE
from .grazing_contact import (
    are_admissible,
    contact_durations_at,
    flight_durations_at,
    locate_grazing,
    refine_turning_point,
    scene_wall_sides,
    set_slow_speeds_to_zero,
)
from .orbit_equations import diagnose
from .orbit_point import OrbitPoint, point_of_solution
from .orbit_problem import OrbitProblem

MAX_RETURNS = 64  # beyond this many returns the sign of C M^n E is rounding
ZERO_RESPONSE = 1e-8  # relative to the size that C M^n E may have; smaller responses have no sign


class AddedImpactWindow(NamedTuple):
    """Window of the orbits with one impact in n returns, in terms of s = sqrt(depth) at the impact.

    The depth of the orbit that omits the contact is mu = s^2 - `linear_coefficient` s.

    Attributes
    ----------
    linear_coefficient : float
        Coefficient q.
    next_grazing_root : float
        Value of s at the next grazing of the orbits, inf without a next grazing. The orbits exist from s = 0 to this
        value.
    min_stable_root : float
        Value of s above which the orbits are stable, nan if no orbit is stable.
    fold_root, doubling_root : float
        Values of s at which a multiplier is 1 and -1, nan outside the window.
    """

    linear_coefficient: float
    next_grazing_root: float
    min_stable_root: float
    fold_root: float
    doubling_root: float

    def depth(self, depth_root: float) -> float:
        """Return mu for a value of s, the depth of the orbit that omits the contact."""
        return depth_root * depth_root - self.linear_coefficient * depth_root


class SquareRootMap(NamedTuple):
    """Square-root map at a grazing.

    Parameters
    ----------
    jump_coefficient : float
        Jump of the velocity divided by the square root of the depth.
    matrix : ndarray
        Derivative M of a return, array of shape (2, 2).
    """

    jump_coefficient: float
    matrix: Float[np.ndarray, "2 2"]

    @property
    def multipliers(self) -> Complex[np.ndarray, "2"]:
        """Eigenvalues of M, complex array of shape (2,), the larger first."""
        eigenvalues = np.linalg.eigvals(self.matrix).astype(complex)
        return eigenvalues[np.argsort(-abs(eigenvalues), kind="stable")]

    def matrix_powers(self, max_power: int) -> Float[np.ndarray, "powers 2 2"]:
        """Return M^n for n = 0 to `max_power`, array of shape (max_power + 1, 2, 2)."""
        power_matrices = [np.eye(2)]
        for _ in range(max_power):
            power_matrices.append(self.matrix @ power_matrices[-1])
        return np.stack(power_matrices)

    def impact_responses(self, max_power: int) -> Float[np.ndarray, " powers"]:
        """Return C M^n E for n = 0 to `max_power`, array of shape (max_power + 1,)."""
        return -self.jump_coefficient * self.matrix_powers(max_power)[:, 0, 1]

    def first_positive_response(self) -> int | None:
        """Return the first n with C M^n E > 0; 0 without one up to `MAX_RETURNS`, None if rounding hides a sign."""
        responses, spectral_radius = self.impact_responses(MAX_RETURNS), abs(self.multipliers[0])
        if abs(responses[1]) <= ZERO_RESPONSE * self.jump_coefficient * abs(self.matrix).max():
            return None
        for n_returns in range(1, MAX_RETURNS + 1):
            if abs(responses[n_returns]) <= ZERO_RESPONSE * abs(responses[1]) * spectral_radius ** (n_returns - 1):
                return None
            if responses[n_returns] > 0:
                return n_returns
        return 0

    def added_impact_window(self, n_returns: int) -> AddedImpactWindow:
        """Return the `AddedImpactWindow` of n returns, for a stable grazing orbit."""
        responses, determinant = self.impact_responses(n_returns), np.linalg.det(self.matrix)
        trace = np.trace(self.matrix_powers(n_returns)[n_returns])
        fold_determinant, flip_determinant = 1.0 - trace + determinant**n_returns, 1.0 + trace + determinant**n_returns
        linear_coefficient = responses[n_returns] / fold_determinant
        later_return_responses = np.array(
            [(responses[k] + determinant**k * responses[n_returns - k]) / fold_determinant for k in range(1, n_returns)]
        )
        grazing_root = float((linear_coefficient - later_return_responses).min(initial=np.inf))
        fold_root, doubling_root = (
            root if 0.0 < root < grazing_root else np.nan
            for root in (0.5 * linear_coefficient, -0.5 * responses[n_returns] / flip_determinant)
        )
        min_stable_root = (
            np.nanmin([fold_root, doubling_root])
            if grazing_root > 0 and not np.isnan([fold_root, doubling_root]).all()
            else np.nan
        )
        return AddedImpactWindow(
            float(linear_coefficient), grazing_root, float(min_stable_root), float(fold_root), float(doubling_root)
        )


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
