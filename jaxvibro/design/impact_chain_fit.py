"""Fit parameters of a scene to a chain of impacts by least squares, subject to the equations of the flights."""

from functools import partial
from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Float, Int

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
