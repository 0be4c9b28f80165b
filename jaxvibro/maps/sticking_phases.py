"""Rests: a mass that has lost all of its speed against a wall stays on it until the wall, or the drive, lets it go.

A wall with R > 0 takes the last speed by infinitely many hops, complete chatter; one with R = 0 by one impact. A rest
forgets how it was come by, so the derivative of a period with a rest in it is zero and both exponents are -inf. What
does grow or shrink is between rests: let z be the state just after the mass was let go, at a known phase, and t(z) the
time at which it next comes to rest. A mass that moves on as that one does, but earlier by dt, has another speed by g
dt, g being the press of the wall at t: g abs(dt / dz) is how much a small change of z has grown when the rest begins,
and so the largest growth of tangents there, with all hops. For hops that remain after a last one at time s with speed
u, t = s + 2 R u / ((1 - R) g), as the press hardly changes then (Budd and Dux, Phil. Trans. R. Soc. A 347, 1994,
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

MAX_PER_PERIOD = 32  # rests of a period that are told apart


class StickingPhases(NamedTuple):
    """The rests of some drive periods of a periodic motion.

    has_sticking: whether there are any; count: how often the mass comes to rest; chatter_walls: letters of the walls on
    which it does so by complete chatter, "", "L", "R" or "LR"; growth_rate: the largest growth of tangents between
    rests, a drive period of the time between them, nan where there is none. intervals: of each rest the side, the time
    of the last impact before it that was flown, and when the wall lets go, since the start; the first may have begun
    before it."""

    has_sticking: bool
    count: int  # type: ignore[assignment]  # a tuple has a method of this name
    chatter_walls: str
    growth_rate: float
    intervals: tuple[tuple[float, float, float], ...]


NO_STICKING = StickingPhases(False, 0, "", np.nan, ())


def may_stick(scene, status, contact):
    """Whether the mass may rest on a wall: in some periods it chatters, ends one there, or a wall takes all its speed.

    status, contact: of the periods, the statuses with slots enough for all impacts.
    """
    has_plastic_wall = any(float(scene.bounce(side)) == 0 for side in scene.walls)
    return bool(
        has_plastic_wall or np.any(np.asarray(status) == Status.FULL) or np.any(np.abs(contact) == Contact.STUCK)
    )


def find_sticking_phases(scene, state, periods):
    """The `StickingPhases` of a periodic motion from a `State` of it on, numbers, over its so many periods."""
    dtype = scene.dtype
    state = State(*(np.asarray(value, dtype).reshape(()) for value in (state.x, state.v, state.phase, state.contact)))
    starts_sticking, release_matrix, phases, release_times = (
        abs(state.contact) == Contact.STUCK,
        ReleaseMatrix(*np.array([1.0, 0.0, 0.0, 1.0, 0.0, np.nan], dtype)),
        [],
        [],
    )
    drive_period = 2.0 * np.pi / float(scene.frequency)
    for period in range(2 * periods):  # the first time round tells since when the mass is free
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
    """(side, begin, end) of each rest, of which some may last on into the next time round."""
    all_releases = sorted([*release_times, *(end + total_time for end in release_times)])
    intervals = []
    for side, start in side_and_start:
        end = next((end for end in all_releases if end > start), np.inf)
        intervals.append((float(side), float(start), float(end)))
    return tuple(intervals)


class ReleaseMatrix(NamedTuple):
    """The derivative since the mass was last let go from a wall, by rows, over exp(size), and how long ago that was."""

    a: Float[ArrayLike, ""]
    b: Float[ArrayLike, ""]
    c: Float[ArrayLike, ""]
    d: Float[ArrayLike, ""]
    size: Float[ArrayLike, ""]
    age: Float[ArrayLike, ""]


@persistent_jit(compiler_options=COMPILER_OPTIONS)
def _scan_period(scene, state, release_matrix):
    """(`ReleaseMatrix` a period later; of the rests that begin in it: side, 0 none, whether by hops, growth, time
    before, time since the period's start; the times of releases since then, -1 none)."""
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
    """(`ReleaseMatrix` after a step, what a rest that begins there is told by: side, whether by hops, growth, time
    before)."""
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
    """(ln of the press times how much the rest's beginning moves with the state that was let go, the time of the hops).

    The last impact that is seen comes earlier by dx / speed; the hops after it last as long as its speed says.
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
    )  # the wall's own
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
    """The same with its largest entry 1."""
    largest = jnp.max(abs(jnp.stack(release_matrix[:4])))
    largest = jnp.where(largest > 0, largest, 1.0)
    return ReleaseMatrix(
        *(entry / largest for entry in release_matrix[:4]), release_matrix.size + jnp.log(largest), release_matrix.age
    )
