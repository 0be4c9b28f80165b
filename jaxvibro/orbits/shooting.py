"""Solve for an `Orbit` by shooting: Newton's method with the stroboscopic map; also the response without impacts.

Shooting also finds orbits that stick or have no impact. Near a grazing it is less accurate than the equations of the
impacts (`orbit_from_impacts`).

Compute the periodic response to the drive without impacts, as a state and as an orbit. The response is the solution of
two linear equations, except under a user-defined force.
"""

import jax
import jax.numpy as jnp
import numpy as np

from continuation import newton
from continuation.hostcall import FAST_COMPILE, persistent_jit
from continuation.newton import solve

from ..compiled.kernel_calls import call_as_kernel
from ..compiled.lane_arithmetic import COMPILER_OPTIONS
from ..contact.kinds import flow_of_scene, fly_with_matrix
from ..flight import flow
from ..flight.flow_matrix import matrix_by_rows
from ..maps import itinerary as words
from ..maps.monodromy import strobe_with_monodromy
from ..maps.reference_strobe import REPLAY_SLOTS
from ..maps.sticking_phase_intervals import NO_STICKING, find_sticking_phases, may_stick
from ..scene.state import Impacts, State, Status, make_state_arrays
from .orbit import OrbitError, eigenvalue_pair, make_orbit

MAX_NEWTON_STEPS = 12
MAX_SLOTS = 512  # recorded impacts of a period with more than `REPLAY_SLOTS`


def orbit_from_state(scene, state, periods):
    """Solve for the orbit near a single state, with the section at the phase of this state. Raises OrbitError."""
    eps, step_size = float(np.finfo(scene.dtype).eps), np.inf
    for _ in range(MAX_NEWTON_STEPS):
        section_points, period_results, monodromy_matrix = _fly_periods(scene, state, periods)
        residual = section_points[-1] - section_points[0]
        state_scale = 1.0 + abs(section_points).max()
        if step_size <= eps**0.7 * state_scale or not residual.any():
            break
        state, step_size = _newton_step(state, period_results[-1][0], residual, monodromy_matrix)
    if residual.any() and (step_size > eps**0.7 * state_scale or abs(residual).max() > eps**0.4 * state_scale):
        raise OrbitError(
            newton.STATUS_TEXTS[newton.NOT_CONVERGED], float(abs(residual).max()), newton.ADVICE[newton.NOT_CONVERGED]
        )
    minimal_period = next(
        (
            n_periods
            for n_periods in range(1, periods)
            if periods % n_periods == 0
            and abs(section_points[n_periods] - section_points[0]).max() <= 1e-8 * state_scale
        ),
        periods,
    )
    if minimal_period < periods:
        return orbit_from_state(scene, state, minimal_period)
    itinerary = tuple(words.itinerary_of_rows(period_impacts.side[None])[0] for _, period_impacts in period_results)
    period_shift = words.canonical_start_period(itinerary, section_points[:-1])
    state = period_results[period_shift - 1][0] if period_shift else state
    impacts = _join_period_impacts(
        words.rotate_periods([period_impacts for _, period_impacts in period_results], period_shift),
        2.0 * np.pi / float(scene.frequency),
    )
    multiplier_pair = eigenvalue_pair(float(np.trace(monodromy_matrix)), float(np.linalg.det(monodromy_matrix)))
    state = jax.tree.map(float, state)
    can_stick = may_stick(
        scene,
        [period_impacts.status for _, period_impacts in period_results],
        [end_state.contact for end_state, _ in period_results],
    )
    sticking_record = find_sticking_phases(scene, state, periods) if can_stick else NO_STICKING
    return make_orbit(
        scene,
        state,
        impacts,
        words.rotate_periods(itinerary, period_shift),
        multiplier_pair,
        float(abs(residual).max()),
        "state",
        sticking_record,
    )


def strobe_period(scene, state):
    """Return (State, Impacts with the least clearance, monodromy matrix) after a drive period, as NumPy arrays."""
    state = make_state_arrays(scene, state)
    end, impacts, (a, b, c, d) = _strobe_period_compiled(scene, state)
    if impacts.count > REPLAY_SLOTS:
        end, impacts, (a, b, c, d) = jax.device_get(_strobe_many_impacts(scene, state))
    return end, impacts, np.array([[a, b], [c, d]])


@persistent_jit(compiler_options=COMPILER_OPTIONS, numpy_first=True)
def _strobe_period_compiled(scene, state):
    return call_as_kernel(strobe_with_monodromy, scene, state, periods=1, slots=REPLAY_SLOTS, clearance=True)


@persistent_jit(compiler_options=COMPILER_OPTIONS)
def _strobe_many_impacts(scene, state):
    return call_as_kernel(strobe_with_monodromy, scene, state, periods=1, slots=MAX_SLOTS, clearance=True)


_solve_linear = persistent_jit(compiler_options=FAST_COMPILE, numpy_first=True)(solve)


