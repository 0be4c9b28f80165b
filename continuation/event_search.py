"""Search events along a branch: chunks of steps, special points between steps, and points where branches end."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from . import arclength, augmented_systems
from .arclength import RUNNING, make_start_point, make_track_state
from .branch_segment import first_rows, insert_row, map_fields, row_at
from .hostcall import persistent_jit


def find_bracketed_root(function, upper_end):
    """Find the root of a function between 0 and `upper_end`, accurate to 1e-14, by Chandrupatla's method.

    Parameters
    ----------
    function : callable
        Function of one number with different signs at 0 and `upper_end`.
    upper_end : float
        Upper end of the interval.

    Returns
    -------
    float
        The root, accurate to ``1e-14*(1 + abs(root))``.

    Notes
    -----
    The method combines bisection and inverse quadratic interpolation (Advances in Engineering Software 28, 145, 1997).
    SciPy's root finders are not used, because importing them would take as long as all other imports.
    """
    newest_point, opposite_point, previous_point = (
        upper_end,
        0.0,
        0.0,
    )  # newest point, point of opposite sign, previous point
    f_newest, f_opposite, f_previous = function(newest_point), function(opposite_point), 0.0
    step_fraction = 0.5
    while True:
        trial_point = newest_point + step_fraction * (opposite_point - newest_point)
        value = function(trial_point)
        if value * f_newest > 0:
            previous_point, f_previous = newest_point, f_newest
        else:
            opposite_point, f_opposite, previous_point, f_previous = newest_point, f_newest, opposite_point, f_opposite
        newest_point, f_newest = trial_point, value
        best_point = newest_point if abs(f_newest) < abs(f_opposite) else opposite_point
        min_fraction = 1e-14 * (1.0 + abs(best_point)) / abs(opposite_point - newest_point)
        if f_newest == 0 or min_fraction > 0.5:
            return best_point
        point_ratio, value_ratio = (
            (newest_point - opposite_point) / (previous_point - opposite_point),
            (f_newest - f_opposite) / (f_previous - f_opposite),
        )
        step_fraction = 0.5
        if value_ratio * value_ratio < point_ratio and (1.0 - value_ratio) ** 2 < 1.0 - point_ratio:
            step_fraction = f_newest / (f_opposite - f_newest) * f_previous / (f_opposite - f_previous) + (
                previous_point - newest_point
            ) / (opposite_point - newest_point) * f_newest / (f_previous - f_newest) * f_opposite / (
                f_previous - f_opposite
            )
        step_fraction = min(max(step_fraction, min_fraction), 1.0 - min_fraction)


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
        Row of the point before the special point.
    length : float
        Length from the point before, along the tangent of that point.
    z : ndarray
        The special point.
    residual : float
        Largest residual of the equations of the special point.
    """

    kind: str
    row_before: int
    length: float
    z: Float[np.ndarray, " unknowns"]
    residual: float


def unit_tangent(problem, z, scale, constants, reference_direction=None):
    """Compute the unit tangent at a regular point.

    Parameters
    ----------
    problem : Problem
        The problem.
    z : ndarray
        Point of shape (n + 1,).
    scale : ndarray
        Weights of the length.
    constants : Any
        Further argument of the functions of the problem.
    reference_direction : ndarray, optional
        Direction with which the tangent encloses an acute angle. None stands for increasing parameter.

    Returns
    -------
    ndarray
        Tangent of shape (n + 1,).
    """
    jacobian = np.asarray(augmented_systems.evaluate_problem(problem, z, constants)[1])
    return oriented_null_vector(jacobian, scale, reference_direction)


def oriented_null_vector(jacobian, scale, reference_direction=None):
    """Return the unit null vector of an (n, n + 1) matrix, oriented along a reference direction.

    The null vector and the direction enclose an acute angle. None stands for increasing parameter. Columns of weight 0
    are excluded.
    """
    has_weight = scale > 0
    null_vector = np.zeros(len(scale))
    null_vector[has_weight] = np.linalg.svd(jacobian[:, has_weight])[2][-1]
    if reference_direction is None:
        reference_direction = np.zeros(len(scale))
        reference_direction[-1] = 1.0
    orientation_sign = np.sign(np.sum(scale * scale * null_vector * reference_direction)) or 1.0
    return orientation_sign * null_vector / np.linalg.norm(scale * null_vector)


