"""Compute chunks of steps along a branch, locate the special points between steps and detect jumps between branches."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from . import arclength, augmented_systems
from .arclength import OUTSIDE, RUNNING, Point, TrackState
from .persistent_jit import persistent_jit
from .point_rows import map_fields, row_at

CHUNK_SIZE = 128  # steps attempted in a compiled call
POLISH_TOLERANCE = 1e-10  # Newton step, a length, after which the next step leaves only rounding errors
DETERMINANT_ROUNDOFF = 1e-13  # rounding error of determinants, relative to the largest
MIN_JUMP_STEP = 1e-4  # smallest step, a length, that can be a jump to another branch
MAX_HALVINGS, NEWTON_EVERY = 25, 6  # bisections of an interval; bisections between attempts of Newton's method
SAME_POINT_DISTANCE = 1e-6  # largest distance, a scaled length, between equal points
SEARCH_RADIUS_FACTOR = 10.0  # largest distance of Newton's method from its guess, relative to the step over the event
START_DISTANCE = 1e-8  # largest distance, a scaled length, of a special point that coincides with the start


class Event(NamedTuple):
    """Special point between two points of a branch.

    Attributes
    ----------
    kind : str
        "SN", "BP" or the label of a test function.
    row_before : int
        Row of the point before.
    length : float
        Length from that point along its tangent.
    z : ndarray
        The special point.
    residual : float
        Largest residual of its equations.
    """

    kind: str
    row_before: int
    length: float
    z: Float[np.ndarray, " unknowns"]
    residual: float


def unit_tangent(problem, z, scale, args, direction=None):
    """Compute the unit tangent at a regular point.

    Parameters
    ----------
    problem : Problem
        The problem.
    z : ndarray
        Point of shape (n + 1,).
    scale : ndarray
        Weights of the length.
    args : Any
        Further argument of its functions.
    direction : ndarray, optional
        Direction with which the tangent encloses an acute angle. None stands for increasing parameter.

    Returns
    -------
    ndarray
        Tangent of shape (n + 1,).
    """
    jacobian = np.asarray(augmented_systems.evaluate(problem, z, args)[1])
    return oriented_null_vector(jacobian, scale, direction)


def oriented_null_vector(jacobian, scale, direction=None):
    """Return the unit null vector of an (n, n + 1) matrix, without columns of weight 0, oriented along a direction."""
    is_used = scale > 0
    null_vector = np.zeros(len(scale))
    null_vector[is_used] = np.linalg.svd(jacobian[:, is_used])[2][-1]
    if direction is None:
        direction = np.zeros(len(scale))
        direction[-1] = 1.0
    sign = np.sign(np.sum(scale * scale * null_vector * direction)) or 1.0
    return sign * null_vector / np.linalg.norm(scale * null_vector)


def _track_uncompiled(problem, state, control, args, capacity, max_steps):
    return arclength.track(problem.function, problem.solve, state, control, args, capacity, max_steps)


@persistent_jit(static_argnums=(0, 4), numpy_first=_track_uncompiled)
def _track_chunk(problem, state, control, args, capacity, max_steps):
    return problem.runner(_track_with_runner, state, control, args, max_steps, problem=problem, capacity=capacity)


def _track_with_runner(state, control, args, max_steps, problem, capacity):
    return _track_uncompiled(problem, state, control, args, capacity, max_steps)


def take_step(problem, point, length, control, args):
    """Take one step from a point.

    Parameters
    ----------
    problem : Problem
        The problem.
    point : Point
        Point and its tangent.
    length : float
        Length of the step along the tangent.
    control : StepControl
        Step sizes and tolerance.
    args : Any
        Further argument of its functions.

    Returns
    -------
    Point
        The point of the branch; `converged` states whether Newton's method succeeded.
    """
    state = TrackState(point.z, point.tangent, np.float64(length), np.int32(RUNNING))
    return row_at(_track_chunk(problem, state, control, args, CHUNK_SIZE, np.int32(1))[1], 0)


def solve_with_fixed_entry(problem, z, index, value, control, args):
    """Solve for the point near z with one entry fixed, to rounding.

    Parameters
    ----------
    problem : Problem
        The problem.
    z : ndarray
        Approximate point.
    index : int
        Index of the fixed entry of z.
    value : float
        Its value.
    control : StepControl
        Step sizes and tolerance.
    args : Any
        Further argument of its functions.

    Returns
    -------
    Point
        The point; `converged` states whether Newton's method succeeded.
    """
    pinning_row = np.zeros(len(z))
    pinning_row[index] = 1.0 / control.scale[index] ** 2
    z_guess = np.array(z)
    z_guess[index] = value
    return take_step(
        problem,
        Point(z_guess, pinning_row, *[np.zeros(())] * 3, *[np.True_] * 2),
        0.0,
        polishing_control(problem, control),
        args,
    )


def polishing_control(problem, control):
    """Return the `StepControl` with which Newton's method ends at rounding, or at the noise of the equations."""
    return control._replace(tolerance=np.float64(max(POLISH_TOLERANCE, problem.noise_floor)))


