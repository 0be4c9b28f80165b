"""Compute the impacts that follow an impact, forward or backward in time, and the clearances of flights.

The functions use NumPy, because a search requires single flights in many scenes. A flight is evaluated at short steps,
exact to rounding (the matrix exponential of x, v and the drive). Between two steps the clearance is a cubic within a
known bound. An impact is missed only if it penetrates a wall by less than this bound. The time of an impact on a soft
wall is the time of entry. The flight starts at the exit, which is found in the same way.
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
    """Impact: side -1 or 1, time, speed before it."""

    side: float
    time: float
    speed: float


class WallMotion(NamedTuple):
    """Motion and contact law of a wall.

    `sign` of its side; `restitution`, -1 for a soft wall; `position`; `amplitude`, `frequency` and `phase` of its
    cosine; `stiffness` (1 + k2) and `damping` (gamma2) of a soft wall, None for a rigid wall.
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


class Motion:
    """Motions of a scene whose drive has a given phase at time 0.

    `time_direction` is 1 forward and -1 backward in time. A state consists of x, v, and the cosine and sine of each
    `DriveTerm`.
    """

    def __init__(self, scene, phase, time_direction=1):
        self.time_direction, self.phase, self.frequency = time_direction, phase, float(scene.frequency)
        self.walls = [make_wall_motion(scene, side, phase) for side in scene.walls]
        self.drive = [DriveTerm(float(scene.amplitude), self.frequency, phase)]
        for drive_term in scene.drive:
            angle = drive_term.harmonic * phase + float(drive_term.phase)
            self.drive.append(DriveTerm(float(drive_term.amplitude), drive_term.harmonic * self.frequency, angle))
        damping, n_states = float(scene.damping), 2 + 2 * len(self.drive)
        matrix = np.zeros((n_states, n_states))
        matrix[0, 1], matrix[1, :2] = 1.0, [-1.0, -2.0 * damping]
        self.matrix = time_direction * _insert_drive(matrix, self.drive, 2)
        max_rate = max(
            1.0, 2 * damping, *(term.frequency for term in self.drive), *(abs(wall.frequency) for wall in self.walls)
        )
        self.step = STEP_FRACTION / max_rate
        self.step_powers, self.contact_flows = np.eye(n_states)[None], {}

    def flight_start(self, side, time, speed):
        """Return the state (x, v, cos, sin, ...) and the time after an impact, or before it backward in time.

        Returns None if a soft wall does not release the mass.
        """
        wall = self._wall_on(side)
        wall_velocity = wall_state(wall, time)[1]
        v = wall_velocity + side * speed * (-wall.restitution if self.time_direction > 0 else 1.0)
        if self.time_direction > 0 and wall.stiffness is not None:
            contact_exit = self._contact_end(wall, time, v)
            if contact_exit is None:
                return None
            time, v = contact_exit
        return np.array([wall_state(wall, time)[0], v, *self._phasors(time)]), time

    def _phasors(self, time):
        """Return the cosine and sine of each term of the drive at a time."""
        angles = [term.frequency * time + term.phase for term in self.drive]
        return [trig_function(angle) for angle in angles for trig_function in (np.cos, np.sin)]

    def next_impacts(self, impact: Impact, end_time: float, max_impacts: int) -> list[Impact]:
        """Return the next impacts, at most `max_impacts`, no later (backward: no earlier) than `end_time`."""
        impacts: list[Impact] = []
        while len(impacts) < max_impacts:
            if self.time_direction < 0 and self._wall_on(impact.side).restitution == 0:
                break
            impact = self._next_impact(impact, end_time)
            if impact is None:
                break
            impacts.append(impact)
        return impacts

    def min_clearances(self, nodes):
        """Return (clearance, side, time) of the smallest clearance of each flight between impacts.

        A negative clearance is a penetration. The clearance is inf if the flight does not turn back near a wall. The
        interpolation error is subtracted.
        """
        flight_starts = [
            self.flight_start(*entry)
            for entry in zip(nodes.sides[:-1], nodes.first_unknown[:-1], nodes.second_unknown[:-1], strict=True)
        ]
        is_stuck = np.array([entry is None for entry in flight_starts])
        flight_starts = [
            entry or (np.zeros(len(self.matrix)), time)
            for entry, time in zip(flight_starts, nodes.first_unknown, strict=False)
        ]
        start_states, start_times = (np.array(entry) for entry in zip(*flight_starts, strict=True))
        flight_times = nodes.first_unknown[1:] - start_times
        step_matrices = self._step_matrices(int(min(MAX_STEPS, np.ceil(np.max(flight_times, initial=0.0) / self.step))))
        path = np.einsum("kij,fj->kfi", step_matrices, start_states)
        step_times, flight_indices = self.step * np.arange(len(step_matrices))[:, None], np.arange(len(flight_times))
        min_clearance, sides, min_times = np.full(len(flight_times), np.inf), np.zeros(len(flight_times)), start_times
        for wall in self.walls:
            clearance, clearance_rate = self._clearance(wall, path, start_times + step_times)
            clearance[0] = np.where(nodes.sides[:-1] == wall.sign, 0.0, clearance[0])
            minima, time_in_step = _cubic_minimum(clearance, clearance_rate, self.step)
            time_in_flight = step_times[:-1] + time_in_step
            is_minimum = (
                (time_in_flight > 0) & (time_in_flight < flight_times) & ((time_in_step < self.step) | (minima < 0))
            )
            minima = np.where(is_minimum, minima, np.inf)
            lowest_step = np.argmin(minima, 0)
            is_nearer = minima[lowest_step, flight_indices] < min_clearance
            min_clearance = np.where(is_nearer, minima[lowest_step, flight_indices], min_clearance)
            sides = np.where(is_nearer, wall.sign, sides)
            min_times = np.where(is_nearer, start_times + time_in_flight[lowest_step, flight_indices], min_times)
        return np.where(is_stuck, -np.inf, min_clearance - self._clearance_error(path)), sides, min_times

    def _wall_on(self, side):
        return next(wall for wall in self.walls if wall.sign == side)

    def _step_matrices(self, n_steps):
        """Return the matrices of 0 to `n_steps` steps."""
        step_matrix = scipy.linalg.expm(self.matrix * self.step) if len(self.step_powers) < 2 else self.step_powers[1]
        self.step_powers = _extend_powers(self.step_powers, step_matrix, max(n_steps + 1, 2))
        return self.step_powers[: n_steps + 1]

    def _clearance(self, wall, path, time):
        """Return the clearance and its rate along the time direction."""
        wall_position, wall_velocity = wall_state(wall, time)
        return wall.sign * (wall_position - path[..., 0]), self.time_direction * wall.sign * (
            wall_velocity - path[..., 1]
        )

    def _clearance_error(self, path):
        """Bound the deviation of the clearance from its cubic, for each flight."""
        x_bound, v_bound = np.max(abs(path[..., 0]), 0), np.max(abs(path[..., 1]), 0)
        force_bounds = [sum(abs(term.amplitude) * term.frequency**k for term in self.drive) for k in range(3)]
        damping_rate = abs(self.matrix[1, 1])
        second_bound = force_bounds[0] + damping_rate * v_bound + x_bound
        third_bound = force_bounds[1] + damping_rate * second_bound + v_bound
        fourth_bound = force_bounds[2] + damping_rate * third_bound + second_bound
        fourth_bound = fourth_bound + max((abs(wall.amplitude) * wall.frequency**4 for wall in self.walls), default=0.0)
        return 1.1 * fourth_bound * self.step**4 / 384.0

    def _next_impact(self, impact, end_time):
        """Return the first `Impact` after an impact, or None if there is none until a time."""
        flight_start = self.flight_start(*impact)
        if flight_start is None:
            return None
        start_state, start_time = flight_start
        n_steps = int(min(MAX_STEPS, np.ceil(max((end_time - start_time) * self.time_direction, 0.0) / self.step) + 1))
        path = self._step_matrices(n_steps) @ start_state
        step_times = self.step * np.arange(len(path))
        earliest = None
        for wall in self.walls:
            clearance, clearance_rate = self._clearance(wall, path, start_time + self.time_direction * step_times)
            clearance[0] = 0.0 if wall.sign == impact.side else clearance[0]
            minima, times_in_step = _cubic_minimum(clearance, clearance_rate, self.step)
            contact_steps = np.flatnonzero(minima < 0)
            if len(contact_steps) and (earliest is None or contact_steps[0] <= earliest[0]):
                next_impact = self._impact_in_step(
                    wall,
                    path[contact_steps[0]],
                    start_time + self.time_direction * step_times[contact_steps[0]],
                    times_in_step[contact_steps[0]],
                    contact_steps[0],
                )
                if next_impact is None:
                    return None
                if earliest is None or next_impact.time * self.time_direction < earliest[1].time * self.time_direction:
                    earliest = contact_steps[0], next_impact
        if earliest is None or (earliest[1].time - end_time) * self.time_direction > 0:
            return None
        return earliest[1]

    def _impact_in_step(self, wall, state, time, time_in_step, step_index):
        """Return the impact in a step in which the clearance becomes negative.

        Returns None for a soft wall that the mass never left.
        """
        state_series = _taylor_series(self.matrix, state)

        def clearance_at(elapsed_time):
            state_then = state_series(elapsed_time)
            return *self._clearance(wall, state_then, time + self.time_direction * elapsed_time), state_then

        lower, upper = 0.0, time_in_step
        if step_index == 0 and clearance_at(0.0)[0] <= 1e-12:  # the root at 0 is the start of the flight
            lower = next((upper * 0.5**k for k in range(1, 40) if clearance_at(upper * 0.5**k)[0] > 0), 0.0)
        elapsed_time = _find_root(lambda elapsed_time: clearance_at(elapsed_time)[:2], lower, upper, self.step)
        _, clearance_rate, contact_state = clearance_at(elapsed_time)
        time = time + self.time_direction * elapsed_time
        if self.time_direction < 0 and wall.stiffness is not None:
            contact_exit = self._contact_end(wall, time, contact_state[1])
            if contact_exit is None:
                return None
            time, v = contact_exit
            return Impact(wall.sign, time, max(wall.sign * (v - wall_state(wall, time)[1]), 0.0))
        speed = max(-clearance_rate, 0.0) if self.time_direction > 0 else max(-clearance_rate, 0.0) / wall.restitution
        return Impact(wall.sign, time, speed)

    def _contact_end(self, wall, time, v):
        """Return (time, velocity) at the other end of a contact phase, or None if it does not end."""
        matrix, step, step_matrices = self._contact_flow(wall)
        wall_phase, (wall_position, _) = wall.frequency * time + wall.phase, wall_state(wall, time)
        state = np.array([wall_position, v, 1.0, np.cos(wall_phase), np.sin(wall_phase), *self._phasors(time)])

        def penetration(path, elapsed_time):
            wall_position, wall_velocity = wall_state(wall, time + self.time_direction * elapsed_time)
            return wall.sign * (path[..., 0] - wall_position), self.time_direction * wall.sign * (
                path[..., 1] - wall_velocity
            )

        max_time, step_times, exit_steps = (
            min(MAX_STEPS * step, MAX_CONTACT_PERIODS * 2.0 * np.pi / self.frequency),
            np.zeros(1),
            np.zeros(0, int),
        )
        while not len(exit_steps):
            if step_times[-1] > max_time:
                return None
            path, step_times = step_matrices @ state, step_times[-1] + step * np.arange(len(step_matrices))
            exit_steps, state = np.flatnonzero(penetration(path, step_times)[0][1:] <= 0.0), path[-1]
        exit_step_time, state_series = step_times[exit_steps[0]], _taylor_series(matrix, path[exit_steps[0]])
        lower = 0.0 if exit_step_time > 0 else MIN_CONTACT_FRACTION * step  # the root at 0 is the entry
        time_in_step = _find_root(
            lambda elapsed_time: penetration(state_series(elapsed_time), exit_step_time + elapsed_time),
            lower,
            step,
            step,
        )
        return time + self.time_direction * (exit_step_time + time_in_step), float(state_series(time_in_step)[1])

    def _contact_flow(self, wall):
        """Return the flow inside a soft wall: the matrix, a step, and the powers of the step matrix.

        The state is (x, v, 1, cosine and sine of the wall, cosines and sines of the drive).
        """
        if wall.sign not in self.contact_flows:
            n_states, spring_stiffness = 5 + 2 * len(self.drive), wall.stiffness - 1.0
            matrix = np.zeros((n_states, n_states))
            force_coefficients = spring_stiffness * wall.position, spring_stiffness * wall.amplitude, 0.0
            matrix[0, 1], matrix[1, :5] = 1.0, [-wall.stiffness, -2.0 * wall.damping, *force_coefficients]
            matrix[3, 4], matrix[4, 3] = -wall.frequency, wall.frequency
            matrix, frequencies = _insert_drive(matrix, self.drive, 5), [term.frequency for term in self.drive]
            step = STEP_FRACTION / max(np.sqrt(wall.stiffness), 2.0 * wall.damping, *frequencies, abs(wall.frequency))
            step_matrix = scipy.linalg.expm(self.time_direction * matrix * step)
            self.contact_flows[wall.sign] = (
                self.time_direction * matrix,
                step,
                _extend_powers(np.eye(n_states)[None], step_matrix, STEPS_PER_BLOCK),
            )
        return self.contact_flows[wall.sign]


