"""Compute the impacts that follow an impact, forward or backward in time, and the clearances of flights.

The functions use NumPy, because the search for a chain requires single flights in many scenes. A flight is evaluated at
short steps by the matrix exponential of the linear system of x, v and the drive, which is exact to rounding. Within a
step, a cubic approximates the clearance with a known error bound. An impact is missed only if it penetrates a wall by
less than this bound. The time of an impact on a soft wall is the time of entry. The flight starts at the exit, which is
located in the same way.
"""

from typing import NamedTuple

import numpy as np
import scipy

from ..scene.scene import SIDES

STEP_FRACTION = 0.04  # step relative to the fastest time scale
MAX_STEPS = 20_000  # largest number of steps
N_SERIES_TERMS = 14  # terms of the power series within a step
MAX_ROOT_STEPS = 60  # largest number of iterations
ROOT_TOLERANCE = 1e-15  # tolerance of a root, relative to a step
# Steps evaluated together, about half an oscillation; smallest contact duration relative to a step.
STEPS_PER_BLOCK, MIN_CONTACT_FRACTION = 96, 1e-6
MAX_CONTACT_PERIODS = 8.0  # drive periods after which the search for the end of a contact phase stops


class Impact(NamedTuple):
    """Impact of the mass on a wall.

    Attributes
    ----------
    side : float
        Side of the wall, -1 left, 1 right.
    time : float
        Time of the impact.
    speed : float
        Speed before the impact, relative to the wall.
    """

    side: float
    time: float
    speed: float


class WallProperties(NamedTuple):
    """Motion and contact law of a wall.

    Attributes
    ----------
    sign : float
        Side of the wall: -1 left, 1 right.
    restitution : float
        Coefficient of restitution; -1 for a soft wall.
    position : float
        Mean position.
    amplitude, frequency, phase : float
        Parameters of the motion amplitude cos(frequency t + phase) about the mean position.
    stiffness : float or None
        Total stiffness 1 + k2 in contact with a soft wall. None for a rigid wall.
    damping : float or None
        Damping gamma2 in contact with a soft wall. None for a rigid wall.
    """

    sign: float
    restitution: float
    position: float
    amplitude: float
    frequency: float
    phase: float
    stiffness: float | None
    damping: float | None


class DriveTerm(NamedTuple):
    """Term of the drive: amplitude cos(frequency t + phase)."""

    amplitude: float
    frequency: float
    phase: float


