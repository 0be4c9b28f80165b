"""Find sticking phases: a mass that has lost its relative speed stays on the wall until the contact force vanishes.

A wall with R > 0 takes the last speed by infinitely many bounces, complete chatter; one with R = 0 by one impact.
Sticking erases the past, so the derivative of a period with a sticking phase is zero, and both Lyapunov exponents are
-inf. Between sticking phases tangents do grow or shrink. Let z be the state just after a release, at a known phase, and
t(z) the time of the next onset of sticking. A motion that is earlier by dt differs in speed by g dt, where g is the
contact force at t. So ``g |dt/dz|`` is the growth of a small change of z up to the onset, and thus the largest growth
of tangents there, including all bounces. If bounces remain after a last impact at time s with speed u, then t = s + 2 R
u / ((1 - R) g), as the contact force hardly changes in this time (Budd and Dux, Phil. Trans. R. Soc. A 347, 1994,
365-389).
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import ArrayLike, Float

from continuation.persistent_jit import persistent_jit

from ..compiled.compiler_hints import COMPILER_OPTIONS
from ..flight import integrate
from ..flight.coefficients import compute_coefficients
from ..flight.entry import start_path
from ..flight.flow_matrix import matrix_by_rows
from ..flight.flows import flow_of
from ..flight.impact import wall_surface
from ..flight.soft_contact import restitution_of
from ..flight.step import certified_step
from ..scene.codes import Contact, Status
from ..scene.state import State
from .contact_duration import matrix_product
from .monodromy import saltation_entries
from .strobe import strobe

MAX_PER_PERIOD = 32  # sticking phases per period that are distinguished


class StickingPhases(NamedTuple):
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
        Largest growth rate of tangents between sticking phases, per drive period of the time between them; nan without
        one.
    intervals : tuple of tuple
        (side, time of the last impact that is flown before the onset, time of the release) of each phase, since the
        start. The first phase may have begun before the start.
    """

    has_sticking: bool
    count: int  # type: ignore[assignment]  # a tuple has a method of this name
    chatter_walls: str
    growth_rate: float
    intervals: tuple[tuple[float, float, float], ...]


NO_STICKING = StickingPhases(False, 0, "", np.nan, ())


def may_stick(scene, status, contact):
    """Test for possible sticking: chatter, sticking at the end of a period, or a wall with R = 0.

    Parameters
    ----------
    scene : Scene
        A single scene.
    status : sequence of int
        Statuses of the periods, with slots for all impacts.
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
        State on the motion, of plain numbers.
    periods : int
        Number of drive periods of the motion.

    Returns
    -------
    StickingPhases
        Sticking phases within these periods.
    """
    dtype = scene.dtype
    state = State(*(np.asarray(value, dtype).reshape(()) for value in (state.x, state.v, state.phase, state.contact)))
    starts_sticking, release_matrix, phases, release_times = (
        abs(state.contact) == Contact.STUCK,
        ReleaseMatrix(*np.array([1.0, 0.0, 0.0, 1.0, 0.0, np.nan], dtype)),
        [],
        [],
    )
    drive_period = 2.0 * np.pi / float(scene.frequency)
    for period in range(2 * periods):  # the first round yields the last release before the start
        release_matrix, rows, period_releases = jax.device_get(_scan_period(scene, state, release_matrix))
        if period >= periods:
            period_start = drive_period * (period - periods)
            phases += [(*row, period_start + start_time) for *row, start_time in zip(*rows, strict=True) if row[0]]
            release_times += [period_start + float(release) for release in period_releases if release >= 0]
        state = jax.device_get(strobe(scene, state))[0]
    letters = {"L" if side < 0 else "R" for side, has_chatter, *_ in phases if has_chatter}
    free_time = float(sum(time for *_, time, _ in phases))
    growth_rate = (
        sum(growth for _, _, growth, *_ in phases) * 2.0 * np.pi / float(scene.frequency) / free_time
        if free_time
        else np.nan
    )
    intervals = _sticking_intervals(
        [(side, start_time) for side, *_, start_time in phases], release_times, drive_period * periods
    )
    return StickingPhases(
        bool(starts_sticking or phases), len(phases), "".join(sorted(letters)), float(growth_rate), intervals
    )


def _sticking_intervals(side_and_start, release_times, total_time):
    """Return (side, start, end) of each sticking phase; a phase may end in the next round."""
    all_releases = sorted([*release_times, *(end + total_time for end in release_times)])
    intervals = []
    for side, start in side_and_start:
        end = next((end for end in all_releases if end > start), np.inf)
        intervals.append((float(side), float(start), float(end)))
    return tuple(intervals)


class ReleaseMatrix(NamedTuple):
    """Derivative since the last release, by rows, divided by exp(size), and the time since this release."""

    a: Float[ArrayLike, ""]
    b: Float[ArrayLike, ""]
    c: Float[ArrayLike, ""]
    d: Float[ArrayLike, ""]
    size: Float[ArrayLike, ""]
    age: Float[ArrayLike, ""]


