"""Compute normal forms of SN, PD and SB points: the side of the bifurcating orbits and the change of the multiplier.

At the point the Jacobian J = F_u of the equations F(u, p) = 0 has null vectors v and w: J v = 0 and w J = 0. At a PD
the closure of J is antiperiodic: a perturbation returns with the opposite sign, as for the orbit traversed twice. The
bifurcating orbits are u + s v at p + b s^2:

- SN: b = -w F_uu v v / (2 w F_p);
- PD, SB: b = -(w F_uuu v v v / 6 + w F_uu v y) / c, c = w F_uu v y' + w F_up v, with F_u y = -F_uu v v / 2, F_u y' =
  -F_p, both closed like the orbit itself (Golubitsky and Schaeffer, Singularities and Groups in Bifurcation Theory I,
  chapters I and VI). The derivative of the multiplier with respect to p is minus c divided by the derivative of w J v
  with respect to the multiplier in the closure.

First derivatives are exact, also with soft walls. Derivatives of J are differences along v, on a line of nine points.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from continuation import augmented_systems

from ..contact.kinds import contact_of_wall, flow_of_scene
from .grazing_contact import contact_durations_at
from .orbit_problem import OrbitProblem

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
        Coefficient b; the bifurcating orbits are at p + b s^2.
    null_vector : ndarray
        Null vector v, the changes of times and speeds, array of shape (2 * impacts,). s is the root mean square over
        the impacts of the changes of times, and of speeds divided by the length of the scene.
    multiplier_rate : float
        Derivative of the multiplier with respect to the parameter along the branch through the point; nan at an SN,
        where the multiplier changes like a square root.
    """

    coefficient: float
    null_vector: Float[np.ndarray, " unknowns"]
    multiplier_rate: float


class _NullVectorDerivatives(NamedTuple):
    """Derivatives of the equations of an orbit along the null vector of the Jacobian.

    Attributes
    ----------
    problem : OrbitProblem
        Equations of the orbit.
    closure_sign : float
        1, or -1 if a perturbation returns with the opposite sign.
    right_null, left_null : ndarray
        Null vectors v and w of J.
    jacobian : ndarray
        dF/dz.
    jacobian_derivative : ndarray
        Derivative of dF/dz along v.
    third_derivative : float
        w F_uuu v v v.
    """

    problem: OrbitProblem
    closure_sign: float
    right_null: Float[np.ndarray, " unknowns"]
    left_null: Float[np.ndarray, " unknowns"]
    jacobian: Float[np.ndarray, "unknowns z"]
    jacobian_derivative: Float[np.ndarray, "unknowns z"]
    third_derivative: float


def unfold_saddle_node(scene, problem, z):
    """Compute the normal form of a saddle-node (SN).

    Parameters
    ----------
    scene : Scene
        Scene at the point.
    problem : OrbitProblem
        Equations of the orbit.
    z : ndarray
        Unknowns at the point.

    Returns
    -------
    Unfolding
        Normal form.
    """
    null_derivatives = _derivatives_along_null(scene, problem, z, 1.0)
    parameter_coefficient = (
        -0.5
        * null_derivatives.left_null
        @ null_derivatives.jacobian_derivative[:, :-1]
        @ null_derivatives.right_null
        / (null_derivatives.left_null @ null_derivatives.jacobian[:, -1])
    )
    return Unfolding(float(parameter_coefficient), _impact_components(problem, null_derivatives.right_null), np.nan)


def unfold_symmetry_breaking(scene, problem, z):
    """Compute the normal form of a symmetry-breaking point (SB).

    Parameters
    ----------
    scene : Scene
        Scene at the point.
    problem : OrbitProblem
        Equations of the orbit.
    z : ndarray
        Unknowns at the point.

    Returns
    -------
    Unfolding
        Normal form.
    """
    null_derivatives = _derivatives_along_null(scene, problem, z, 1.0)
    return _unfold_pitchfork(null_derivatives, _impact_components(problem, null_derivatives.right_null))