def _insert_drive(matrix, drive, first_index):
    """Insert the terms of the drive in a matrix, with cosines and sines from an index on."""
    for k, term in zip(range(first_index, len(matrix), 2), drive, strict=True):
        matrix[1, k] = term.amplitude
        matrix[k, k + 1], matrix[k + 1, k] = -term.frequency, term.frequency
    return matrix


def make_wall_motion(scene, side, phase):
    """Return the `WallMotion` of a wall for a phase of the drive at time 0."""
    wall, sign = scene.walls[side], 1.0 if side == SIDES[1] else -1.0
    amplitude = frequency = wall_phase = 0.0
    if wall.motion is not None:
        amplitude, frequency = float(wall.motion.amplitude), wall.motion.harmonic * float(scene.frequency)
        wall_phase = float(wall.motion.phase) + wall.motion.harmonic * phase
    contact_params = (
        (1.0 + float(wall.stiffness), float(scene.parameter(f"{side}.damping"))) if wall.soft else (None, None)
    )
    return WallMotion(
        sign, float(scene.bounce(side)), float(wall.position), amplitude, frequency, wall_phase, *contact_params
    )


def wall_state(wall, time):
    """Return the position and the velocity of a wall at a time."""
    angle = wall.frequency * time + wall.phase
    return wall.position + wall.amplitude * np.cos(angle), -wall.amplitude * wall.frequency * np.sin(angle)


