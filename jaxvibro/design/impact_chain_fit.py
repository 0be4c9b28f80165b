"""Fit parameters of a scene to a chain of impacts by least squares, subject to the equations of the flights."""

from functools import partial
from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Float, Int

from ..scene.scene import Scene
from . import constrained_least_squares
from .constrained_least_squares import (
    MAX_ITERATIONS,
    STEP_TOLERANCE,
    FreeParameterSpec,
    LeastSquaresProblem,
    LeastSquaresSolution,
    Linearisation,
)
from .impact_chain_equations import ChainNodes, flight_residuals

MIN_TIME_FRACTION = 0.25  # smallest ratio of a flight time to its value before a step
MIN_FLIGHT_TIME = 1e-12  # smallest flight time
MIN_STEP_FRACTION = 1e-9  # smallest fraction of a step


class NodeMeasurements(NamedTuple):
    """Measured unknowns of the nodes of a chain.

    Attributes
    ----------
    node_indices : numpy.ndarray
        Index of the node of each measurement. Array of shape (measurements,).
    unknown_indices : numpy.ndarray
        0 for the first unknown of the node, 1 for the second. Array of shape (measurements,).
    value : numpy.ndarray
        Measured values. Array of shape (measurements,).
    sigma : numpy.ndarray
        Standard errors. Array of shape (measurements,).
    """

    node_indices: Int[np.ndarray, " seen"]
    unknown_indices: Int[np.ndarray, " seen"]
    value: Float[np.ndarray, " seen"]
    sigma: Float[np.ndarray, " seen"]


def fit_chain_parameters(
    scene: Scene,
    start_phase: float,
    nodes: ChainNodes,
    measurements: NodeMeasurements,
    free_spec: FreeParameterSpec,
    parameters,
    max_iterations=MAX_ITERATIONS,
    step_tolerance=STEP_TOLERANCE,
) -> LeastSquaresSolution:
    """Fit the nodes and parameters of a chain to measurements, from approximate nodes and parameters.

    `start_phase` is the phase of the drive at time 0. This argument is ignored if the phase is a free parameter.
    """
    problem = LeastSquaresProblem(
        partial(_linearise_chain, scene, start_phase, measurements, free_spec), _add_node_change, _max_step_fraction
    )
    return constrained_least_squares.solve_least_squares(
        problem, nodes, free_spec, parameters, max_iterations, step_tolerance
    )


def _linearise_chain(scene, start_phase, measurements, free_spec, nodes, parameters):
    """Return the `Linearisation` of flight residuals (constraints) and measurement residuals of a chain."""
    parameter_names, drive_phase = free_spec.separate_start_phase(parameters, start_phase)
    residuals_of_flights = flight_residuals(
        scene, parameter_names, nodes, parameters[: len(parameter_names)], drive_phase
    )
    n_flights, n_nodes = len(residuals_of_flights.values), len(nodes.sides)
    node_jacobian_blocks = residuals_of_flights.derivatives[:, :, :4].reshape(2 * n_flights, 4)
    jacobian_rows = np.repeat(np.arange(2 * n_flights), 4)
    jacobian_columns = np.repeat(2 * np.arange(n_flights), 8) + np.tile(np.arange(4), 2 * n_flights)
    parameter_jacobian = (
        residuals_of_flights.derivatives[:, :, 4 : 4 + len(parameters)].reshape(2 * n_flights, -1) * free_spec.scales
    )
    node_jacobian = scipy.sparse.csr_array(
        (node_jacobian_blocks.ravel(), (jacobian_rows, jacobian_columns)), (2 * n_flights, 2 * n_nodes)
    )
    constraint_jacobian = scipy.sparse.hstack([node_jacobian, parameter_jacobian], format="csr")
    node_unknowns, n_measurements = np.stack([nodes.time_or_x, nodes.speed_or_v], 1), len(measurements.node_indices)
    residuals = (
        node_unknowns[measurements.node_indices, measurements.unknown_indices] - measurements.value
    ) / measurements.sigma
    residual_entry_indices = np.arange(n_measurements), 2 * measurements.node_indices + measurements.unknown_indices
    residual_jacobian = scipy.sparse.csr_array(
        (1.0 / measurements.sigma, residual_entry_indices), (n_measurements, constraint_jacobian.shape[1])
    )
    return Linearisation(residuals_of_flights.values.ravel(), constraint_jacobian, residuals, residual_jacobian)


def _add_node_change(nodes, node_change):
    time_or_x_changes, speed_or_v_changes = node_change.reshape(-1, 2).T
    return nodes._replace(
        time_or_x=nodes.time_or_x + time_or_x_changes, speed_or_v=nodes.speed_or_v + speed_or_v_changes
    )


def _max_step_fraction(nodes, parameters, node_change, parameter_change):
    """Return the largest fraction of a step, at most 1, that keeps the nodes in order of time."""
    is_impact = nodes.sides != 0
    flight_times, flight_time_changes = (
        np.diff(nodes.times),
        np.diff(np.where(is_impact, node_change.reshape(-1, 2)[:, 0], 0.0)),
    )
    flight_times = np.maximum(flight_times, MIN_FLIGHT_TIME)
    return max(
        min(
            [
                1.0,
                *(
                    (1.0 - MIN_TIME_FRACTION)
                    * flight_times[flight_time_changes < 0]
                    / -flight_time_changes[flight_time_changes < 0]
                ),
            ]
        ),
        MIN_STEP_FRACTION,
    )