def unfold_period_doubling(scene, problem, z):
    """Compute the normal form of a period doubling (PD).

    For an orbit with one impact the doubled orbit is used, whose null vector contains both halves of the perturbation.

    Parameters
    ----------
    scene : Scene
        Scene at the point.
    problem : OrbitProblem
        Equations of the orbit.
    z : ndarray
        Unknowns at the point.

    Returns
    -------
    Unfolding
        Normal form.
    """
    if len(problem.impact_rows) > 1:
        null_derivatives = _derivatives_along_null(scene, problem, z, -1.0)
        return _unfold_pitchfork(null_derivatives, _impact_components(problem, null_derivatives.right_null))
    null_derivatives = _derivatives_along_null(scene, *problem.repeat(z, 2), 1.0)
    doubled_unfolding = _unfold_pitchfork(null_derivatives, null_derivatives.right_null[[0, 2]])
    # the multiplier of the doubled orbit is the square
    return doubled_unfolding._replace(multiplier_rate=-0.5 * doubled_unfolding.multiplier_rate)


def _impact_components(problem, unknowns_vector):
    """Return the components of a vector that belong to impacts, without empty rows."""
    n_rows, n_impacts = len(problem.sequence.sides), len(problem.impact_rows)
    return np.concatenate([unknowns_vector[:n_impacts], unknowns_vector[n_rows : n_rows + n_impacts]])


def _derivatives_along_null(scene, problem, z, closure_sign):
    """Compute the `_NullVectorDerivatives` at a point; `closure_sign` is 1, or -1 for antiperiodic perturbations."""
    _, jacobian = problem.evaluate(z)
    unknown_weights = problem.weights()[:-1]
    closed_jacobian = _multiply_by_closure(problem, jacobian[None], closure_sign)[0][:, :-1]
    right_null, left_null = (
        augmented_systems.null_vector(closed_jacobian),
        augmented_systems.null_vector(closed_jacobian.T),
    )
    right_null = right_null / np.linalg.norm(unknown_weights * right_null)
    right_null = right_null * np.sign(right_null[np.flatnonzero(abs(right_null) > 0.5 * abs(right_null).max())[0]])
    node_spacing = _stencil_spacing(scene, problem, z, right_null)
    stencil_jacobians = augmented_systems.jacobians_at(
        problem.equations, z + np.outer(STENCIL_NODES * node_spacing, np.append(right_null, 0.0)), problem
    )
    if closure_sign < 0:  # the flight back to the first impact sees that impact moved in the opposite direction
        antiperiodic_direction = np.append(right_null, 0.0)
        antiperiodic_direction[_closure_indices(problem)[0]] *= -1.0
        antiperiodic_jacobians = augmented_systems.jacobians_at(
            problem.equations, z + np.outer(STENCIL_NODES * node_spacing, antiperiodic_direction), problem
        )
        stencil_jacobians = np.array(stencil_jacobians)
        return_flight_rows = _closure_indices(problem)[1]
        stencil_jacobians[:, return_flight_rows] = antiperiodic_jacobians[:, return_flight_rows]
    jacobian_derivative = np.tensordot(FIRST_DERIV_WEIGHTS, stencil_jacobians, 1) / node_spacing
    jacobian_curvature = np.tensordot(SECOND_DERIV_WEIGHTS, stencil_jacobians, 1) / node_spacing**2
    return _NullVectorDerivatives(
        problem,
        closure_sign,
        right_null,
        left_null,
        jacobian,
        jacobian_derivative,
        float(
            left_null @ _multiply_by_closure(problem, jacobian_curvature[None], closure_sign)[0][:, :-1] @ right_null
        ),
    )