def track_chunks(problem, state, control, args, first_steps=CHUNK_SIZE):
    """Compute a branch chunk by chunk.

    Parameters
    ----------
    problem : Problem
        The problem.
    state : TrackState
        State to start from.
    control : StepControl
        Step sizes, tolerance and bounds.
    args : Any
        Further argument of its functions.
    first_steps : int, optional
        Number of steps attempted in the first chunk. It doubles with each chunk up to `CHUNK_SIZE`.

    Yields
    ------
    points : Point
        Rows of points, the first of which is the last of the previous chunk.
    status : int
        Status of `arclength`; the iteration ends when it is not RUNNING.
    """
    start, max_steps = _first_point(problem, state, control, args), first_steps
    while True:
        state, points = _track_chunk(problem, state, control, args, CHUNK_SIZE, np.int32(max_steps))
        chunk, max_steps = _accepted_points(start, points), min(2 * max_steps, CHUNK_SIZE)
        yield chunk, int(state.status)
        if state.status != RUNNING:
            return
        start = row_at(chunk, -1)


def track_branches(problem, states, controls, args, on_chunk):
    """Compute several branches chunk by chunk, as the lanes of one compiled call.

    Parameters
    ----------
    problem : Problem
        The problem.
    states : list of TrackState
        State of each lane.
    controls : list of StepControl
        Control of each lane.
    args : list
        Further argument of each lane, alike in their shapes.
    on_chunk : callable
        Takes a lane's index and the points and status that `track_chunks` yields. It returns True to continue the lane,
        False or None to end it, or a `TrackState` to continue from.

    Notes
    -----
    The number of lanes is padded to a power of two.
    """
    starts = [_first_point(problem, *inputs) for inputs in zip(states, controls, args, strict=True)]
    n_idle = (1 << (len(states) - 1).bit_length()) - len(states)
    idle_states = [states[-1]._replace(status=np.int32(OUTSIDE))] * n_idle
    states = jax.tree.map(lambda *leaves: np.stack(leaves), *states, *idle_states)
    controls, args = (
        jax.tree.map(lambda *leaves: np.stack(leaves), *inputs, *inputs[-1:] * n_idle) for inputs in (controls, args)
    )
    while (states.status == RUNNING).any():
        lanes = np.flatnonzero(states.status == RUNNING)
        states, points = _track_lanes_chunk(problem, states, controls, args, CHUNK_SIZE)
        status = np.array(states.status)
        for lane in lanes:
            chunk = _accepted_points(starts[lane], jax.tree.map(lambda leaf, lane=lane: leaf[lane], points))
            starts[lane] = row_at(chunk, -1)
            next_state = on_chunk(int(lane), chunk, int(status[lane]))
            if isinstance(next_state, TrackState):
                states = jax.tree.map(
                    lambda leaf, entry, lane=lane: _replace_lane(leaf, lane, entry), states, next_state
                )
                starts[lane], status[lane] = (
                    _first_point(problem, next_state, *_lane_inputs(controls, args, lane)),
                    RUNNING,
                )
            elif not next_state:
                status[lane] = OUTSIDE
        states = states._replace(status=status)


def _replace_lane(leaf, lane, entry):
    leaf = np.array(leaf)
    leaf[lane] = entry
    return leaf


def _lane_inputs(controls, args, lane):
    return jax.tree.map(lambda leaf: leaf[lane], (controls, args))


@persistent_jit(static_argnums=(0, 4), numpy_first=True)
def _track_lanes_chunk(problem, states, controls, args, capacity):
    def track_lane(*inputs):
        return arclength.track(problem.function, problem.solve, *inputs, capacity)

    return jax.vmap(track_lane)(states, controls, args)