class MotionPredictor:
    """Motions of a scene whose drive has a given phase at time 0, forward or backward in time.

    `time_direction` is 1 forward and -1 backward in time. A state consists of x, v, and the cosine and sine of each
    `DriveTerm`.
    """

    def __init__(self, scene, start_phase, time_direction=1):
        self.time_direction, self.phase, self.frequency = time_direction, start_phase, float(scene.frequency)
        self.walls = [make_wall_properties(scene, side, start_phase) for side in scene.walls]
        self.drive = [DriveTerm(float(scene.amplitude), self.frequency, start_phase)]
        for drive_term in scene.drive:
            term_phase = drive_term.harmonic * start_phase + float(drive_term.phase)
            self.drive.append(DriveTerm(float(drive_term.amplitude), drive_term.harmonic * self.frequency, term_phase))
        damping, state_size = float(scene.damping), 2 + 2 * len(self.drive)
        matrix = np.zeros((state_size, state_size))
        matrix[0, 1], matrix[1, :2] = 1.0, [-1.0, -2.0 * damping]
        self.matrix = time_direction * _insert_drive(matrix, self.drive, 2)
        max_rate = max(
            1.0, 2 * damping, *(term.frequency for term in self.drive), *(abs(wall.frequency) for wall in self.walls)
        )
        self.step = STEP_FRACTION / max_rate
        self.step_powers, self.contact_flows = np.eye(state_size)[None], {}

    def state_after_impact(self, side, time, speed):
        """Return the state (x, v, cos, sin, ...) and the time at the start of the flight after an impact.

        Backward in time, these are the state and the time at the end of the flight before the impact. Returns None if
        a contact phase in a soft wall does not end.
        """
        wall = self._wall_on_side(side)
        wall_velocity = wall_position_velocity(wall, time)[1]
        v = wall_velocity + side * speed * (-wall.restitution if self.time_direction > 0 else 1.0)
        if self.time_direction > 0 and wall.stiffness is not None:
            contact_exit = self._contact_phase_end(wall, time, v)
            if contact_exit is None:
                return None
            time, v = contact_exit
        return np.array([wall_position_velocity(wall, time)[0], v, *self._drive_phasors(time)]), time

    def _drive_phasors(self, time):
        """Return the cosine and sine of each term of the drive at a time."""
        angles = [term.frequency * time + term.phase for term in self.drive]
        return [trig_function(angle) for angle in angles for trig_function in (np.cos, np.sin)]

    def next_impacts(self, impact: Impact, end_time: float, max_impacts: int) -> list[Impact]:
        """Return the impacts that follow an impact in the time direction, at most `max_impacts`.

        Forward in time no impact is later than `end_time`, and backward in time none is earlier. Backward in time the
        list ends at an impact on a wall with restitution 0, because its speed does not follow from the motion after it.
        """
        impacts: list[Impact] = []
        while len(impacts) < max_impacts:
            if self.time_direction < 0 and self._wall_on_side(impact.side).restitution == 0:
                break
            impact = self._next_impact(impact, end_time)
            if impact is None:
                break
            impacts.append(impact)
        return impacts

    def min_clearances(self, nodes):
        """Return arrays (clearance, side, time) of the smallest clearance of each flight between impacts.

        A negative clearance is a penetration. The bound of the interpolation error is subtracted from the clearance.
        The result is inf if the clearance has no minimum during the flight, and -inf if the contact phase before the
        flight does not end.
        """
        flight_starts = [
            self.state_after_impact(*node_or_flight_start)
            for node_or_flight_start in zip(nodes.sides[:-1], nodes.time_or_x[:-1], nodes.speed_or_v[:-1], strict=True)
        ]
        is_stuck = np.array([node_or_flight_start is None for node_or_flight_start in flight_starts])
        flight_starts = [
            node_or_flight_start or (np.zeros(len(self.matrix)), time)
            for node_or_flight_start, time in zip(flight_starts, nodes.time_or_x, strict=False)
        ]
        start_states, start_times = (
            np.array(node_or_flight_start) for node_or_flight_start in zip(*flight_starts, strict=True)
        )
        flight_times = nodes.time_or_x[1:] - start_times
        step_matrices = self._matrices_of_steps(
            int(min(MAX_STEPS, np.ceil(np.max(flight_times, initial=0.0) / self.step)))
        )
        path_states = np.einsum("kij,fj->kfi", step_matrices, start_states)
        step_times, flight_indices = self.step * np.arange(len(step_matrices))[:, None], np.arange(len(flight_times))
        closest_clearances, sides, min_times = (
            np.full(len(flight_times), np.inf),
            np.zeros(len(flight_times)),
            start_times,
        )
        for wall in self.walls:
            clearance, clearance_rate = self._clearance_and_rate(wall, path_states, start_times + step_times)
            clearance[0] = np.where(nodes.sides[:-1] == wall.sign, 0.0, clearance[0])
            step_minima, time_in_step = _cubic_minima_of_steps(clearance, clearance_rate, self.step)
            time_in_flight = step_times[:-1] + time_in_step
            is_minimum = (
                (time_in_flight > 0)
                & (time_in_flight < flight_times)
                & ((time_in_step < self.step) | (step_minima < 0))
            )
            step_minima = np.where(is_minimum, step_minima, np.inf)
            lowest_step_index = np.argmin(step_minima, 0)
            is_nearer_wall = step_minima[lowest_step_index, flight_indices] < closest_clearances
            closest_clearances = np.where(
                is_nearer_wall, step_minima[lowest_step_index, flight_indices], closest_clearances
            )
            sides = np.where(is_nearer_wall, wall.sign, sides)
            min_times = np.where(
                is_nearer_wall, start_times + time_in_flight[lowest_step_index, flight_indices], min_times
            )
        return (
            np.where(is_stuck, -np.inf, closest_clearances - self._clearance_error_bound(path_states)),
            sides,
            min_times,
        )

    def _wall_on_side(self, side):
        return next(wall for wall in self.walls if wall.sign == side)

    def _matrices_of_steps(self, n_steps):
        """Return the matrices of 0 to `n_steps` steps."""
        step_matrix = scipy.linalg.expm(self.matrix * self.step) if len(self.step_powers) < 2 else self.step_powers[1]
        self.step_powers = _extend_matrix_powers(self.step_powers, step_matrix, max(n_steps + 1, 2))
        return self.step_powers[: n_steps + 1]

    def _clearance_and_rate(self, wall, path_states, time):
        """Return the clearance and its derivative along the time direction, for states along a path."""
        wall_position, wall_velocity = wall_position_velocity(wall, time)
        return wall.sign * (wall_position - path_states[..., 0]), self.time_direction * wall.sign * (
            wall_velocity - path_states[..., 1]
        )

    def _clearance_error_bound(self, path_states):
        """Return a bound of the deviation of the clearance from its cubic approximation, for each flight."""
        x_bound, v_bound = np.max(abs(path_states[..., 0]), 0), np.max(abs(path_states[..., 1]), 0)
        force_derivative_bounds = [
            sum(abs(drive_term.amplitude) * drive_term.frequency**derivative_order for drive_term in self.drive)
            for derivative_order in range(3)
        ]
        damping_rate = abs(self.matrix[1, 1])
        acceleration_bound = force_derivative_bounds[0] + damping_rate * v_bound + x_bound
        jerk_bound = force_derivative_bounds[1] + damping_rate * acceleration_bound + v_bound
        fourth_derivative_bound = force_derivative_bounds[2] + damping_rate * jerk_bound + acceleration_bound
        fourth_derivative_bound = fourth_derivative_bound + max(
            (abs(wall.amplitude) * wall.frequency**4 for wall in self.walls), default=0.0
        )
        return 1.1 * fourth_derivative_bound * self.step**4 / 384.0

    def _next_impact(self, impact, end_time):
        """Return the first `Impact` after an impact.

        Returns None if there is no impact up to `end_time`, or if a contact phase does not end.
        """
        flight_start = self.state_after_impact(*impact)
        if flight_start is None:
            return None
        start_state, start_time = flight_start
        n_steps = int(min(MAX_STEPS, np.ceil(max((end_time - start_time) * self.time_direction, 0.0) / self.step) + 1))
        path_states = self._matrices_of_steps(n_steps) @ start_state
        step_times = self.step * np.arange(len(path_states))
        earliest_step_and_impact = None
        for wall in self.walls:
            clearance, clearance_rate = self._clearance_and_rate(
                wall, path_states, start_time + self.time_direction * step_times
            )
            clearance[0] = 0.0 if wall.sign == impact.side else clearance[0]
            step_minima, times_of_minima = _cubic_minima_of_steps(clearance, clearance_rate, self.step)
            contact_step_indices = np.flatnonzero(step_minima < 0)
            if len(contact_step_indices) and (
                earliest_step_and_impact is None or contact_step_indices[0] <= earliest_step_and_impact[0]
            ):
                next_impact = self._impact_in_step(
                    wall,
                    path_states[contact_step_indices[0]],
                    start_time + self.time_direction * step_times[contact_step_indices[0]],
                    times_of_minima[contact_step_indices[0]],
                    contact_step_indices[0],
                )
                if next_impact is None:
                    return None
                if (
                    earliest_step_and_impact is None
                    or next_impact.time * self.time_direction < earliest_step_and_impact[1].time * self.time_direction
                ):
                    earliest_step_and_impact = contact_step_indices[0], next_impact
        if earliest_step_and_impact is None or (earliest_step_and_impact[1].time - end_time) * self.time_direction > 0:
            return None
        return earliest_step_and_impact[1]

    def _impact_in_step(self, wall, step_start_state, step_start_time, time_of_minimum, step_index):
        """Return the `Impact` in a step in which the clearance becomes negative.

        `time_of_minimum` is the time of the smallest clearance in the step. Returns None if a contact phase does not
        end."""
        state_at_time = _state_as_power_series(self.matrix, step_start_state)

        def clearance_and_state_at(elapsed_time):
            state = state_at_time(elapsed_time)
            return *self._clearance_and_rate(wall, state, step_start_time + self.time_direction * elapsed_time), state

        lower_time, upper_time = 0.0, time_of_minimum
        if step_index == 0 and clearance_and_state_at(0.0)[0] <= 1e-12:  # the root at 0 is the start of the flight
            lower_time = next(
                (
                    upper_time * 0.5**halving
                    for halving in range(1, 40)
                    if clearance_and_state_at(upper_time * 0.5**halving)[0] > 0
                ),
                0.0,
            )
        elapsed_time = _find_root(
            lambda elapsed_time: clearance_and_state_at(elapsed_time)[:2], lower_time, upper_time, self.step
        )
        _, clearance_rate, contact_state = clearance_and_state_at(elapsed_time)
        step_start_time = step_start_time + self.time_direction * elapsed_time
        if self.time_direction < 0 and wall.stiffness is not None:
            contact_exit = self._contact_phase_end(wall, step_start_time, contact_state[1])
            if contact_exit is None:
                return None
            step_start_time, v = contact_exit
            return Impact(
                wall.sign, step_start_time, max(wall.sign * (v - wall_position_velocity(wall, step_start_time)[1]), 0.0)
            )
        speed = max(-clearance_rate, 0.0) if self.time_direction > 0 else max(-clearance_rate, 0.0) / wall.restitution
        return Impact(wall.sign, step_start_time, speed)

    def _contact_phase_end(self, wall, time, v):
        """Return (time, velocity) at the other end of a contact phase, or None if the phase does not end."""
        matrix, step, step_matrices = self._contact_step_matrices(wall)
        wall_phase, (wall_position, _) = wall.frequency * time + wall.phase, wall_position_velocity(wall, time)
        state = np.array([wall_position, v, 1.0, np.cos(wall_phase), np.sin(wall_phase), *self._drive_phasors(time)])

        def penetration_and_rate(path_states, elapsed_time):
            wall_position, wall_velocity = wall_position_velocity(wall, time + self.time_direction * elapsed_time)
            return wall.sign * (path_states[..., 0] - wall_position), self.time_direction * wall.sign * (
                path_states[..., 1] - wall_velocity
            )

        max_contact_time, step_times, exit_step_indices = (
            min(MAX_STEPS * step, MAX_CONTACT_PERIODS * 2.0 * np.pi / self.frequency),
            np.zeros(1),
            np.zeros(0, int),
        )
        while not len(exit_step_indices):
            if step_times[-1] > max_contact_time:
                return None
            path_states, step_times = step_matrices @ state, step_times[-1] + step * np.arange(len(step_matrices))
            exit_step_indices, state = (
                np.flatnonzero(penetration_and_rate(path_states, step_times)[0][1:] <= 0.0),
                path_states[-1],
            )
        exit_step_start, state_at_time = (
            step_times[exit_step_indices[0]],
            _state_as_power_series(matrix, path_states[exit_step_indices[0]]),
        )
        lower_time = 0.0 if exit_step_start > 0 else MIN_CONTACT_FRACTION * step  # the root at 0 is the entry
        time_in_step = _find_root(
            lambda elapsed_time: penetration_and_rate(state_at_time(elapsed_time), exit_step_start + elapsed_time),
            lower_time,
            step,
            step,
        )
        return time + self.time_direction * (exit_step_start + time_in_step), float(state_at_time(time_in_step)[1])

    def _contact_step_matrices(self, wall):
        """Return the flow inside a soft wall: the matrix, a step, and the powers of the step matrix.

        The state is (x, v, 1, cosine and sine of the wall, cosines and sines of the drive).
        """
        if wall.sign not in self.contact_flows:
            state_size, wall_stiffness = 5 + 2 * len(self.drive), wall.stiffness - 1.0
            flow_matrix = np.zeros((state_size, state_size))
            wall_force_terms = wall_stiffness * wall.position, wall_stiffness * wall.amplitude, 0.0
            flow_matrix[0, 1], flow_matrix[1, :5] = 1.0, [-wall.stiffness, -2.0 * wall.damping, *wall_force_terms]
            flow_matrix[3, 4], flow_matrix[4, 3] = -wall.frequency, wall.frequency
            flow_matrix, drive_frequencies = (
                _insert_drive(flow_matrix, self.drive, 5),
                [term.frequency for term in self.drive],
            )
            step = STEP_FRACTION / max(
                np.sqrt(wall.stiffness), 2.0 * wall.damping, *drive_frequencies, abs(wall.frequency)
            )
            step_matrix = scipy.linalg.expm(self.time_direction * flow_matrix * step)
            self.contact_flows[wall.sign] = (
                self.time_direction * flow_matrix,
                step,
                _extend_matrix_powers(np.eye(state_size)[None], step_matrix, STEPS_PER_BLOCK),
            )
        return self.contact_flows[wall.sign]


