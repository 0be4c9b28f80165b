"""Continue a fold or grazing to other values of scene parameters, and compute the gradient of its value.

F(u, p, q) = 0 are the equations of an orbit with unknowns u, the value p of the special point, and the other scene
parameters q. At a fold, F_u is singular with left null vector w, and ``dp/dq = -(w F_q) / (w F_p)``. At a grazing, one
speed is zero and is not an unknown. The remaining matrix (F_u, F_p) is regular, and dp/dq is the last row of
``-(F_u, F_p)^-1 F_q``. No second derivatives are required.
"""

from contextlib import suppress
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float, Int

from continuation import augmented_systems
from continuation.implicit_function import root_derivatives

from ..problem.orbit_problem import OrbitProblem
from ..scene import check
from ..scene.scene import Scene
from ..scene.scene_parameters import mark_parameters
from .locus_equations import GrazingCondition
from .locus_start import check_special_point, problems_at_locus_start

MIN_FRACTION = 1.0 / 256.0  # of the path: the continuation ends if a shorter step fails
MAX_CHANGE = 0.3  # relative to 1 + the largest unknown: largest change in a step


class ContinuedPoint(NamedTuple):
    """Fold or grazing with the scene parameters that can be changed.

    Attributes
    ----------
    problem : OrbitProblem
        Equations of the orbit.
    z : numpy.ndarray
        (times, speeds, value). Array of shape (unknowns,).
    zero_speed_indices : numpy.ndarray
        Indices in `z` of speeds that are zero.
    parameter_values : numpy.ndarray
        Values of the parameters that can be changed. Array of shape (count,).
    parameter_marks : tuple of Scene
        One `Scene` for each of these parameters, with 1 at the position of the parameter and 0 elsewhere.
    residual : float
        Largest residual of the equations.
    """

    problem: OrbitProblem
    z: Float[np.ndarray, " unknowns"]
    zero_speed_indices: Int[np.ndarray, " places"]
    parameter_values: Float[np.ndarray, " count"]
    parameter_marks: tuple[Scene, ...]
    residual: float

    @property
    def value(self) -> float:
        """Parameter value of the point."""
        return float(self.z[-1])


def make_continued_point(special, names):
    """Make the `ContinuedPoint` of a special point.

    Parameters
    ----------
    special : Special
        Special point of kind SN or GR.
    names : sequence of str
        Names of the scene parameters that can be changed.

    Returns
    -------
    ContinuedPoint
        The point. At a GR with several contacts, the first contact that determines the value of the point is used.

    Raises
    ------
    ArgumentError
        If the equations of the point do not determine its parameter value.
    """
    check_special_point(special)
    for problem_and_z in problems_at_locus_start(special.kind, special.scene, special.spot, (special.name, *names)):
        point = _continued_point_of(*problem_and_z, special.name, names)
        with suppress(np.linalg.LinAlgError):
            value_gradient(point)
            return point
    raise check.ArgumentError("special", f"must depend on {special.name}", special.kind)


def _continued_point_of(problem, z, value_name, names):
    """Make the `ContinuedPoint` from equations and z whose parameters are `value_name`, then `names`."""
    n_rows, orbit_z = len(problem.sequence.sides), z[: len(z) - len(names)]
    scene, value_marks = mark_parameters(problem.scene, value_name)
    zero_speed_indices = (
        n_rows + np.flatnonzero(problem.condition.row_mask)
        if isinstance(problem.condition, GrazingCondition)
        else np.zeros(0, int)
    )
    parameter_marks = tuple(mark_parameters(scene, parameter_name)[1] for parameter_name in names)
    point = ContinuedPoint(
        OrbitProblem(scene, value_marks, problem.sequence._replace(grazing=None)),
        orbit_z,
        zero_speed_indices,
        z[len(orbit_z) :],
        parameter_marks,
        np.nan,
    )
    point = _with_parameter_values(point, point.parameter_values)  # `mark_parameters` sets the hardness to zero
    return _correct_point(point) or point


def value_gradient(point):
    """Compute the gradient of the value of a point with respect to its changeable parameters.

    Parameters
    ----------
    point : ContinuedPoint
        The point.

    Returns
    -------
    numpy.ndarray
        Gradient dp/dq. Array of shape (count,).
    """
    jacobian, parameter_jacobian = _orbit_jacobian(point.problem, point.z), _parameter_jacobian(point)
    if len(point.zero_speed_indices):
        return root_derivatives(np.delete(jacobian, point.zero_speed_indices, 1), parameter_jacobian)[-1]
    left_null = augmented_systems.null_vector(jacobian[:, :-1].T)
    return -(left_null @ parameter_jacobian) / (left_null @ jacobian[:, -1])