def _extend_powers(powers, matrix, n_powers):
    """Extend the powers of a matrix to at least `n_powers`."""
    while len(powers) < n_powers:
        powers = np.concatenate([powers, powers @ (powers[-1] @ matrix)])
    return powers


def _taylor_series(matrix, state):
    """Return the state within a step as a function of the elapsed time."""
    terms = [state]
    for k in range(1, N_SERIES_TERMS):
        terms.append(matrix @ terms[-1] / k)

    def state_after(elapsed_time):
        total = np.zeros(len(state))
        for term in terms[::-1]:
            total = total * elapsed_time + term
        return total

    return state_after


def _find_root(value_and_rate, lower, upper, step):
    """Return the time at which a value changes from positive to negative."""
    root_time = 0.5 * (lower + upper)
    for _ in range(MAX_ROOT_STEPS):
        value, rate = value_and_rate(root_time)
        lower, upper = (root_time, upper) if value > 0 else (lower, root_time)
        newton_time = root_time - value / rate if rate < 0 else lower
        next_time = newton_time if lower < newton_time < upper else 0.5 * (lower + upper)
        if abs(next_time - root_time) <= ROOT_TOLERANCE * step:
            break
        root_time = next_time
    return root_time


def _cubic_minimum(clearance, clearance_rate, step):
    """Return the minimum of the cubic in each step, and its time within the step."""
    start_values, end_values = clearance[:-1], clearance[1:]
    start_slope, end_slope = clearance_rate[:-1] * step, clearance_rate[1:] * step
    quadratic, cubic = (
        3 * (end_values - start_values) - 2 * start_slope - end_slope,
        2 * (start_values - end_values) + start_slope + end_slope,
    )
    discriminant = quadratic * quadratic - 3 * cubic * start_slope
    has_minimum = (start_slope < 0) & (end_slope > 0) & (discriminant >= 0)
    discriminant_root = np.sqrt(np.where(has_minimum, discriminant, 1.0))
    # The root with positive curvature, without cancellation.
    minimum_position = np.where(
        quadratic > 0,
        -start_slope / (quadratic + discriminant_root),
        (discriminant_root - quadratic) / np.where(cubic == 0, 1.0, 3 * cubic),
    )
    minimum_position = np.where(has_minimum, np.clip(minimum_position, 0.0, 1.0), 1.0)
    minimum = np.where(
        has_minimum,
        start_values + minimum_position * (start_slope + minimum_position * (quadratic + minimum_position * cubic)),
        end_values,
    )
    return np.where(minimum < end_values, minimum, end_values), step * np.where(
        minimum < end_values, minimum_position, 1.0
    )