@persistent_jit(static_argnums=0, numpy_first=True)
def _track_chunk(problem, state, control, constants, max_steps):
    return problem.runner(_track_inside_runner, state, control, constants, max_steps, problem=problem)


def _track_inside_runner(state, control, constants, max_steps, problem):
    return arclength.track_branch(problem.function, problem.solve, state, control, constants, CHUNK_SIZE, max_steps)


def take_step(problem, base_point, length, control, constants):
    """Take one step from a point.

    Parameters
    ----------
    problem : Problem
        The problem.
    base_point : Point
        Point and its tangent.
    length : float
        Length of the step along the tangent.
    control : StepControl
        Step sizes and tolerance.
    constants : Any
        Further argument of the functions of the problem.

    Returns
    -------
    Point
        The point of the branch; `converged` states whether Newton's method succeeded.
    """
    state = make_track_state(base_point, length)
    return row_at(_track_chunk(problem, state, control, constants, np.int32(1))[1], 0)


def solve_with_fixed_entry(problem, z, index, value, control, constants):
    """Compute the point near z with one fixed entry, to rounding accuracy.

    Parameters
    ----------
    problem : Problem
        The problem.
    z : ndarray
        Approximate point.
    index : int
        Index of the fixed entry of z.
    value : float
        Value of the fixed entry.
    control : StepControl
        Step sizes and tolerance.
    constants : Any
        Further argument of the functions of the problem.

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
        make_start_point(z_guess, pinning_row),
        0.0,
        polishing_control(problem, control),
        constants,
    )


def polishing_control(problem, control):
    """Return a `StepControl` for points that are accurate to rounding errors or to the noise of the equations.

    The tolerance is `POLISH_TOLERANCE`, or `Problem.noise_floor` if this is larger.
    """
    return control._replace(tolerance=np.float64(max(POLISH_TOLERANCE, problem.noise_floor)))


def track_chunks(problem, state, control, constants, n_first_steps=CHUNK_SIZE):
    """Compute a branch chunk by chunk.

    Parameters
    ----------
    problem : Problem
        The problem.
    state : TrackState
        State to start from.
    control : StepControl
        Step sizes, tolerance and bounds.
    constants : Any
        Further argument of the functions of the problem.
    n_first_steps : int, optional
        Number of steps attempted in the first chunk. It doubles with each chunk up to `CHUNK_SIZE`.

    Yields
    ------
    points : Point
        Points of a chunk, one row each. The first row is the last row of the previous chunk.
    status : int
        Status of `arclength`; the iteration ends when the status is not RUNNING.
    """
    start_point, max_steps = _evaluate_start(problem, state, control, constants), n_first_steps
    while True:
        state, attempted_points = _track_chunk(problem, state, control, constants, np.int32(max_steps))
        chunk_points, max_steps = _join_accepted_points(start_point, attempted_points), min(2 * max_steps, CHUNK_SIZE)
        yield chunk_points, int(state.status)
        if state.status != RUNNING:
            return
        start_point = row_at(chunk_points, -1)


def _evaluate_start(problem, state, control, constants):
    """Return the `Point` at the start of a branch."""
    start_point = make_start_point(state.z, state.tangent)
    point = take_step(problem, start_point, 0.0, control, constants)
    return point._replace(z=state.z, tangent=state.tangent, step=start_point.step, accepted=np.True_)


def _join_accepted_points(start_point, points):
    """Join the starting point and the accepted points of a chunk."""
    return map_fields(
        lambda start_leaf, leaf: np.concatenate([np.asarray(start_leaf)[None], leaf[points.accepted]]),
        start_point,
        points,
    )


@persistent_jit(static_argnums=(0, 1), numpy_first=True)
def _test_determinants(problem, test_function, zs, constants):
    return jax.vmap(lambda z: jnp.linalg.det(test_function.matrix(z, constants)))(zs)


def test_function_values(problem, points, constants):
    """Return {label: determinants of the matrix at the points} for the test functions of a problem."""
    n_padded_rows = -(-len(points.z) // (CHUNK_SIZE + 1)) * (CHUNK_SIZE + 1)
    padded_zs = np.concatenate([points.z, np.repeat(points.z[-1:], n_padded_rows - len(points.z), axis=0)])
    return {
        test_function.label: np.asarray(_test_determinants(problem, test_function, padded_zs, constants))[
            : len(points.z)
        ]
        for test_function in problem.test_functions
    }


def locate_events(problem, points, test_values, control, constants, known_branch_points=None):
    """Locate the special points between points, in order.

    `test_values` is {label: values of a test function at the points}. `known_branch_points` contains the branch points
    that `find_jump` located. An event at the first point is omitted: it belongs to the previous chunk, or is the start
    of the branch.
    """
    events, values_by_kind = [], {"BP": points.determinant, "SN": points.tangent[:, -1]} | test_values
    for kind, kind_values in values_by_kind.items():
        test_signs = _signs_without_zeros(kind_values)
        for row_before in np.flatnonzero(test_signs[:-1] * test_signs[1:] < 0):
            # At a branch point the tangent may turn without a fold.
            has_branch_point = kind == "SN" and any(other_event.row_before == row_before for other_event in events)
            event = (known_branch_points or {}).get(int(row_before)) if kind == "BP" else None
            if event is None:
                event = _locate_event(
                    problem,
                    kind,
                    points,
                    int(row_before),
                    kind_values,
                    control,
                    constants,
                    1 if has_branch_point else MAX_HALVINGS,
                )
            if event is not None and np.linalg.norm(control.scale * (event.z - points.z[0])) > START_DISTANCE:
                events.append(event)
    return _remove_spurious_folds(events, control)


def find_jump(problem, points, control, constants, is_past_singularity=None):
    """Find the first point that lies on another branch than the point before it.

    Returns the row of this point, or None, and {row before: `Event`} of the branch points before it. At a jump the
    determinant changes sign without a branch point. `is_past_singularity` marks points beyond a known singularity. A
    change of sign at a marked point counts as a jump. Changes of sign over steps up to `MIN_JUMP_STEP` are ignored.
    """
    determinant_signs, known_branch_points = _signs_without_zeros(points.determinant), {}
    for row_before in np.flatnonzero(
        (determinant_signs[:-1] * determinant_signs[1:] < 0) & (points.step[1:] > MIN_JUMP_STEP)
    ):
        event = None
        if is_past_singularity is None or not is_past_singularity[row_before + 1]:
            event = _locate_event(problem, "BP", points, int(row_before), points.determinant, control, constants)
        if event is None:
            return int(row_before) + 1, known_branch_points
        known_branch_points[int(row_before)] = event
    return None, known_branch_points


def _signs_without_zeros(values):
    """Return the signs of values, without zeros.

    A value counts as zero if its magnitude is at most `DETERMINANT_ROUNDOFF` times the largest magnitude. A zero takes
    the preceding sign; zeros at the start take the first nonzero sign.
    """
    signs = np.where(abs(values) <= DETERMINANT_ROUNDOFF * abs(values).max(), 0.0, np.sign(values))
    for index in np.flatnonzero(signs == 0):
        signs[index] = signs[index - 1] if index else next((sign for sign in signs if sign), 0.0)
    return signs


def _locate_event(problem, kind, points, row_before, test_values, control, constants, max_halvings=MAX_HALVINGS):
    """Locate the event between two points; None if Newton's method does not converge between them."""
    base_point = row_at(points, row_before)
    lower_length, upper_length = 0.0, float(points.step[row_before + 1])
    length_guess = upper_length * test_values[row_before] / (test_values[row_before] - test_values[row_before + 1])
    for n_halvings in range(max_halvings):
        trial_point = take_step(problem, base_point, length_guess, control, constants)
        if n_halvings % NEWTON_EVERY == 0:
            event = _event_between(
                problem,
                kind,
                base_point,
                row_before,
                (lower_length, upper_length),
                trial_point,
                length_guess,
                control,
                constants,
            )
            if event is not None:
                return event
        if (
            trial_point.converged
            and _event_function_sign(problem, kind, base_point, constants)
            * _event_function_sign(problem, kind, trial_point, constants)
            > 0
        ):
            lower_length = length_guess
        else:
            upper_length = length_guess
        length_guess = 0.5 * (lower_length + upper_length)
    return None