def _fly_periods(scene, state, periods):
    """Return (points on the section, of shape (periods + 1, 2); (state, impacts) of each period; monodromy matrix)."""
    section_points, period_results, monodromy_matrix = [(float(state.x), float(state.v))], [], np.eye(2)
    for _ in range(periods):
        state, impacts, period_matrix = strobe_period(scene, state)
        monodromy_matrix = period_matrix @ monodromy_matrix
        if impacts.status >= Status.CAP:
            reason = f"the motion from the state cannot be computed ({Status(int(impacts.status)).word})"
            raise OrbitError(reason, np.nan, "start between the walls, nearer to an orbit")
        section_points.append((float(state.x), float(state.v)))
        period_results.append((state, impacts))
    return np.array(section_points), period_results, monodromy_matrix


def _newton_step(state, end_state, residual, monodromy_matrix):
    """Return (next state, step size). The next state is the final state if that is independent of the initial state."""
    if not monodromy_matrix.any():
        return end_state, float(abs(residual).max())
    step, pivot_ratio, _ = _solve_linear(np.eye(2) - monodromy_matrix, residual)
    if not pivot_ratio > newton.SINGULAR_PIVOT_RATIO * np.finfo(step.dtype).eps:
        status = newton.SINGULAR
        raise OrbitError(newton.STATUS_TEXTS[status], float(abs(residual).max()), newton.ADVICE[status])
    return State(float(state.x) + step[0], float(state.v) + step[1], state.phase, 0.0), float(abs(step).max())


def _join_period_impacts(period_impacts, drive_period):
    """Join the impacts of several periods, without empty slots."""
    rows = [
        (impacts.time + period_index * drive_period, impacts.side, impacts.speed)
        for period_index, impacts in enumerate(period_impacts)
    ]
    is_impact = np.concatenate([side != 0 for _, side, _ in rows])
    time, side, speed = (np.concatenate(row)[is_impact] for row in zip(*rows, strict=True))
    least_speed, least_clearance = (
        min(float(getattr(impacts, field_name)) for impacts in period_impacts)
        for field_name in ("least_speed", "least_clearance")
    )
    status = max(int(impacts.status) for impacts in period_impacts)
    return Impacts(
        time, side, speed, sum(int(impacts.count) for impacts in period_impacts), least_speed, least_clearance, status
    )


MAX_FREE_NEWTON_STEPS = 20
STEP_TOLERANCE = 1e-12  # relative to 1 + the largest of x and v: size of the last step


def free_response(scene):
    """Return the `State` at phase 0 of the periodic motion without walls.

    `scene` is a single scene. Under a user-defined force, Newton's method starts from rest at 0. For the linear flow
    with several drive terms the first Newton step gives the motion. The result is nan at a resonance without damping,
    where no such motion exists, or if Newton's method does not converge.
    """
    if not flow_of_scene(scene).has_unique_free_response() or scene.drive:
        return _newton_solve_from_rest(scene)
    (p00, p01, p11), ((x, v), _) = _period_responses(scene)
    matrix = np.array([[1.0 - p00, -p01], [p01, 1.0 - p11]])
    drive_amplitude = float(scene.amplitude)
    try:
        state = np.linalg.solve(matrix, drive_amplitude * np.array([x, v]))
    except np.linalg.LinAlgError:
        state = np.full(2, np.nan)
    return State(float(state[0]), float(state[1]))


def _newton_solve_from_rest(scene):
    """Solve for the free response by Newton's method from rest at 0."""
    state = np.zeros(2)
    for _ in range(MAX_FREE_NEWTON_STEPS):
        (x, v), matrix = jax.device_get(_fly_free_period(scene, state))
        p00, p01, p10, p11 = matrix_by_rows(matrix)
        try:
            newton_step = np.linalg.solve(np.array([[1.0 - p00, -p01], [-p10, 1.0 - p11]]), state - np.array([x, v]))
        except np.linalg.LinAlgError:
            break
        state = state - newton_step
        if abs(newton_step).max() <= STEP_TOLERANCE * (1.0 + abs(state).max()):
            return State(float(state[0]), float(state[1]))
    return State(np.nan, np.nan)


@persistent_jit()
def _fly_free_period(scene, state):
    """Return ((x, v), flight matrix) after a flight of one drive period without walls."""
    return fly_with_matrix(scene, *state, jnp.zeros(()), 2.0 * jnp.pi / scene.frequency)


@persistent_jit(compiler_options=FAST_COMPILE, numpy_first=True)
def _period_responses(scene):
    """Return the `flow.flight_responses` over a drive period."""
    return flow.flight_responses(scene.frequency, scene.damping, jnp.asarray(2.0 * jnp.pi / scene.frequency))


def free_orbit(scene):
    """Return the free response as an orbit, P100, if it does not reach a wall.

    Parameters
    ----------
    scene : Scene
        A single scene.

    Returns
    -------
    Orbit or None
        The orbit; None if the free response does not exist or reaches a wall, or if the Jacobian is singular for lack
        of damping.
    """
    state = free_response(scene)
    end_state, impacts, _ = strobe_period(scene, state)
    tolerance = float(np.finfo(scene.dtype).eps) ** 0.5 * max(1.0, abs(state.x), abs(state.v))
    is_periodic = (
        max(abs(end_state.x - state.x), abs(end_state.v - state.v)) <= tolerance
    )  # false for a start within a soft wall
    if impacts.status != Status.OK or impacts.count or end_state.contact or not is_periodic:
        return None
    try:
        return orbit_from_state(scene, state, 1)
    except OrbitError:  # the Jacobian is singular: there is no damping
        return None