@persistent_jit(compiler_options=COMPILER_OPTIONS)
def _scan_period(scene, state, release_matrix):
    """Scan one period for onsets and releases.

    Return the `ReleaseMatrix` after the period; of each onset the side (0 for none), a flag for chatter, growth, free
    time before it and time since the start of the period; and the times of the releases, -1 for none.
    """
    coeffs = compute_coefficients(scene)
    path, entry_status = start_path(coeffs, state)
    path = path._replace(time_remaining=jnp.where(entry_status == Status.OK, coeffs.period, 0.0))
    max_steps, zero = integrate.loop_limits(coeffs, 1).max_steps, jnp.zeros_like(path.x)

    def step_path(carry):
        path, release_matrix, n_phases, n_steps, rows, n_releases, release_times = carry
        step = certified_step(coeffs, path)
        was_sticking, is_sticking = abs(path.contact) == Contact.STUCK, abs(step.path.contact) == Contact.STUCK
        release_matrix, row = _advance_matrix(coeffs, path, step, release_matrix, was_sticking, is_sticking)
        is_onset, is_release = is_sticking & ~was_sticking, was_sticking & ~is_sticking
        event_time = coeffs.period - step.path.time_remaining
        index = jnp.where(is_onset, n_phases, MAX_PER_PERIOD)
        rows = tuple(old.at[index].set(new, mode="drop") for old, new in zip(rows, (*row, event_time), strict=True))
        release_times = release_times.at[jnp.where(is_release, n_releases, MAX_PER_PERIOD)].set(event_time, mode="drop")
        return (
            step.path,
            release_matrix,
            n_phases + is_onset,
            n_steps + 1.0,
            rows,
            n_releases + is_release,
            release_times,
        )

    rows = tuple(jnp.zeros(MAX_PER_PERIOD, scene.dtype) for _ in range(5))
    zero_int = jnp.int32(0)
    start = (
        path,
        ReleaseMatrix(*(entry + zero for entry in release_matrix)),
        zero_int,
        zero,
        rows,
        zero_int,
        rows[0] - 1.0,
    )
    _, release_matrix, _, _, rows, _, release_times = lax.while_loop(
        lambda carry: (carry[0].time_remaining > 0) & (carry[3] < max_steps), step_path, start
    )
    return _normalise(release_matrix), rows, release_times


def _advance_matrix(coeffs, path, step, release_matrix, was_sticking, is_sticking):
    """Return (`ReleaseMatrix` after a step; side, chatter flag, growth and free time of an onset in this step)."""
    side, step_time = step.side, step.time
    _, flow_matrix = flow_of(coeffs).fly_with_matrix(coeffs, path.x, path.v, path.cosine, path.sine, step_time)
    matrix, age = matrix_product(matrix_by_rows(flow_matrix), release_matrix[:4]), release_matrix.age + step_time
    row = jnp.zeros_like(age), jnp.zeros_like(age), jnp.zeros_like(age), jnp.zeros_like(age)
    if coeffs.walls:
        wall_side = jnp.where(side == 0, 1.0, side)
        speed, restitution = abs(step.outcome.approach_speed), restitution_of(coeffs, wall_side) + 0.0 * age
        growth, chatter_time = _onset_growth(coeffs, step, wall_side, speed, restitution, matrix)
        row = side, (restitution > 0) + 0.0 * age, growth + release_matrix.size, age + chatter_time
        restitution_coeff, shear = saltation_entries(coeffs, wall_side, speed, step.path.cosine, step.path.sine)
        impact_matrix = matrix_product((-restitution_coeff, 0.0 * age, shear, -restitution_coeff), matrix)
        is_impact = (side != 0) & ~was_sticking & ~is_sticking
        matrix = tuple(jnp.where(is_impact, new, old) for new, old in zip(impact_matrix, matrix, strict=True))
    is_release = was_sticking & ~is_sticking
    initial = (1.0, 0.0, 0.0, 1.0, 0.0, 0.0)
    return ReleaseMatrix(
        *(
            jnp.where(is_release, new, old)
            for new, old in zip(initial, (*matrix, release_matrix.size, age), strict=True)
        )
    ), row


def _onset_growth(coeffs, step, side, speed, restitution, matrix):
    """Return (ln of contact force times d(onset time)/d(released state), duration of the bounces).

    The last impact that is flown comes earlier by dx / speed; the duration of the bounces after it depends on its
    speed.
    """
    cosine, sine = step.path.cosine, step.path.sine
    wall_position, wall_velocity, contact_force, force_rate = wall_surface(coeffs, side, cosine, sine)
    contact_force, force_rate = side * contact_force, side * force_rate
    acceleration, _ = flow_of(coeffs).acceleration_and_jerk(
        coeffs, wall_position, wall_velocity + side * speed, cosine, sine
    )
    wall_acceleration = (
        flow_of(coeffs).acceleration_and_jerk(coeffs, wall_position, wall_velocity, cosine, sine)[0]
        - side * contact_force
    )  # that of the wall
    time_per_speed = 2.0 * restitution / ((1.0 - restitution) * contact_force)
    time_by_x = -side / speed
    onset_by_time = (
        1.0
        + time_per_speed * side * (acceleration - wall_acceleration)
        - time_per_speed * speed * force_rate / contact_force
    )
    onset_by_x, onset_by_v = time_by_x * onset_by_time, time_per_speed * side
    onset_shift = jnp.hypot(
        onset_by_x * matrix[0] + onset_by_v * matrix[2], onset_by_x * matrix[1] + onset_by_v * matrix[3]
    )
    return jnp.log((contact_force + force_rate * time_per_speed * speed) * onset_shift), time_per_speed * speed


def _normalise(release_matrix):
    """Scale the matrix so that its largest entry is 1."""
    largest = jnp.max(abs(jnp.stack(release_matrix[:4])))
    largest = jnp.where(largest > 0, largest, 1.0)
    return ReleaseMatrix(
        *(entry / largest for entry in release_matrix[:4]), release_matrix.size + jnp.log(largest), release_matrix.age
    )