def _event_between(
    problem, kind, base_point, row_before, length_interval, trial_point, length_guess, control, constants
):
    """Return the event to which Newton's method converges from a guess; None if it fails or leaves the interval."""
    z = trial_point.z if trial_point.converged else base_point.z + length_guess * base_point.tangent
    with np.errstate(divide="ignore"):  # entries of weight 0 have no largest distance
        max_distance = SEARCH_RADIUS_FACTOR * length_interval[1] / control.scale
    solution = _polish_event(problem, kind, z, constants, max_distance)
    return make_event(kind, base_point, row_before, length_interval, solution, control)


def make_event(kind, base_point, row_before, length_interval, solution, control):
    """Return the `Event` of a `RootAndResidual`; None if there is no root or it lies outside `length_interval`.

    Lengths are measured from `base_point`, whose row is `row_before`.
    """
    if solution.z is None:
        return None
    lower_length, upper_length = length_interval
    length = float(np.sum(control.scale**2 * base_point.tangent * (solution.z - base_point.z)))
    length_margin = 0.05 * (upper_length - lower_length)
    if not lower_length - length_margin <= length <= upper_length + length_margin:
        return None
    return Event(kind, row_before, min(max(length, lower_length), upper_length), solution.z, solution.residual)


def _event_function_sign(problem, kind, point, constants):
    """Return the sign, at a point, of the function that changes sign at events of a kind."""
    if kind in ("SN", "BP"):
        return np.sign(point.tangent[-1] if kind == "SN" else point.determinant)
    matrix, _ = augmented_systems.matrix_and_derivative(problem, problem.test_function(kind), point.z, constants)
    return np.linalg.slogdet(matrix)[0]


