"""Find sticking phases: a mass without relative speed stays on the wall until the contact force vanishes.

At a wall with R > 0 the relative speed vanishes after infinitely many bounces, complete chatter. At a wall with R = 0
it vanishes after one impact. The state after a sticking phase does not depend on the earlier motion. The derivative of
a period with a sticking phase is therefore zero, and both Lyapunov exponents are -inf.

Between sticking phases tangents grow or shrink. Let z be the state just after a release and t(z) the time of the next
onset of sticking. If the onset is earlier by dt, the speeds differ by g dt, where g is the contact force at t. Hence
``g |dt/dz|`` is the largest growth of tangents from the release to the onset, including all bounces. If the last impact
that is simulated has the time s and the speed u, then t = s + 2 R u / ((1 - R) g), because the contact force hardly
changes during the remaining bounces (Budd and Dux, Phil. Trans. R. Soc. A 347, 1994, 365-389).
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import ArrayLike, Float

from continuation.hostcall import persistent_jit

from ..compiled.lane_arithmetic import COMPILER_OPTIONS
from ..contact.contact_duration import multiply_2x2_matrices
from ..contact.kinds import make_flow_coefficients
from ..flight import integration_loop
from ..flight.flight_step import certified_step
from ..flight.flow_matrix import matrix_by_rows
from ..flight.impact import wall_state_and_force
from ..flight.motion_in_soft_wall import restitution_of
from ..flight.path_start import start_path
from ..scene.state import Contact, State, Status
from .monodromy import saltation_entries
from .strobe import strobe

MAX_PER_PERIOD = 32  # sticking phases per period that are distinguished


class StickingPhaseIntervals(NamedTuple):
    """Sticking phases within some drive periods of a periodic motion.

    Attributes
    ----------
    has_sticking : bool
        True if the mass sticks at some time.
    count : int
        Number of onsets of sticking.
    chatter_walls : {"", "L", "R", "LR"}
        Walls on which the mass comes to stick by complete chatter.
    growth_rate : float
        Sum of the logarithms of the largest growth of tangents from each release to the next onset of sticking,
        divided by the total time from the releases to the onsets in drive periods; nan without an onset or a release.
    intervals : tuple of tuple
        (side, time of the last simulated impact before the onset, time of the release) of each phase. Times are counted
        from the start. A release may lie beyond the last period. The time of the release is inf if
        the mass is never released.
    """

    has_sticking: bool
    count: int  # type: ignore[assignment]  # a tuple has a method of this name
    chatter_walls: str
    growth_rate: float
    intervals: tuple[tuple[float, float, float], ...]


NO_STICKING = StickingPhaseIntervals(False, 0, "", np.nan, ())


def may_stick(scene, status, contact):
    """Test for possible sticking: chatter, sticking at the end of a period, or a wall with R = 0.

    Parameters
    ----------
    scene : Scene
        A single scene.
    status : sequence of int
        Status of each period, computed with slots for all impacts.
    contact : sequence of float
        Contacts at the ends of the periods.

    Returns
    -------
    bool
        False if the mass certainly does not stick.
    """
    has_plastic_wall = any(float(scene.bounce(side)) == 0 for side in scene.walls)
    return bool(
        has_plastic_wall or np.any(np.asarray(status) == Status.FULL) or np.any(np.abs(contact) == Contact.STUCK)
    )


def find_sticking_phases(scene, state, periods):
    """Find the sticking phases of a periodic motion.

    Parameters
    ----------
    scene : Scene
        A single scene.
    state : State
        State on the motion, with concrete numbers.
    periods : int
        Number of drive periods of the motion.

    Returns
    -------
    StickingPhaseIntervals
        Sticking phases within these periods.
    """
    dtype = scene.dtype
    state = State(*(np.asarray(value, dtype).reshape(()) for value in (state.x, state.v, state.phase, state.contact)))
    starts_sticking, matrix_since_release, sticking_onsets, release_times = (
        abs(state.contact) == Contact.STUCK,
        MatrixSinceRelease(*np.array([1.0, 0.0, 0.0, 1.0, 0.0, np.nan], dtype)),
        [],
        [],
    )
    drive_period = 2.0 * np.pi / float(scene.frequency)
    for period_index in range(2 * periods):  # the first round yields the last release before the start
        matrix_since_release, onset_rows, period_release_times = jax.device_get(
            _scan_for_sticking(scene, state, matrix_since_release)
        )
        if period_index >= periods:
            period_start = drive_period * (period_index - periods)
            sticking_onsets += [
                (*onset_row, period_start + start_time)
                for *onset_row, start_time in zip(*onset_rows, strict=True)
                if onset_row[0]
            ]
            release_times += [
                period_start + float(release_time) for release_time in period_release_times if release_time >= 0
            ]
        state = jax.device_get(strobe(scene, state))[0]
    chatter_letters = {"L" if side < 0 else "R" for side, has_chatter, *_ in sticking_onsets if has_chatter}
    total_time_to_onsets = float(sum(time for *_, time, _ in sticking_onsets))
    growth_rate = (
        sum(log_growth for _, _, log_growth, *_ in sticking_onsets)
        * 2.0
        * np.pi
        / float(scene.frequency)
        / total_time_to_onsets
        if total_time_to_onsets
        else np.nan
    )
    intervals = _sticking_intervals(
        [(side, start_time) for side, *_, start_time in sticking_onsets], release_times, drive_period * periods
    )
    return StickingPhaseIntervals(
        bool(starts_sticking or sticking_onsets),
        len(sticking_onsets),
        "".join(sorted(chatter_letters)),
        float(growth_rate),
        intervals,
    )


def _sticking_intervals(onset_sides_and_starts, release_times, total_time):
    """Return (side, start, end) of each sticking phase; a phase may end in the next traversal of the motion."""
    all_release_times = sorted([*release_times, *(release_time + total_time for release_time in release_times)])
    intervals = []
    for side, onset_start in onset_sides_and_starts:
        release_time = next((release_time for release_time in all_release_times if release_time > onset_start), np.inf)
        intervals.append((float(side), float(onset_start), float(release_time)))
    return tuple(intervals)


class MatrixSinceRelease(NamedTuple):
    """Derivative of the state with respect to the state at the last release.

    Attributes
    ----------
    matrix_00, matrix_01, matrix_10, matrix_11 : array
        Entries of the matrix, divided by exp(`log_scale`).
    log_scale : array
        Logarithm of the factor by which the entries are divided.
    time_since_release : array
        Time since the release; nan before the first release.
    """

    matrix_00: Float[ArrayLike, ""]
    matrix_01: Float[ArrayLike, ""]
    matrix_10: Float[ArrayLike, ""]
    matrix_11: Float[ArrayLike, ""]
    log_scale: Float[ArrayLike, ""]
    time_since_release: Float[ArrayLike, ""]


@persistent_jit(compiler_options=COMPILER_OPTIONS)
def _scan_for_sticking(scene, state, matrix_since_release):
    """Scan one period for onsets and releases.

    Returns (`MatrixSinceRelease` after the period, rows of onsets, times of releases). Each onset has a side (0 for
    empty slots), a flag for chatter, the logarithm of the growth of tangents, the time from the last release to the
    onset, and the time of the last simulated impact since the start of the period. Empty slots of releases are -1.
    """
    coeffs = make_flow_coefficients(scene)
    path, start_status = start_path(coeffs, state)
    path = path._replace(time_remaining=jnp.where(start_status == Status.OK, coeffs.period, 0.0))
    max_steps, zero = integration_loop.loop_limits(coeffs, 1).max_steps, jnp.zeros_like(path.x)

    def advance_path(carry):
        path, matrix_since_release, n_onsets, n_steps, onset_rows, n_releases, release_times = carry
        flight_step = certified_step(coeffs, path)
        was_sticking, is_sticking = abs(path.contact) == Contact.STUCK, abs(flight_step.path.contact) == Contact.STUCK
        matrix_since_release, onset_row = _advance_matrix_by_step(
            coeffs, path, flight_step, matrix_since_release, was_sticking, is_sticking
        )
        is_onset, is_release = is_sticking & ~was_sticking, was_sticking & ~is_sticking
        step_end_time = coeffs.period - flight_step.path.time_remaining
        onset_index = jnp.where(is_onset, n_onsets, MAX_PER_PERIOD)
        onset_rows = tuple(
            old.at[onset_index].set(new, mode="drop")
            for old, new in zip(onset_rows, (*onset_row, step_end_time), strict=True)
        )
        release_times = release_times.at[jnp.where(is_release, n_releases, MAX_PER_PERIOD)].set(
            step_end_time, mode="drop"
        )
        return (
            flight_step.path,
            matrix_since_release,
            n_onsets + is_onset,
            n_steps + 1.0,
            onset_rows,
            n_releases + is_release,
            release_times,
        )

    onset_rows = tuple(jnp.zeros(MAX_PER_PERIOD, scene.dtype) for _ in range(5))
    zero_int = jnp.int32(0)
    initial_carry = (
        path,
        MatrixSinceRelease(*(entry + zero for entry in matrix_since_release)),
        zero_int,
        zero,
        onset_rows,
        zero_int,
        onset_rows[0] - 1.0,
    )
    _, matrix_since_release, _, _, onset_rows, _, release_times = lax.while_loop(
        lambda carry: (carry[0].time_remaining > 0) & (carry[3] < max_steps), advance_path, initial_carry
    )
    return _normalise_matrix(matrix_since_release), onset_rows, release_times


def _advance_matrix_by_step(coeffs, path, flight_step, matrix_since_release, was_sticking, is_sticking):
    """Return (`MatrixSinceRelease` after a step, data of an onset in this step).

    The data are the side, a flag for chatter, the logarithm of the growth, and the time since the last release.
    """
    side, step_time = flight_step.side, flight_step.time
    _, flow_matrix = coeffs.flow.fly_with_matrix(coeffs, path.x, path.v, path.cosine, path.sine, step_time)
    matrix, time_since_release = (
        multiply_2x2_matrices(matrix_by_rows(flow_matrix), matrix_since_release[:4]),
        matrix_since_release.time_since_release + step_time,
    )
    onset_row = (
        jnp.zeros_like(time_since_release),
        jnp.zeros_like(time_since_release),
        jnp.zeros_like(time_since_release),
        jnp.zeros_like(time_since_release),
    )
    if coeffs.walls:
        wall_side = jnp.where(side == 0, 1.0, side)
        speed, wall_restitution = (
            abs(flight_step.event_outcome.approach_speed),
            restitution_of(coeffs, wall_side) + 0.0 * time_since_release,
        )
        log_growth, chatter_duration = _log_growth_to_onset(
            coeffs, flight_step, wall_side, speed, wall_restitution, matrix
        )
        onset_row = (
            side,
            (wall_restitution > 0) + 0.0 * time_since_release,
            log_growth + matrix_since_release.log_scale,
            time_since_release + chatter_duration,
        )
        restitution_coeff, saltation_shear = saltation_entries(
            coeffs, wall_side, speed, flight_step.path.cosine, flight_step.path.sine
        )
        matrix_after_impact = multiply_2x2_matrices(
            (-restitution_coeff, 0.0 * time_since_release, saltation_shear, -restitution_coeff), matrix
        )
        is_impact = (side != 0) & ~was_sticking & ~is_sticking
        matrix = tuple(jnp.where(is_impact, new, old) for new, old in zip(matrix_after_impact, matrix, strict=True))
    is_release = was_sticking & ~is_sticking
    initial_fields = (1.0, 0.0, 0.0, 1.0, 0.0, 0.0)
    return MatrixSinceRelease(
        *(
            jnp.where(is_release, new, old)
            for new, old in zip(
                initial_fields, (*matrix, matrix_since_release.log_scale, time_since_release), strict=True
            )
        )
    ), onset_row


def _log_growth_to_onset(coeffs, flight_step, side, speed, restitution, matrix):
    """Return (logarithm of the growth of tangents up to an onset, duration of the remaining bounces).

    The growth is the contact force times the derivative of the onset time with respect to the released state. A change
    dx towards the wall makes the last simulated impact earlier by dx / speed. The speed of this impact determines the
    duration of the remaining bounces.
    """
    drive_cosine, drive_sine = flight_step.path.cosine, flight_step.path.sine
    wall_position, wall_velocity, contact_force, contact_force_rate = wall_state_and_force(
        coeffs, side, drive_cosine, drive_sine
    )
    contact_force, contact_force_rate = side * contact_force, side * contact_force_rate
    mass_acceleration, _ = coeffs.flow.acceleration_and_jerk(
        coeffs, wall_position, wall_velocity + side * speed, drive_cosine, drive_sine
    )
    wall_acceleration = (
        coeffs.flow.acceleration_and_jerk(coeffs, wall_position, wall_velocity, drive_cosine, drive_sine)[0]
        - side * contact_force
    )  # that of the wall
    chatter_time_per_speed = 2.0 * restitution / ((1.0 - restitution) * contact_force)
    impact_time_by_x = -side / speed
    onset_by_impact_time = (
        1.0
        + chatter_time_per_speed * side * (mass_acceleration - wall_acceleration)
        - chatter_time_per_speed * speed * contact_force_rate / contact_force
    )
    onset_by_x, onset_by_v = impact_time_by_x * onset_by_impact_time, chatter_time_per_speed * side
    onset_gradient_norm = jnp.hypot(
        onset_by_x * matrix[0] + onset_by_v * matrix[2], onset_by_x * matrix[1] + onset_by_v * matrix[3]
    )
    return jnp.log(
        (contact_force + contact_force_rate * chatter_time_per_speed * speed) * onset_gradient_norm
    ), chatter_time_per_speed * speed


def _normalise_matrix(matrix_since_release):
    """Scale the matrix so that its largest entry is 1."""
    largest_entry = jnp.max(abs(jnp.stack(matrix_since_release[:4])))
    largest_entry = jnp.where(largest_entry > 0, largest_entry, 1.0)
    return MatrixSinceRelease(
        *(entry / largest_entry for entry in matrix_since_release[:4]),
        matrix_since_release.log_scale + jnp.log(largest_entry),
        matrix_since_release.time_since_release,
    )