def continue_to_values(point, target_values, n_steps=1):
    """Continue a point to other values of its changeable parameters.

    The straight path to the target values is divided into steps. A step is halved if Newton's method fails or if the
    unknowns change too much, and doubled after a success. The continuation ends before the target if a step becomes
    shorter than `MIN_FRACTION` of the path.

    Parameters
    ----------
    point : ContinuedPoint
        The point.
    target_values : array_like
        Values of the parameters at the end of the path. Array of shape (count,).
    n_steps : int, optional
        Initial number of steps.

    Returns
    -------
    point : ContinuedPoint
        The point at the end of the path that was followed.
    fraction : float
        Fraction of the path that was followed, 1 if the target is reached.
    """
    start_values, value_changes = point.parameter_values, np.asarray(target_values) - point.parameter_values
    fraction, fraction_step, previous_step = 0.0, 1.0 / n_steps, None
    while fraction < 1.0 and fraction_step >= MIN_FRACTION:
        next_fraction = min(1.0, fraction + fraction_step)
        z = np.array(point.z)
        if previous_step is not None:  # secant predictor
            z += (point.z - previous_step[0].z) * (next_fraction - fraction) / (fraction - previous_step[1])
        else:
            z[-1] += value_gradient(point) @ value_changes * (next_fraction - fraction)
        next_point = _correct_point(
            _with_parameter_values(point, start_values + next_fraction * value_changes)._replace(z=z)
        )
        if next_point is None or abs(next_point.z - point.z).max() > MAX_CHANGE * (1.0 + abs(point.z).max()):
            fraction_step *= 0.5
        else:
            previous_step, point, fraction, fraction_step = (
                (point, fraction),
                next_point,
                next_fraction,
                2.0 * fraction_step,
            )
    return point, fraction


def _with_parameter_values(point, parameter_values):
    """Return the `ContinuedPoint` with other parameter values and an unchanged orbit."""
    scene = point.problem.scene
    for parameter_mark, value in zip(point.parameter_marks, parameter_values, strict=True):
        scene = _set_marked_numbers(scene, parameter_mark, value)
    return point._replace(problem=point.problem._replace(scene=scene), parameter_values=parameter_values)


def _set_marked_numbers(scene, parameter_mark, value):
    return jax.tree.map(lambda leaf, is_marked: np.where(is_marked, value, leaf), scene, parameter_mark)


def _parameter_jacobian(point):
    """Return F_q, with one column per parameter."""
    scene_at_value = _set_marked_numbers(point.problem.scene, point.problem.parameter_marks, point.z[-1])
    jacobian_columns = [
        _orbit_jacobian(
            point.problem._replace(scene=scene_at_value, parameter_marks=parameter_mark), np.append(point.z[:-1], value)
        )[:, -1]
        for parameter_mark, value in zip(point.parameter_marks, point.parameter_values, strict=True)
    ]
    return np.stack(jacobian_columns, 1)


def _orbit_jacobian(problem, z):
    return problem.evaluate(z)[1]


def _correct_point(point):
    """Correct a `ContinuedPoint` by Newton's method; return None if it fails or an impact speed is not positive."""
    try:
        with np.errstate(all="ignore"):
            solution = (
                _correct_grazing(point)
                if len(point.zero_speed_indices)
                else augmented_systems.locate_fold(point.problem.equations, point.z, point.problem)
            )
    except np.linalg.LinAlgError:  # a flight does not end
        return None
    if solution.z is None:
        return None
    sequence = point.problem.sequence
    n_rows = len(sequence.sides)
    positive_speed_indices = np.setdiff1d(n_rows + np.flatnonzero(sequence.sides != 0), point.zero_speed_indices)
    return (
        point._replace(z=solution.z, residual=solution.residual)
        if np.all(solution.z[positive_speed_indices] > 0.0)
        else None
    )


def _correct_grazing(point):
    """Solve the equations with the zero speeds fixed; return a `RootAndResidual`."""
    unknown_indices = np.delete(np.arange(len(point.z)), point.zero_speed_indices)

    def expand_unknowns(reduced_unknowns):
        z = np.zeros(len(point.z))
        z[unknown_indices] = reduced_unknowns
        return z

    def reduced_system(reduced_unknowns):
        residual, jacobian = augmented_systems.evaluate_problem(
            point.problem.equations, expand_unknowns(reduced_unknowns), point.problem
        )
        return np.asarray(residual), np.asarray(jacobian)[:, unknown_indices]

    solution = augmented_systems.solve_newton(reduced_system, point.z[unknown_indices])
    return solution if solution.z is None else solution._replace(z=expand_unknowns(solution.z))