def _insert_drive(flow_matrix, drive_terms, first_drive_index):
    """Insert the drive terms in a flow matrix; return the matrix.

    The states with an index of at least `first_drive_index` are the cosines and sines of the terms.
    """
    for cosine_index, term in zip(range(first_drive_index, len(flow_matrix), 2), drive_terms, strict=True):
        flow_matrix[1, cosine_index] = term.amplitude
        flow_matrix[cosine_index, cosine_index + 1], flow_matrix[cosine_index + 1, cosine_index] = (
            -term.frequency,
            term.frequency,
        )
    return flow_matrix


def make_wall_properties(scene, side, start_phase):
    """Return the `WallProperties` of a wall for a phase of the drive at time 0."""
    wall, sign = scene.walls[side], 1.0 if side == SIDES[1] else -1.0
    amplitude = frequency = wall_phase_at_zero = 0.0
    if wall.motion is not None:
        amplitude, frequency = float(wall.motion.amplitude), wall.motion.harmonic * float(scene.frequency)
        wall_phase_at_zero = float(wall.motion.phase) + wall.motion.harmonic * start_phase
    contact_law_params = (
        (1.0 + float(wall.stiffness), float(scene.parameter(f"{side}.damping"))) if wall.soft else (None, None)
    )
    return WallProperties(
        sign,
        float(scene.bounce(side)),
        float(wall.position),
        amplitude,
        frequency,
        wall_phase_at_zero,
        *contact_law_params,
    )