def _unfold_pitchfork(null_derivatives, null_vector):
    """Compute the normal form of a pitchfork: at a PD of the doubled orbit, or at an SB of a symmetric orbit."""
    n_unknowns = len(null_derivatives.right_null)
    quadratic_term = (
        _multiply_by_closure(
            null_derivatives.problem, null_derivatives.jacobian_derivative[None], null_derivatives.closure_sign
        )[0][:, :-1]
        @ null_derivatives.right_null
    )
    bordered_matrix = np.zeros((n_unknowns + 1, n_unknowns + 1))
    bordered_matrix[:n_unknowns, :n_unknowns] = null_derivatives.jacobian[:, :-1]
    if null_derivatives.closure_sign > 0:  # singular matrix, but the right-hand side is in its range
        bordered_matrix[:n_unknowns, -1], bordered_matrix[-1, :n_unknowns] = (
            null_derivatives.left_null,
            null_derivatives.right_null,
        )
    else:
        bordered_matrix[-1, -1] = 1.0
    right_hand_sides = np.vstack(
        [np.stack([-0.5 * quadratic_term, -null_derivatives.jacobian[:, -1]], 1), np.zeros((1, 2))]
    )
    quadratic_shift, parameter_shift = np.linalg.solve(bordered_matrix, right_hand_sides)[:n_unknowns].T
    null_gradient = null_derivatives.left_null @ null_derivatives.jacobian_derivative
    crossing_coefficient = null_gradient[:-1] @ parameter_shift + null_gradient[-1]
    first_impact_indices, return_flight_rows = _closure_indices(null_derivatives.problem)
    closure_derivative = (
        null_derivatives.left_null[return_flight_rows]
        @ null_derivatives.jacobian[np.ix_(return_flight_rows, first_impact_indices)]
        @ null_derivatives.right_null[first_impact_indices]
    )
    return Unfolding(
        float(-(null_derivatives.third_derivative / 6.0 + null_gradient[:-1] @ quadratic_shift) / crossing_coefficient),
        null_vector,
        float(-crossing_coefficient / closure_derivative),
    )


def _closure_indices(problem):
    """Return (indices of the unknowns of the first impact, rows of the flight back to the first impact)."""
    n_rows = len(problem.sequence.sides)
    last_row_index = len(problem.impact_rows) - 1
    return [0, n_rows], [last_row_index, n_rows + last_row_index]


def _multiply_by_closure(problem, open_jacobians, closure_sign):
    """Multiply the derivatives of the closing flight with respect to the first impact by the closure sign."""
    closed_jacobians = np.array(open_jacobians)
    if closure_sign < 0:
        first_impact_indices, return_flight_rows = _closure_indices(problem)
        for row in return_flight_rows:
            closed_jacobians[:, row, first_impact_indices] *= -1.0
    return closed_jacobians


def _stencil_spacing(scene, problem, z, z_direction):
    """Return the spacing along v for which the equations are smooth over the whole stencil."""
    n_rows, impact_row_indices, length_scale = problem.n_rows, problem.impact_rows, problem.length_scale
    time_changes, speed_changes = abs(z_direction[impact_row_indices]), abs(z_direction[n_rows + impact_row_indices])
    flight_durations = (
        np.append(z[impact_row_indices[1:]], z[impact_row_indices[0]] + problem.duration(z))
        - z[impact_row_indices]
        - contact_durations_at(problem, z)[impact_row_indices]
    )
    relative_changes = [
        (time_changes + np.roll(time_changes, -1)) / (MAX_FLIGHT_FRACTION * flight_durations),
        np.maximum(time_changes, speed_changes / length_scale)
        * max(_fastest_equation_rate(scene), *_half_oscillation_rates(scene, problem, z))
        / NODE_SPACING,
    ]
    if scene.soft_sides:
        relative_changes.append(speed_changes / (MAX_FLIGHT_FRACTION * abs(z[n_rows + impact_row_indices])))
    return 1.0 / float(np.max(relative_changes))


def _half_oscillation_rates(scene, problem, z):
    """Return 0 and, under a user-defined force, pi divided by the duration of each contact phase."""
    contact_durations = (
        contact_durations_at(problem, z)[problem.impact_rows]
        if scene.soft_sides and scene.force is not None
        else np.zeros(0)
    )
    return [0.0, *(np.pi / contact_durations[contact_durations > 0])]


def _fastest_equation_rate(scene):
    """Return the fastest rate of oscillation or decay in the equations of an orbit."""
    frequency, equation_rates = float(scene.frequency), flow_of_scene(scene).rates(scene)
    equation_rates += [drive_term.harmonic * frequency for drive_term in scene.drive]
    for side, wall in scene.walls.items():
        equation_rates += contact_of_wall(scene, side).rates(scene, side)
        if wall.motion is not None:
            equation_rates.append(wall.motion.harmonic * frequency)
    return max(equation_rates)
