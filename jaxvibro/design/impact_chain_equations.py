"""Define the equations of a chain of flights from impact to impact, and fit parameters to a chain.

The chain is not closed to a periodic orbit. A node is an impact. Its unknowns are the time and the speed before the
impact. The flight from a node must end on the wall of the next impact, at its time and with its speed. The equations
ignore the walls during a flight. They are therefore smooth in the unknowns and in every number of the scene, and a
grazing is not a singularity. Chaos does not amplify errors, whatever the length of the chain. `impact_prediction`
checks whether a flight passes through a wall.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jaxtyping import Float, Int

from continuation.hostcall import persistent_jit

from ..contact.kinds import flow_coefficients
from ..contact.wall_at_contact import wall_derivatives
from ..flight import flow, further_drive_terms
from ..orbits.contact_maps import evaluate_contact_map
from ..scene.scene import SIDES
from . import constrained_least_squares
from .constrained_least_squares import (
    MAX_ITERATIONS,
    STEP_TOLERANCE,
    FreeParameterSpec,
    LeastSquaresProblem,
    LeastSquaresSolution,
    Linearisation,
)
from .shape_padding import pad_to_power_of_two, scene_with_tangents


class ChainNodes(NamedTuple):
    """Nodes of a chain in order of time.

    Attributes
    ----------
    sides : numpy.ndarray
        Sides of the impacts, -1 left, 1 right. Array of shape (nodes,).
    times : numpy.ndarray
        Times of the impacts. Array of shape (nodes,).
    speeds : numpy.ndarray
        Speeds before the impacts. Array of shape (nodes,).
    """

    sides: Float[np.ndarray, " nodes"]
    times: Float[np.ndarray, " nodes"]
    speeds: Float[np.ndarray, " nodes"]


def flight_residuals(free_spec, nodes, parameters):
    """Return the residuals of the flights between nodes, and their derivatives, for values of the free parameters.

    Returns
    -------
    residuals : numpy.ndarray
        Residuals of position and velocity at the end of each flight. Array of shape (flights, 2).
    derivatives : numpy.ndarray
        Derivatives of the residuals with respect to the time and the speed of the node, those of the next node, and the
        free parameters in units of their scales. Array of shape (flights, 2, 4 + free).
    """
    n_flights, n_params = len(nodes.sides) - 1, len(parameters)
    if n_flights < 1:
        return np.zeros((0, 2)), np.zeros((0, 2, 4 + n_params))
    parameter_names, start_phase = free_spec.separate_start_phase(parameters)
    changed_scene, scene_tangents = scene_with_tangents(
        free_spec.scene, parameter_names, parameters[: len(parameter_names)]
    )
    residuals, derivatives = (
        np.asarray(padded_result)
        for padded_result in _differentiate_flights(
            changed_scene, scene_tangents, *map(pad_to_power_of_two, nodes), np.asarray(float(start_phase))
        )
    )
    # The rows of the tangents that pad those of the parameters lie before the row of the phase.
    derivatives = np.concatenate([derivatives[: 4 + len(parameter_names)], derivatives[-1:]])[: 4 + n_params]
    derivatives = np.moveaxis(derivatives[:, :, :n_flights], (0, 1, 2), (2, 1, 0))
    return residuals[:, :n_flights].T, derivatives * np.concatenate([np.ones(4), free_spec.scales])


def speeds_between_impacts(scene, sides, times, start_phase):
    """Return the speeds at both ends of the flights that connect consecutive impacts at given times.

    Returns two arrays of shape (flights,). The first holds the speed after the impact at the start of each flight,
    positive away from its wall. The second holds the speed before the impact at the end, positive into its wall. At an
    inner impact the two speeds violate the impact law if the times are not those of a motion of the scene. A contact
    phase of a soft wall is assumed to last half a free oscillation.
    """
    n_flights, sides = len(sides) - 1, np.asarray(sides)
    contact_durations = sum(
        (
            np.where(sides == side_code, contact_duration, 0.0)
            for side_code, contact_duration in _estimate_contact_durations(scene)
        ),
        0.0 * sides,
    )
    speeds_after, speeds_before = _speeds_at_flight_ends(
        scene, *map(pad_to_power_of_two, (sides, times, contact_durations)), start_phase
    )
    return np.asarray(speeds_after)[:n_flights], np.asarray(speeds_before)[:n_flights]


def _estimate_contact_durations(scene):
    """Yield (side, estimated contact duration) of each soft wall: half a period of the free oscillation in contact."""
    for side in scene.soft_sides:
        stiffness, damping = float(scene.parameter(f"{side}.stiffness")), float(scene.parameter(f"{side}.damping"))
        yield (1.0 if side == SIDES[1] else -1.0), np.pi / np.sqrt(max(1.0 + stiffness - damping**2, 1.0))


@persistent_jit()
def _differentiate_flights(scene, scene_tangents, sides, times, speeds, start_phase):
    """Return the residuals, and their derivatives by the unknowns, along the scene tangents and by the phase."""
    node_and_next_unknowns = times, speeds, jnp.roll(times, -1), jnp.roll(speeds, -1)

    def stacked_residuals(times, speeds, next_times, next_speeds, scene, start_phase):
        return jnp.stack(_flight_end_residuals(scene, sides, (times, speeds), (next_times, next_speeds), start_phase))

    def residual_derivative(*tangents):
        return jax.jvp(stacked_residuals, (*node_and_next_unknowns, scene, start_phase), tangents)[1]

    n_tangents = len(jax.tree.leaves(scene_tangents)[0])
    tangent_basis, node_ones = jnp.eye(4 + n_tangents + 1), jnp.ones_like(times)
    unknown_tangents = [tangent_basis[:, unknown_index, None] * node_ones for unknown_index in range(4)]
    tangents_with_zero_rows = jax.tree.map(lambda leaf: jnp.pad(leaf, (4, 1)), scene_tangents)
    residual_derivatives = jax.vmap(residual_derivative)(
        *unknown_tangents, tangents_with_zero_rows, tangent_basis[:, -1]
    )
    return stacked_residuals(*node_and_next_unknowns, scene, start_phase), residual_derivatives


def _flight_end_residuals(scene, sides, impacts, next_impacts, start_phase):
    """Return the residuals of position and velocity at the ends of the flights.

    `impacts` and `next_impacts` are the times and speeds of the impacts before and after the flights.
    """
    coeffs, next_sides = flow_coefficients(scene), jnp.roll(sides, -1)
    (times, speeds), (next_times, next_speeds) = impacts, next_impacts
    contact_map = evaluate_contact_map(coeffs, sides, *_drive_phasor(coeffs, start_phase, times), speeds)
    contact_duration = 0.0 if contact_map.contact_time is None else contact_map.contact_time
    flight_time = jnp.maximum(next_times - times - contact_duration, 0.0)
    end_x, end_v = coeffs.flow.fly(coeffs, *contact_map.state, *contact_map.phasor, flight_time)[:2]
    wall_position, wall_velocity = wall_derivatives(
        coeffs, next_sides, *_drive_phasor(coeffs, start_phase, next_times), 1
    )
    return end_x - wall_position, next_sides * (end_v - wall_velocity) - next_speeds


def _drive_phasor(coeffs, start_phase, time):
    """Return the cosine and sine of the phase of the drive at a time."""
    drive_angle = start_phase + coeffs.frequency * time
    return jnp.cos(drive_angle), jnp.sin(drive_angle)


@persistent_jit()
def _speeds_at_flight_ends(scene, sides, impact_times, contact_durations, start_phase):
    """Compute the two arrays of `speeds_between_impacts` for padded nodes."""
    coeffs, next_sides, start_times = flow_coefficients(scene), jnp.roll(sides, -1), impact_times + contact_durations
    flight_time = jnp.maximum(jnp.roll(impact_times, -1) - start_times, 0.0)
    drive_cosine, drive_sine = _drive_phasor(coeffs, start_phase, start_times)
    x, wall_velocity = wall_derivatives(coeffs, sides, drive_cosine, drive_sine, 1)
    unforced_response, forced_response, _ = flow.doubling_responses(
        coeffs.series, coeffs.frequency, coeffs.damping, flight_time
    )
    drive_force_phasor = coeffs.amplitude * drive_cosine, coeffs.amplitude * drive_sine
    end_x_from_rest, _ = flow.apply_responses((unforced_response, forced_response), *drive_force_phasor, x, 0.0 * x)
    drive_term_responses = further_drive_terms.term_responses(
        coeffs.drive_terms, coeffs.frequency, coeffs.damping, flight_time
    )
    drive_terms_dx, drive_terms_dv = further_drive_terms.response_to_terms(
        coeffs.drive_terms, drive_term_responses, coeffs.frequency, drive_cosine, drive_sine
    )
    end_x_from_rest = end_x_from_rest + drive_terms_dx if coeffs.drive_terms else end_x_from_rest
    next_wall_position, next_wall_velocity = wall_derivatives(
        coeffs, next_sides, *_drive_phasor(coeffs, start_phase, jnp.roll(impact_times, -1)), 1
    )
    end_x_per_start_v = unforced_response[1]
    v = (next_wall_position - end_x_from_rest) / jnp.where(end_x_per_start_v == 0, 1.0, end_x_per_start_v)
    _, end_v = flow.apply_responses((unforced_response, forced_response), *drive_force_phasor, x, v)
    end_v = end_v + drive_terms_dv if coeffs.drive_terms else end_v
    return -sides * (v - wall_velocity), next_sides * (end_v - next_wall_velocity)


MIN_TIME_FRACTION = 0.25  # smallest ratio of a flight time to its value before a step
MIN_FLIGHT_TIME = 1e-12  # smallest flight time
MIN_STEP_FRACTION = 1e-9  # smallest fraction of a step


class TimeMeasurements(NamedTuple):
    """Measured times of impacts of a chain.

    Attributes
    ----------
    node_indices : numpy.ndarray
        Index of the node of each measurement. Array of shape (measurements,).
    times : numpy.ndarray
        Measured times. Array of shape (measurements,).
    sigma : numpy.ndarray
        Standard errors. Array of shape (measurements,).
    """

    node_indices: Int[np.ndarray, " seen"]
    times: Float[np.ndarray, " seen"]
    sigma: Float[np.ndarray, " seen"]


def fit_chain_parameters(
    nodes: ChainNodes,
    measurements: TimeMeasurements,
    free_spec: FreeParameterSpec,
    parameters,
    max_iterations=MAX_ITERATIONS,
    step_tolerance=STEP_TOLERANCE,
) -> LeastSquaresSolution:
    """Fit the nodes and parameters of a chain to measurements, from approximate nodes and parameters."""
    problem = LeastSquaresProblem(
        partial(_linearise_chain, measurements, free_spec), _add_node_change, _max_step_fraction
    )
    return constrained_least_squares.solve_least_squares(
        problem, nodes, free_spec, parameters, max_iterations, step_tolerance
    )


def _linearise_chain(measurements, free_spec, nodes, parameters):
    """Return the `Linearisation` of flight residuals (constraints) and measurement residuals of a chain."""
    constraints, derivatives = flight_residuals(free_spec, nodes, parameters)
    n_flights, n_nodes, n_measurements = len(constraints), len(nodes.sides), len(measurements.times)
    jacobian_rows = np.repeat(np.arange(2 * n_flights), 4)
    jacobian_columns = np.repeat(2 * np.arange(n_flights), 8) + np.tile(np.arange(4), 2 * n_flights)
    node_jacobian = scipy.sparse.csr_array(
        (derivatives[:, :, :4].ravel(), (jacobian_rows, jacobian_columns)), (2 * n_flights, 2 * n_nodes)
    )
    parameter_jacobian = derivatives[:, :, 4:].reshape(2 * n_flights, len(parameters))
    constraint_jacobian = scipy.sparse.hstack([node_jacobian, parameter_jacobian], format="csr")
    residuals = (nodes.times[measurements.node_indices] - measurements.times) / measurements.sigma
    residual_entry_indices = np.arange(n_measurements), 2 * measurements.node_indices
    residual_jacobian = scipy.sparse.csr_array(
        (1.0 / measurements.sigma, residual_entry_indices), (n_measurements, constraint_jacobian.shape[1])
    )
    return Linearisation(constraints.ravel(), constraint_jacobian, residuals, residual_jacobian)


def _add_node_change(nodes, node_change):
    time_changes, speed_changes = node_change.reshape(-1, 2).T
    return nodes._replace(times=nodes.times + time_changes, speeds=nodes.speeds + speed_changes)


def _max_step_fraction(nodes, parameters, node_change, parameter_change):
    """Return the largest fraction of a step, at most 1, that keeps the nodes in order of time."""
    flight_times = np.maximum(np.diff(nodes.times), MIN_FLIGHT_TIME)
    flight_time_changes = np.diff(node_change.reshape(-1, 2)[:, 0])
    is_shorter = flight_time_changes < 0
    max_fractions = (1.0 - MIN_TIME_FRACTION) * flight_times[is_shorter] / -flight_time_changes[is_shorter]
    return max(min([1.0, *max_fractions]), MIN_STEP_FRACTION)