def wall_position_velocity(wall, time):
    """Return the position and the velocity of a wall at a time."""
    angle = wall.frequency * time + wall.phase
    return wall.position + wall.amplitude * np.cos(angle), -wall.amplitude * wall.frequency * np.sin(angle)


def _extend_matrix_powers(matrix_powers, matrix, n_powers):
    """Extend the powers of a matrix to at least `n_powers`."""
    while len(matrix_powers) < n_powers:
        matrix_powers = np.concatenate([matrix_powers, matrix_powers @ (matrix_powers[-1] @ matrix)])
    return matrix_powers


def _state_as_power_series(matrix, state):
    """Return the state within a step as a function of the elapsed time, from a power series."""
    series_terms = [state]
    for derivative_order in range(1, N_SERIES_TERMS):
        series_terms.append(matrix @ series_terms[-1] / derivative_order)

    def state_at(elapsed_time):
        series_sum = np.zeros(len(state))
        for series_term in series_terms[::-1]:
            series_sum = series_sum * elapsed_time + series_term
        return series_sum

    return state_at


def _find_root(value_and_rate, lower_time, upper_time, step):
    """Return the time between `lower_time` and `upper_time` at which a value changes from positive to negative."""
    root_time = 0.5 * (lower_time + upper_time)
    for _ in range(MAX_ROOT_STEPS):
        value, value_rate = value_and_rate(root_time)
        lower_time, upper_time = (root_time, upper_time) if value > 0 else (lower_time, root_time)
        newton_time = root_time - value / value_rate if value_rate < 0 else lower_time
        next_time = newton_time if lower_time < newton_time < upper_time else 0.5 * (lower_time + upper_time)
        if abs(next_time - root_time) <= ROOT_TOLERANCE * step:
            break
        root_time = next_time
    return root_time


