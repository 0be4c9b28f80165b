"""Continue a fold or grazing to other numbers of its scene, and compute the gradient of its value.

F(u, p, q) = 0 are the equations of an orbit, p the value of the point, q the other numbers. At a fold F_u is singular,
with left null vector w, and ``dp/dq = -(w F_q) / (w F_p)``. At a grazing one speed is zero and is not an unknown. The
remaining matrix of (F_u, F_p) is regular, and dp/dq is the last row of ``-(F_u, F_p)^-1 F_q``. No second derivative is
required.
"""

from contextlib import suppress
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float, Int

from continuation import augmented_systems

from ..problem.equations import OrbitEquations, continuation_problem
from ..scene import check
from ..scene.parameters import mark_parameters
from ..scene.scene import Scene
from .extended_system import GrazingEquations
from .locus_start import locus_problems, make_locus_start

MIN_FRACTION = 1.0 / 256.0  # of the path: the continuation ends if a shorter step fails
MAX_CHANGE = 0.3  # relative to 1 + the largest unknown: largest change in a step


class ContinuedPoint(NamedTuple):
    """Fold or grazing with the numbers of its scene that can be changed.

    Attributes
    ----------
    problem : OrbitEquations
        Equations of the orbit.
    z : numpy.ndarray
        (times, speeds, value). Array of shape (unknowns,).
    zero_speed_indices : numpy.ndarray
        Indices in `z` of speeds that are zero.
    parameter_values : numpy.ndarray
        Values of the numbers that can be changed. Array of shape (count,).
    parameter_marks : tuple of Scene
        For each of these numbers the tree of the scene with 1 at its position.
    residual : float
        Largest residual of the equations.
    """

    problem: OrbitEquations
    z: Float[np.ndarray, " unknowns"]
    zero_speed_indices: Int[np.ndarray, " places"]
    parameter_values: Float[np.ndarray, " count"]
    parameter_marks: tuple[Scene, ...]
    residual: float

    @property
    def value(self) -> float:
        """Parameter value of the point."""
        return float(self.z[-1])


def prepare_point(special, names):
    """Make the `ContinuedPoint` of a special point.

    Parameters
    ----------
    special : Special
        Special point of kind SN or GR.
    names : sequence of str
        Names of the numbers that can be changed.

    Returns
    -------
    ContinuedPoint
        The point; at a GR that of the first contact that determines its value.

    Raises
    ------
    ArgumentError
        If the point is of another kind, or if its parameter does not move it.
    """
    start = make_locus_start(special)
    for problem_and_z in locus_problems(start, (special.name, *names)):
        point = _make_point(*problem_and_z, special.name, names)
        with suppress(np.linalg.LinAlgError):
            parameter_gradient(point)
            return point
    raise check.ArgumentError("special", f"must depend on {special.name}", start.kind)


def _make_point(problem, z, name, names):
    """Make the `ContinuedPoint` of a point of a curve along one parameter and others."""
    n_rows, unknowns = len(problem.sequence.sides), z[: len(z) - len(names)]
    scene, value_marks = mark_parameters(problem.scene, name)
    zero_speed_indices = (
        n_rows + np.flatnonzero(problem.row_mask) if isinstance(problem, GrazingEquations) else np.zeros(0, int)
    )
    parameter_marks = tuple(mark_parameters(scene, parameter_name)[1] for parameter_name in names)
    point = ContinuedPoint(
        OrbitEquations(scene, value_marks, problem.sequence._replace(grazing=None)),
        unknowns,
        zero_speed_indices,
        z[len(unknowns) :],
        parameter_marks,
        np.nan,
    )
    point = _with_parameters(point, point.parameter_values)  # `mark_parameters` sets the hardness to zero
    return _solve_point(point) or point


def parameter_gradient(point):
    """Compute the gradient of the value of a point with respect to its numbers.

    Parameters
    ----------
    point : ContinuedPoint
        The point.

    Returns
    -------
    numpy.ndarray
        Gradient dp/dq. Array of shape (count,).
    """
    jacobian, parameter_columns = _jacobian(point.problem, point.z), _parameter_columns(point)
    if len(point.zero_speed_indices):
        return -np.linalg.solve(np.delete(jacobian, point.zero_speed_indices, 1), parameter_columns)[-1]
    left_null = augmented_systems.null_vector(jacobian[:, :-1].T)
    return -(left_null @ parameter_columns) / (left_null @ jacobian[:, -1])