def _polish_event(problem, kind, z, constants, max_distance):
    """Locate an event by Newton's method; z of the `RootAndResidual` is None if the event is invalid."""
    conditions = [problem.is_valid]
    if kind == "SN":
        solution = augmented_systems.locate_fold(problem, z, constants, max_distance)
    elif kind == "BP":
        solution = augmented_systems.locate_branch_point(problem, z, constants, max_distance)
    else:
        test_function = problem.test_function(kind)
        solution = augmented_systems.locate_singularity(problem, test_function, z, constants, max_distance)
        conditions.insert(0, test_function.is_valid)
    if solution.z is None or all(is_valid(solution.z, constants) for is_valid in conditions):
        return solution
    return augmented_systems.RootAndResidual(None, np.nan)


def _remove_spurious_folds(events, control):
    """Sort events and remove folds that coincide with branch points.

    If another branch crosses a branch at a turning point, a fold and a branch point are detected. Only the branch point
    is genuine.
    """
    branch_points = [event for event in events if event.kind == "BP"]
    genuine_events = [
        event
        for event in events
        if event.kind != "SN"
        or not any(
            np.linalg.norm(control.scale * (event.z - branch_point.z)) < SAME_POINT_DISTANCE
            for branch_point in branch_points
        )
    ]
    return sorted(genuine_events, key=lambda event: (event.row_before, event.length))


def find_near_passes(points, target_zs, control):
    """Return (row before, length from this row, index of the target) where the branch passes close to target points.

    The branch need not contain the target points. `find_first_pass` checks this by computing points of the branch.
    """
    near_passes = []
    squared_scale = control.scale**2
    for target_index, target_z in enumerate(target_zs):
        target_offsets = target_z - points.z[:-1]
        projected_lengths = np.einsum("ik,ik->i", target_offsets, squared_scale * points.tangent[:-1])
        tangent_distances = np.linalg.norm(
            control.scale * (target_offsets - projected_lengths[:, None] * points.tangent[:-1]), axis=1
        )
        step_lengths = points.step[1:]
        is_ahead = projected_lengths > 0
        if points.step[0] == 0:  # the branch begins at the first point: a target within rounding is that point
            is_ahead[:1] = projected_lengths[:1] > START_DISTANCE
        for row_before in np.flatnonzero(
            is_ahead & (projected_lengths <= step_lengths) & (tangent_distances < 0.5 * step_lengths)
        ):
            near_passes.append((int(row_before), float(projected_lengths[row_before]), target_index))
    return sorted(near_passes)