def _cubic_minima_of_steps(clearance, clearance_rate, step):
    """Return the minimum of the cubic interpolant of the clearance in each step, and its time within the step.

    If the interpolant has no minimum in a step, or if its value at the end is smaller, the function returns the value
    and the time of the end.
    """
    start_values, end_values = clearance[:-1], clearance[1:]
    start_change_per_step, end_change_per_step = clearance_rate[:-1] * step, clearance_rate[1:] * step
    quadratic_coeff, cubic_coeff = (
        3 * (end_values - start_values) - 2 * start_change_per_step - end_change_per_step,
        2 * (start_values - end_values) + start_change_per_step + end_change_per_step,
    )
    discriminant = quadratic_coeff * quadratic_coeff - 3 * cubic_coeff * start_change_per_step
    has_minimum = (start_change_per_step < 0) & (end_change_per_step > 0) & (discriminant >= 0)
    discriminant_root = np.sqrt(np.where(has_minimum, discriminant, 1.0))
    # The root with positive curvature, without cancellation.
    minimum_fraction = np.where(
        quadratic_coeff > 0,
        -start_change_per_step / (quadratic_coeff + discriminant_root),
        (discriminant_root - quadratic_coeff) / np.where(cubic_coeff == 0, 1.0, 3 * cubic_coeff),
    )
    minimum_fraction = np.where(has_minimum, np.clip(minimum_fraction, 0.0, 1.0), 1.0)
    cubic_minimum = np.where(
        has_minimum,
        start_values
        + minimum_fraction
        * (start_change_per_step + minimum_fraction * (quadratic_coeff + minimum_fraction * cubic_coeff)),
        end_values,
    )
    return np.where(cubic_minimum < end_values, cubic_minimum, end_values), step * np.where(
        cubic_minimum < end_values, minimum_fraction, 1.0
    )
