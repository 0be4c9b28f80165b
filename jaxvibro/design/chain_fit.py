"""Fit parameters of a scene to a chain of impacts: least squares of the times under the equations of the flights."""

from functools import partial
from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Float, Int

from ..scene.scene import Scene
from . import least_squares
from .chain_equations import Nodes, flight_residuals
from .least_squares import (
    MAX_ITERATIONS,
    STEP_TOLERANCE,
    FreeParameters,
    LeastSquaresProblem,
    LeastSquaresSolution,
    Linearisation,
)

MIN_TIME_FRACTION = 0.25  # smallest ratio of a flight time to its value before a step
MIN_FLIGHT_TIME = 1e-12  # smallest flight time
MIN_STEP_FRACTION = 1e-9  # smallest fraction of a step


class Measurements(NamedTuple):
    """Measurements of nodes: node index, index of the unknown (0 first, 1 second), measured value, standard error."""

    node_indices: Int[np.ndarray, " seen"]
    unknown_indices: Int[np.ndarray, " seen"]
    value: Float[np.ndarray, " seen"]
    sigma: Float[np.ndarray, " seen"]


def fit_chain_parameters(
    scene: Scene,
    phase: float,
    nodes: Nodes,
    measurements: Measurements,
    free_params: FreeParameters,
    parameters,
    max_iterations=MAX_ITERATIONS,
    step_tolerance=STEP_TOLERANCE,
) -> LeastSquaresSolution:
    """Solve the least squares from approximate nodes and parameters.

    `phase` is that of the drive at time 0 if it is not a free parameter.
    """
    problem = LeastSquaresProblem(
        partial(_linearise, scene, phase, measurements, free_params), _shift_nodes, _max_step_fraction
    )
    return least_squares.solve_least_squares(problem, nodes, free_params, parameters, max_iterations, step_tolerance)


def _linearise(scene, phase, measurements, free_params, nodes, parameters):
    """Return the `Linearisation` of the flights and measurements at nodes and parameters."""
    names, drive_phase = free_params.split_phase(parameters, phase)
    flights = flight_residuals(scene, names, nodes, parameters[: len(names)], drive_phase)
    n_flights, n_nodes = len(flights.values), len(nodes.sides)
    node_blocks = flights.derivatives[:, :, :4].reshape(2 * n_flights, 4)
    rows = np.repeat(np.arange(2 * n_flights), 4)
    columns = np.repeat(2 * np.arange(n_flights), 8) + np.tile(np.arange(4), 2 * n_flights)
    parameter_jacobian = (
        flights.derivatives[:, :, 4 : 4 + len(parameters)].reshape(2 * n_flights, -1) * free_params.scales
    )
    node_jacobian = scipy.sparse.csr_array((node_blocks.ravel(), (rows, columns)), (2 * n_flights, 2 * n_nodes))
    constraint_jacobian = scipy.sparse.hstack([node_jacobian, parameter_jacobian], format="csr")
    unknowns, n_measurements = np.stack([nodes.first_unknown, nodes.second_unknown], 1), len(measurements.node_indices)
    residuals = (
        unknowns[measurements.node_indices, measurements.unknown_indices] - measurements.value
    ) / measurements.sigma
    entry_indices = np.arange(n_measurements), 2 * measurements.node_indices + measurements.unknown_indices
    residual_jacobian = scipy.sparse.csr_array(
        (1.0 / measurements.sigma, entry_indices), (n_measurements, constraint_jacobian.shape[1])
    )
    return Linearisation(flights.values.ravel(), constraint_jacobian, residuals, residual_jacobian)


def _shift_nodes(nodes, change):
    first_changes, second_changes = change.reshape(-1, 2).T
    return nodes._replace(
        first_unknown=nodes.first_unknown + first_changes, second_unknown=nodes.second_unknown + second_changes
    )


def _max_step_fraction(nodes, parameters, node_change, parameter_change):
    """Return the largest fraction of a step that keeps the nodes in order."""
    is_impact = nodes.sides != 0
    flight_times, time_changes = (
        np.diff(nodes.times),
        np.diff(np.where(is_impact, node_change.reshape(-1, 2)[:, 0], 0.0)),
    )
    flight_times = np.maximum(flight_times, MIN_FLIGHT_TIME)
    return max(
        min([1.0, *((1.0 - MIN_TIME_FRACTION) * flight_times[time_changes < 0] / -time_changes[time_changes < 0])]),
        MIN_STEP_FRACTION,
    )
