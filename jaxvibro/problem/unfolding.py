"""Compute normal forms of SN, PD and SB: the side of the other orbits, and the rate of the multiplier.

At the point the equations F(u, p) = 0 of the orbit have null vectors v and w: J v = 0, w J = 0, J = F_u. At a PD, J is
closed antiperiodically: a perturbation returns with the opposite sign, as for the orbit traversed twice. The other
orbits are u + s v at p + b s^2:

- SN: b = -w F_uu v v / (2 w F_p);
- PD, SB: b = -(w F_uuu v v v / 6 + w F_uu v y) / c, c = w F_uu v y' + w F_up v, with F_u y = -F_uu v v / 2, F_u y' =
  -F_p, both closed like the orbit itself (Golubitsky and Schaeffer, Singularities and Groups in Bifurcation Theory I,
  chapters I and VI). The rate of the multiplier is minus c divided by the derivative of w J v with respect to the
  closure.

First derivatives are exact, also with soft walls. Derivatives of J are differences along v, on a line of nine points.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from continuation import augmented_systems

from ..scene.typical_scales import force_rates, scene_length
from .equations import OrbitEquations, continuation_problem
from .grazing import padded_sequence
from .grazing_contact import arclength_weights, contact_durations_at, orbit_duration_at

NODE_SPACING = 0.05  # spacing of the stencil, divided by the fastest rate
MAX_FLIGHT_FRACTION = 0.05  # largest shift relative to a flight, and to a speed if a wall is soft
STENCIL_NODES = np.array([-4, -3, -2, -1, 1, 2, 3, 4])
FIRST_DERIV_WEIGHTS = np.array([1 / 280, -4 / 105, 1 / 5, -4 / 5, 4 / 5, -1 / 5, 4 / 105, -1 / 280])
SECOND_DERIV_WEIGHTS = np.array(
    [-1 / 560, 8 / 315, -1 / 5, 8 / 5, 8 / 5, -1 / 5, 8 / 315, -1 / 560]
)  # for a function that vanishes at the point


class Unfolding(NamedTuple):
    """Normal form of a special point.

    Attributes
    ----------
    coefficient : float
        b; the other orbits are at value + b s^2.
    null_vector : ndarray
        v: changes of times and speeds, array of shape (2 * impacts,). s is the root mean square over the impacts of the
        changes of time and of speed over the length of the scene.
    multiplier_rate : float
        Derivative of the multiplier with respect to the parameter along the orbits of the point; nan at an SN, where it
        changes like a square root.
    """

    coefficient: float
    null_vector: Float[np.ndarray, " unknowns"]
    multiplier_rate: float


class _NullDirection(NamedTuple):
    """Derivatives of the equations along the null vector.

    Attributes
    ----------
    problem : OrbitEquations
        Equations of the orbit.
    closure : float
        1, or -1 if a perturbation returns with the opposite sign.
    right_null, left_null : ndarray
        Null vectors v and w of J; w is divided by the length of a row.
    jacobian : ndarray
        dF/dz.
    jacobian_derivative : ndarray
        Derivative of dF/dz along v.
    third_derivative : float
        w F_uuu v v v.
    """

    problem: OrbitEquations
    closure: float
    right_null: Float[np.ndarray, " unknowns"]
    left_null: Float[np.ndarray, " unknowns"]
    jacobian: Float[np.ndarray, "unknowns z"]
    jacobian_derivative: Float[np.ndarray, "unknowns z"]
    third_derivative: float


def unfold_saddle_node(scene, problem, z):
    """Unfold an SN.

    Parameters
    ----------
    scene : Scene
        Scene at the point.
    problem : OrbitEquations
        Equations of the orbit.
    z : ndarray
        Unknowns at the point.

    Returns
    -------
    Unfolding
        Normal form.
    """
    null_direction = _expand_along_null(scene, problem, z, 1.0)
    coefficient = (
        -0.5
        * null_direction.left_null
        @ null_direction.jacobian_derivative[:, :-1]
        @ null_direction.right_null
        / (null_direction.left_null @ null_direction.jacobian[:, -1])
    )
    return Unfolding(float(coefficient), _impact_components(problem, null_direction.right_null), np.nan)


def unfold_symmetry_breaking(scene, problem, z):
    """Unfold an SB.

    Parameters
    ----------
    scene : Scene
        Scene at the point.
    problem : OrbitEquations
        Equations of the orbit.
    z : ndarray
        Unknowns at the point.

    Returns
    -------
    Unfolding
        Normal form.
    """
    null_direction = _expand_along_null(scene, problem, z, 1.0)
    return _unfold_pitchfork(null_direction, _impact_components(problem, null_direction.right_null))


def unfold_period_doubling(scene, problem, z):
    """Unfold a PD.

    An orbit with one impact is unfolded as the doubled orbit, whose null vector contains both halves of the
    perturbation.

    Parameters
    ----------
    scene : Scene
        Scene at the point.
    problem : OrbitEquations
        Equations of the orbit.
    z : ndarray
        Unknowns at the point.

    Returns
    -------
    Unfolding
        Normal form.
    """
    if len(problem.impact_rows) > 1:
        null_direction = _expand_along_null(scene, problem, z, -1.0)
        return _unfold_pitchfork(null_direction, _impact_components(problem, null_direction.right_null))
    second_time, speed = z[0] + orbit_duration_at(problem, z), z[len(problem.sequence.sides)]
    sequence = problem.sequence._replace(periods=np.asarray(2.0 * problem.sequence.periods))
    doubled_problem = problem._replace(sequence=sequence)
    side = problem.sequence.sides[0]
    doubled_problem = doubled_problem._replace(
        sequence=padded_sequence(doubled_problem, [(z[0], speed, side), (second_time, speed, side)])
    )
    null_direction = _expand_along_null(
        scene,
        doubled_problem,
        np.concatenate([doubled_problem.sequence.times, doubled_problem.sequence.speeds, z[-1:]]),
        1.0,
    )
    unfolding = _unfold_pitchfork(null_direction, null_direction.right_null[[0, 2]])
    # the multiplier of the doubled orbit is the square
    return unfolding._replace(multiplier_rate=-0.5 * unfolding.multiplier_rate)


def _impact_components(problem, vector):
    """Return the components of the impacts, without empty rows."""
    n_rows, n_impacts = len(problem.sequence.sides), len(problem.impact_rows)
    return np.concatenate([vector[:n_impacts], vector[n_rows : n_rows + n_impacts]])


def _expand_along_null(scene, problem, z, closure):
    """Compute the derivatives of the equations along the null vector."""
    problem_arguments = continuation_problem(problem), z, problem
    jacobian = augmented_systems.jacobian_at(*problem_arguments)
    weights = arclength_weights(problem, scene_length(scene))[:-1]
    matrix = _apply_closure(problem, jacobian[None], closure)[0][:, :-1]
    right_null, left_null = augmented_systems.null_vector(matrix), augmented_systems.null_vector(matrix.T)
    right_null = right_null / np.linalg.norm(weights * right_null)
    right_null = right_null * np.sign(right_null[np.flatnonzero(abs(right_null) > 0.5 * abs(right_null).max())[0]])
    spacing = _stencil_spacing(scene, problem, z, right_null)
    jacobians = augmented_systems.jacobians_at(
        continuation_problem(problem), z + np.outer(STENCIL_NODES * spacing, np.append(right_null, 0.0)), problem
    )
    if closure < 0:  # the flight back to the first impact sees that impact moved in the opposite direction
        reflected = np.append(right_null, 0.0)
        reflected[_closure_indices(problem)[0]] *= -1.0
        reflected_jacobians = augmented_systems.jacobians_at(
            continuation_problem(problem), z + np.outer(STENCIL_NODES * spacing, reflected), problem
        )
        jacobians = np.array(jacobians)
        return_rows = _closure_indices(problem)[1]
        jacobians[:, return_rows] = reflected_jacobians[:, return_rows]
    jacobian_derivative = np.tensordot(FIRST_DERIV_WEIGHTS, jacobians, 1) / spacing
    second_derivative = np.tensordot(SECOND_DERIV_WEIGHTS, jacobians, 1) / spacing**2
    return _NullDirection(
        problem,
        closure,
        right_null,
        left_null,
        jacobian,
        jacobian_derivative,
        float(left_null @ _apply_closure(problem, second_derivative[None], closure)[0][:, :-1] @ right_null),
    )


def _unfold_pitchfork(null_direction, null_vector):
    """Unfold a pitchfork: of the orbit traversed twice, or of an orbit that loses its symmetry."""
    n_unknowns = len(null_direction.right_null)
    curvature = (
        _apply_closure(null_direction.problem, null_direction.jacobian_derivative[None], null_direction.closure)[0][
            :, :-1
        ]
        @ null_direction.right_null
    )
    bordered = np.zeros((n_unknowns + 1, n_unknowns + 1))
    bordered[:n_unknowns, :n_unknowns] = null_direction.jacobian[:, :-1]
    if null_direction.closure > 0:  # singular matrix, but the right-hand side is in its range
        bordered[:n_unknowns, -1], bordered[-1, :n_unknowns] = null_direction.left_null, null_direction.right_null
    else:
        bordered[-1, -1] = 1.0
    rhs = np.vstack([np.stack([-0.5 * curvature, -null_direction.jacobian[:, -1]], 1), np.zeros((1, 2))])
    quadratic_shift, parameter_shift = np.linalg.solve(bordered, rhs)[:n_unknowns].T
    null_gradient = null_direction.left_null @ null_direction.jacobian_derivative
    rate = null_gradient[:-1] @ parameter_shift + null_gradient[-1]
    first_impact, return_rows = _closure_indices(null_direction.problem)
    closure_derivative = (
        null_direction.left_null[return_rows]
        @ null_direction.jacobian[np.ix_(return_rows, first_impact)]
        @ null_direction.right_null[first_impact]
    )
    return Unfolding(
        float(-(null_direction.third_derivative / 6.0 + null_gradient[:-1] @ quadratic_shift) / rate),
        null_vector,
        float(-rate / closure_derivative),
    )


def _closure_indices(problem):
    """Return the indices of the first impact's unknowns, and the rows of the flight back to it."""
    n_rows = len(problem.sequence.sides)
    last_row = len(problem.impact_rows) - 1
    return [0, n_rows], [last_row, n_rows + last_row]