def find_first_pass(problem, points, target_points, control, constants):
    """Return (row before, length from this row) where the branch first passes through a target point, or None."""
    for row_before, length, target_index in find_near_passes(points, target_points, control):
        base_point = row_at(points, row_before)
        point = take_step(problem, base_point, length, control, constants)
        if (
            point.converged
            and np.linalg.norm(control.scale * (point.z - target_points[target_index])) < SAME_POINT_DISTANCE
        ):
            return row_before, length
    return None


def point_at_length(task, points, row_before, length):
    """Compute the point at a length after a row of points.

    Parameters
    ----------
    task : ContinuationTask
        The task.
    points : Point
        Points, one row each.
    row_before : int
        Row from which the step is taken.
    length : float
        Length of the step.

    Returns
    -------
    Point or None
        The point; None if Newton's method does not converge.
    """
    point = take_step(task.problem, row_at(points, row_before), length, task.control, task.args)
    return point if point.converged else None


def point_from_z(task, points, row_before, z):
    """Make the `Point` at z, with the tangent and determinant of the branch at z.

    If the step to z fails, the tangent and determinant are those of the row before.

    Parameters
    ----------
    task : ContinuationTask
        The task.
    points : Point
        Points, one row each.
    row_before : int
        Row before the point.
    z : ndarray
        The point.

    Returns
    -------
    Point
        The point.
    """
    base_point = row_at(points, row_before)
    length = float(np.sum(task.control.scale**2 * base_point.tangent * (z - base_point.z)))
    point = take_step(task.problem, base_point, length, task.control, task.args)
    if not point.converged or not np.isfinite(point.tangent).all():
        point = base_point
    return point._replace(z=z, step=np.float64(length), converged=np.True_, accepted=np.True_)


def truncate_at_value(task, points, row_beyond, z_index, target_value):
    """Truncate points where an entry of z reaches a value.

    Parameters
    ----------
    task : ContinuationTask
        The task.
    points : Point
        Points, one row each.
    row_beyond : int
        First row beyond the value.
    z_index : int
        Index of the entry of z.
    target_value : float
        The value.

    Returns
    -------
    points : Point
        Points up to the value, or up to the row before the value if no point with the value was located.
    is_located : bool
        True if the point with the value was located.
    """
    (value_before, value_after) = points.z[row_beyond - 1 : row_beyond + 1, z_index]
    fraction = (target_value - value_before) / (value_after - value_before)
    z_guess = point_at_length(task, points, row_beyond - 1, fraction * float(points.step[row_beyond]))
    z_guess = (
        points.z[row_beyond - 1] + fraction * (points.z[row_beyond] - points.z[row_beyond - 1])
        if z_guess is None
        else z_guess.z
    )
    point = solve_with_fixed_entry(task.problem, z_guess, z_index, target_value, task.control, task.args)
    points_before = first_rows(points, row_beyond)
    if not point.converged:
        return points_before, False
    z = np.array(point.z)
    z[z_index] = target_value  # exactly, without a rounding error
    return insert_row(points_before, row_beyond, point_from_z(task, points, row_beyond - 1, z)), True


def truncate_at_length(task, points, row_before, length):
    """Truncate points at a length after a row, or at the row if Newton's method fails."""
    point = point_at_length(task, points, row_before, length)
    points_before = first_rows(points, row_before + 1)
    return points_before if point is None else insert_row(points_before, row_before + 1, point)


def locate_sign_changes(task, points, kind, values, value_at, make_error):
    """Yield the `Event` of each sign change of a function along a branch.

    Parameters
    ----------
    task : ContinuationTask
        The task.
    points : Point
        Points, one row each.
    kind : str
        Kind of the events.
    values : ndarray
        Values of the function at the points.
    value_at : callable
        The function of z.
    make_error : callable
        Function of (kind, row before). It returns the error to raise if Newton's method fails between two points.

    Yields
    ------
    Event
        The sign changes, in order.
    """
    for row_before in np.flatnonzero(values[:-1] * values[1:] < 0).tolist():

        def value_at_length(length, row_before=row_before):
            point = point_at_length(task, points, row_before, length)
            if point is None:
                raise make_error(kind, row_before)
            return value_at(point.z)

        length = find_bracketed_root(value_at_length, float(points.step[row_before + 1]))
        point = point_at_length(task, points, row_before, length)
        yield Event(kind, row_before, length, point.z, float(point.residual))