def _first_point(problem, state, control, args):
    """Return the `Point` at the start of a branch."""
    zero = np.zeros_like(state.step)
    start = take_step(problem, Point(state.z, state.tangent, *[zero] * 3, *[np.True_] * 2), 0.0, control, args)
    return start._replace(z=state.z, tangent=state.tangent, step=zero, accepted=np.True_)


def _accepted_points(start, points):
    """Join a start and the accepted points of a chunk."""
    return map_fields(
        lambda start_leaf, leaf: np.concatenate([np.asarray(start_leaf)[None], leaf[points.accepted]]), start, points
    )


@persistent_jit(static_argnums=(0, 1), numpy_first=True)
def _test_determinants(problem, test, zs, args):
    return jax.vmap(lambda z: jnp.linalg.det(test.matrix(z, args)))(zs)


def test_function_values(problem, points, args):
    """Return {label: determinant at each point} for the test functions of a problem."""
    n_rows = -(-len(points.z) // (CHUNK_SIZE + 1)) * (CHUNK_SIZE + 1)
    padded = np.concatenate([points.z, np.repeat(points.z[-1:], n_rows - len(points.z), axis=0)])
    return {
        test.label: np.asarray(_test_determinants(problem, test, padded, args))[: len(points.z)]
        for test in problem.test_functions
    }


def locate_events(problem, points, values, control, args, branch_points=None):
    """Locate the special points between points, in order.

    `values` are {label: values of the test function at each point}; `branch_points` are those that `find_jump` located.
    An event at the first point is omitted: it belongs to the points before, or the branch starts there.
    """
    events, values_by_kind = [], {"BP": points.determinant, "SN": points.tangent[:, -1]} | values
    for kind, kind_values in values_by_kind.items():
        signs = _signs_without_zeros(kind_values)
        for row_before in np.flatnonzero(signs[:-1] * signs[1:] < 0):
            # At a branch point the tangent may turn without a fold.
            crosses = kind == "SN" and any(other.row_before == row_before for other in events)
            event = (branch_points or {}).get(int(row_before)) if kind == "BP" else None
            if event is None:
                event = _locate_event(
                    problem, kind, points, int(row_before), kind_values, control, args, 1 if crosses else MAX_HALVINGS
                )
            if event is not None and np.linalg.norm(control.scale * (event.z - points.z[0])) > START_DISTANCE:
                events.append(event)
    return _remove_spurious_folds(events, control)


def find_jump(problem, points, control, args, is_past_singularity=None):
    """Find the first point that lies on another branch than the point before it.

    Returns its row, or None, and the branch points before it by the row before each. At a jump the determinant changes
    sign without a branch point. `is_past_singularity` marks points that lie beyond a known singularity; these count as
    jumps.
    """
    signs, branch_points = _signs_without_zeros(points.determinant), {}
    for row_before in np.flatnonzero((signs[:-1] * signs[1:] < 0) & (points.step[1:] > MIN_JUMP_STEP)):
        event = None
        if is_past_singularity is None or not is_past_singularity[row_before + 1]:
            event = _locate_event(problem, "BP", points, int(row_before), points.determinant, control, args)
        if event is None:
            return int(row_before) + 1, branch_points
        branch_points[int(row_before)] = event
    return None, branch_points


def _signs_without_zeros(values):
    """Return the signs of values; a zero takes the sign before it, at the start the first one after it."""
    signs = np.where(abs(values) <= DETERMINANT_ROUNDOFF * abs(values).max(), 0.0, np.sign(values))
    for index in np.flatnonzero(signs == 0):
        signs[index] = signs[index - 1] if index else next((sign for sign in signs if sign), 0.0)
    return signs


def _locate_event(problem, kind, points, row_before, values, control, args, max_halvings=MAX_HALVINGS):
    """Locate the event between two points; None if Newton's method does not converge there."""
    base = row_at(points, row_before)
    lower, upper = 0.0, float(points.step[row_before + 1])
    guess = upper * values[row_before] / (values[row_before] - values[row_before + 1])
    for halving in range(max_halvings):
        trial = take_step(problem, base, guess, control, args)
        if halving % NEWTON_EVERY == 0:
            event = _event_between(problem, kind, base, row_before, (lower, upper), trial, guess, control, args)
            if event is not None:
                return event
        if trial.converged and _event_sign(problem, kind, base, args) * _event_sign(problem, kind, trial, args) > 0:
            lower = guess
        else:
            upper = guess
        guess = 0.5 * (lower + upper)
    return None


def _event_between(problem, kind, base, row_before, interval, trial, guess, control, args):
    """Return the event to which Newton's method converges from a guess; None if it is not between two lengths."""
    lower, upper = interval
    z = trial.z if trial.converged else base.z + guess * base.tangent
    with np.errstate(divide="ignore"):  # entries of weight 0 have no largest distance
        max_distance = SEARCH_RADIUS_FACTOR * upper / control.scale
    solution = _polish_event(problem, kind, z, args, max_distance)
    if solution.z is None:
        return None
    length = float(np.sum(control.scale**2 * base.tangent * (solution.z - base.z)))
    margin = 0.05 * (upper - lower)
    if not lower - margin <= length <= upper + margin:
        return None
    return Event(kind, row_before, min(max(length, lower), upper), solution.z, solution.residual)


def _event_sign(problem, kind, point, args):
    """Return the sign that changes at events of a kind."""
    if kind in ("SN", "BP"):
        return np.sign(point.tangent[-1] if kind == "SN" else point.determinant)
    (test,) = (test for test in problem.test_functions if test.label == kind)
    return np.linalg.slogdet(augmented_systems.matrix_and_derivative(problem, test, point.z, args)[0])[0]


def _polish_event(problem, kind, z, args, max_distance):
    """Locate an event by Newton's method; the `PointSolution` has no z if it is invalid."""
    if kind == "SN":
        solution = augmented_systems.locate_fold(problem, z, args, max_distance)
    elif kind == "BP":
        solution = augmented_systems.locate_branch_point(problem, z, args, max_distance)
    else:
        solution = _polish_test_event(problem, kind, z, args, max_distance)
    return (
        solution
        if solution.z is None or problem.is_valid(solution.z, args)
        else augmented_systems.PointSolution(None, np.nan)
    )


def _polish_test_event(problem, kind, z, args, max_distance):
    (test,) = (test for test in problem.test_functions if test.label == kind)
    solution = augmented_systems.locate_singularity(problem, test, z, args, max_distance)
    if solution.z is None or test.is_valid(solution.z, args):
        return solution
    return augmented_systems.PointSolution(None, np.nan)


def _remove_spurious_folds(events, control):
    """Sort events and remove folds that coincide with branch points.

    If a branch is crossed at its own turning point, both are detected; the event is a branch point.
    """
    crossings = [event for event in events if event.kind == "BP"]
    genuine = [
        event
        for event in events
        if event.kind != "SN"
        or not any(
            np.linalg.norm(control.scale * (event.z - crossing.z)) < SAME_POINT_DISTANCE for crossing in crossings
        )
    ]
    return sorted(genuine, key=lambda event: (event.row_before, event.length))


def find_near_passes(points, targets, control):
    """Return (row before, length, index of the target) where points pass close to targets in z.

    The targets may lie on the same branch; confirm with `take_step`.
    """
    passes = []
    weights = control.scale**2
    for target_index, target in enumerate(targets):
        offsets = target - points.z[:-1]
        lengths = np.einsum("ik,ik->i", offsets, weights * points.tangent[:-1])
        distances = np.linalg.norm(control.scale * (offsets - lengths[:, None] * points.tangent[:-1]), axis=1)
        step_lengths = points.step[1:]
        is_ahead = lengths > 0
        if points.step[0] == 0:  # the branch begins at the first point: a target within rounding is that point
            is_ahead[:1] = lengths[:1] > START_DISTANCE
        for row_before in np.flatnonzero(is_ahead & (lengths <= step_lengths) & (distances < 0.5 * step_lengths)):
            passes.append((int(row_before), float(lengths[row_before]), target_index))
    return sorted(passes)


def find_pass(problem, points, targets, control, args):
    """Return (row before, length from it) where the branch first passes through one of the targets, or None."""
    for row_before, length, target_index in find_near_passes(points, targets, control):
        base = row_at(points, row_before)
        point = take_step(problem, base, length, control, args)
        if point.converged and np.linalg.norm(control.scale * (point.z - targets[target_index])) < SAME_POINT_DISTANCE:
            return row_before, length
    return None