def _apply_closure(problem, jacobians, closure):
    """Multiply the derivatives of the flight back to the first impact by the closure."""
    closed_jacobians = np.array(jacobians)
    if closure < 0:
        first_impact, return_rows = _closure_indices(problem)
        for row in return_rows:
            closed_jacobians[:, row, first_impact] *= -1.0
    return closed_jacobians


def _stencil_spacing(scene, problem, z, direction):
    """Return the spacing along v for which the equations are smooth over the whole stencil."""
    n_rows, impact_rows, length_scale = len(problem.sequence.sides), problem.impact_rows, scene_length(scene)
    time_changes, speed_changes = abs(direction[impact_rows]), abs(direction[n_rows + impact_rows])
    flight_durations = (
        np.append(z[impact_rows[1:]], z[impact_rows[0]] + orbit_duration_at(problem, z))
        - z[impact_rows]
        - contact_durations_at(problem, z)[impact_rows]
    )
    relative_changes = [
        (time_changes + np.roll(time_changes, -1)) / (MAX_FLIGHT_FRACTION * flight_durations),
        np.maximum(time_changes, speed_changes / length_scale)
        * max(_fastest_rate(scene), *_contact_rates(scene, problem, z))
        / NODE_SPACING,
    ]
    if scene.soft_sides:
        relative_changes.append(speed_changes / (MAX_FLIGHT_FRACTION * abs(z[n_rows + impact_rows])))
    return 1.0 / float(np.max(relative_changes))


def _contact_rates(scene, problem, z):
    """Return half-oscillation rates of the contact phases under a user-defined force, preceded by 0."""
    contact_durations = (
        contact_durations_at(problem, z)[problem.impact_rows]
        if scene.soft_sides and scene.force is not None
        else np.zeros(0)
    )
    return [0.0, *(np.pi / contact_durations[contact_durations > 0])]


def _fastest_rate(scene):
    """Return the fastest rate of oscillation or decay in the equations of an orbit."""
    frequency = float(scene.frequency)
    if scene.force is None:
        damping = float(scene.damping)
        rates = [1.0, frequency, 2.0 * damping]
    else:
        rates = [frequency, *force_rates(scene)]
    rates += [term.harmonic * frequency for term in scene.drive]
    for wall in scene.walls.values():
        if wall.soft and scene.force is None:
            contact_damping = damping if wall.damping is None else damping + float(wall.damping)
            rates += [np.sqrt(1.0 + float(wall.stiffness)), 2.0 * contact_damping]
        if wall.motion is not None:
            rates.append(wall.motion.harmonic * frequency)
    return max(rates)