def continue_point(point, target_values, n_steps=1):
    """Continue a point to other values of its numbers.

    The straight path is divided into steps, which are halved where Newton's method fails.

    Parameters
    ----------
    point : ContinuedPoint
        The point.
    target_values : array_like
        Values of the numbers at the end. Array of shape (count,).
    n_steps : int, optional
        Initial number of steps.

    Returns
    -------
    point : ContinuedPoint
        The point at the end of the path that was followed.
    fraction : float
        Fraction of the path that was followed, 1 if the target is reached.
    """
    start_values, displacement = point.parameter_values, np.asarray(target_values) - point.parameter_values
    fraction, fraction_step, previous = 0.0, 1.0 / n_steps, None
    while fraction < 1.0 and fraction_step >= MIN_FRACTION:
        next_fraction = min(1.0, fraction + fraction_step)
        z = np.array(point.z)
        if previous is not None:  # secant predictor
            z += (point.z - previous[0].z) * (next_fraction - fraction) / (fraction - previous[1])
        else:
            z[-1] += parameter_gradient(point) @ displacement * (next_fraction - fraction)
        next_point = _solve_point(_with_parameters(point, start_values + next_fraction * displacement)._replace(z=z))
        if next_point is None or abs(next_point.z - point.z).max() > MAX_CHANGE * (1.0 + abs(point.z).max()):
            fraction_step *= 0.5
        else:
            previous, point, fraction, fraction_step = (point, fraction), next_point, next_fraction, 2.0 * fraction_step
    return point, fraction


def _with_parameters(point, parameter_values):
    """Return the `ContinuedPoint` with other values, without correcting its orbit."""
    scene = point.problem.scene
    for mask, value in zip(point.parameter_marks, parameter_values, strict=True):
        scene = _set_marked(scene, mask, value)
    return point._replace(problem=point.problem._replace(scene=scene), parameter_values=parameter_values)


def _set_marked(scene, mask, value):
    return jax.tree.map(lambda leaf, is_marked: np.where(is_marked, value, leaf), scene, mask)


def _parameter_columns(point):
    """Return F_q, one column per number."""
    scene_at_value = _set_marked(point.problem.scene, point.problem.parameter_marks, point.z[-1])
    columns = [
        _jacobian(point.problem._replace(scene=scene_at_value, parameter_marks=mask), np.append(point.z[:-1], value))[
            :, -1
        ]
        for mask, value in zip(point.parameter_marks, point.parameter_values, strict=True)
    ]
    return np.stack(columns, 1)


def _jacobian(problem, z):
    return augmented_systems.jacobian_at(continuation_problem(problem), z, problem)


def _solve_point(point):
    """Correct a `ContinuedPoint` by Newton's method, or return None if there is none with positive impact speeds."""
    try:
        with np.errstate(all="ignore"):
            solution = (
                _solve_grazing(point)
                if len(point.zero_speed_indices)
                else augmented_systems.locate_fold(continuation_problem(point.problem), point.z, point.problem)
            )
    except np.linalg.LinAlgError:  # a flight does not end
        return None
    if solution.z is None:
        return None
    sequence = point.problem.sequence
    n_rows = len(sequence.sides)
    speed_indices = np.setdiff1d(n_rows + np.flatnonzero(sequence.sides != 0), point.zero_speed_indices)
    return point._replace(z=solution.z, residual=solution.residual) if np.all(solution.z[speed_indices] > 0.0) else None


def _solve_grazing(point):
    """Solve with the zero speeds held; return a `PointSolution`."""
    free_indices = np.delete(np.arange(len(point.z)), point.zero_speed_indices)

    def expand_unknowns(free_unknowns):
        z = np.zeros(len(point.z))
        z[free_indices] = free_unknowns
        return z

    def system(free_unknowns):
        residual, jacobian = augmented_systems.evaluate(
            continuation_problem(point.problem), expand_unknowns(free_unknowns), point.problem
        )
        return np.asarray(residual), np.asarray(jacobian)[:, free_indices]

    solution = augmented_systems.solve_newton(system, point.z[free_indices])
    return solution if solution.z is None else solution._replace(z=expand_unknowns(solution.z))
