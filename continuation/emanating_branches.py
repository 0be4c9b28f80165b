"""Start the branches that emanate from special points, and detect branches that end in Hopf points."""

import numpy as np

from . import augmented_systems, event_search
from . import augmented_systems as crossing
from .branch import unknowns_and_constants
from .branch_segment import SpecialIndex, first_rows, insert_row, row_at
from .continuation_loop import End, Termination
from .errors import ContinuationError
from .problem import EQUILIBRIA, ORBITS, System, eigenvalues_at, make_problem, matrix_of_kind

SMALL_ORBIT = 0.02  # size, relative to 1 + the largest coordinate, below which a shrinking orbit is near a Hopf point


def hopf_orbit_start(special, orbit_system, constants):
    """Return (z, unit tangent) of the periodic orbits at a Hopf point.

    z consists of copies of the Hopf point, the period 2 pi / omega of the critical eigenvalue i omega, and the
    parameter. The tangent consists of samples of Re(q exp(i theta)), where q is the critical eigenvector and theta
    increases by 2 pi (Kuznetsov, Elements of Applied Bifurcation Theory, 10.2).
    """
    jacobian = matrix_of_kind(special.system, "", special.names, special.z, constants)
    eigenvalues, eigenvectors = np.linalg.eig(jacobian)
    critical_index = int(np.argmin(np.where(eigenvalues.imag > 0, abs(eigenvalues.real), np.inf)))
    # This phase makes the real and imaginary parts of q orthogonal.
    critical_eigenvector = eigenvectors[:, critical_index] * np.exp(
        -0.5j * np.angle(eigenvectors[:, critical_index] @ eigenvectors[:, critical_index])
    )
    phase_factors = np.exp(2j * np.pi * np.arange(orbit_system.segments) / orbit_system.segments)
    equal_points, points_direction = (
        np.tile(special.u, orbit_system.segments),
        np.outer(phase_factors, critical_eigenvector).real.reshape(-1),
    )
    z = np.concatenate([equal_points, [2.0 * np.pi / eigenvalues[critical_index].imag], special.z[-1:]])
    return z, np.append(points_direction / np.linalg.norm(points_direction), [0.0, 0.0])


def first_orbit(task, hopf_start_point):
    """Return the `Point` one step away from a Hopf point; raise ContinuationError if Newton's method fails."""
    point = event_search.take_step(task.problem, hopf_start_point, task.first_step, task.control, task.args)
    if not point.converged:
        error_rule = "must lead to a periodic orbit; reduce first_step or the tolerance of `periodic_orbits`"
        raise ContinuationError("first_step", error_rule, task.first_step)
    return point._replace(step=np.zeros(()), accepted=np.True_)


def find_hopf_end(system, param_names, task, points):
    """Return the `Termination` at the Hopf point into which the orbits of a branch shrink, or None.

    The function examines the first orbit of decreasing size that is smaller than `SMALL_ORBIT`.
    """
    n_unknowns, n_segments = points.z.shape[1] - len(param_names), system.segments * system.times
    orbit_points = points.z[:, : n_unknowns - 1].reshape(len(points.z), n_segments, -1)
    orbit_centres = orbit_points.mean(axis=1)
    orbit_sizes = np.linalg.norm(orbit_points - orbit_centres[:, None], axis=(1, 2)) / (
        1.0 + abs(orbit_centres).max(axis=1)
    )
    small_orbit_rows = 1 + np.flatnonzero((orbit_sizes[1:] < SMALL_ORBIT) & (orbit_sizes[1:] < orbit_sizes[:-1]))
    if not len(small_orbit_rows) or n_segments < 2:
        return None
    row = int(small_orbit_rows[0])
    equilibrium_system = System(system.function, EQUILIBRIA)
    (test_function,) = make_problem(equilibrium_system, param_names).test_functions
    hopf_point = augmented_systems.locate_singularity(
        make_problem(equilibrium_system, param_names),
        test_function,
        np.append(orbit_centres[row], points.z[row, n_unknowns:]),
        task.args,
    )
    if hopf_point.z is None or not test_function.is_valid(hopf_point.z, task.args):
        return None
    eigenvalues = eigenvalues_at(equilibrium_system, param_names, hopf_point.z, task.args)
    critical_frequency = eigenvalues[np.argmin(abs(eigenvalues - 2j * np.pi / points.z[row, n_unknowns - 1]))].imag
    hopf_orbit_z = np.concatenate(
        [
            np.tile(hopf_point.z[: -len(param_names)], n_segments),
            [2.0 * np.pi / critical_frequency],
            hopf_point.z[-len(param_names) :],
        ]
    )
    length = float(np.linalg.norm(hopf_orbit_z - points.z[row]))
    if length > 3.0 * orbit_sizes[row] * (1.0 + abs(hopf_orbit_z).max()):
        return None
    end_point = row_at(points, row)._replace(
        z=hopf_orbit_z, step=np.float64(length), residual=np.float64(hopf_point.residual)
    )
    return Termination(
        insert_row(first_rows(points, row + 1), row + 1, end_point),
        SpecialIndex(0, "HB", hopf_point.residual),
        End.HOPF,
    )


KINDS = ("BP", "SB", "PD", "HB")  # special points from which branches emanate


def emanating_directions(special, orbit_system):
    """Return the `System`, z, `SystemConstants` and tangents of the branches that emanate from a special point."""
    param_names, system = special.names, special.system
    z, constants = unknowns_and_constants(special, param_names)
    if special.kind == "HB":
        z, tangent = hopf_orbit_start(special, orbit_system, constants)
        return orbit_system, z, constants, [tangent]
    if special.kind in ("SB", "PD"):
        system = system._replace(within=False)
    if special.kind == "PD":
        null_vector = augmented_systems.null_vector(matrix_of_kind(system, "PD", param_names, z, constants))
        return start_period_doubling(system, z, constants, null_vector)
    tangents = crossing.branch_tangents(make_problem(system, param_names), z, np.ones(len(z)), constants)
    tangent = crossing.less_aligned_tangent(tangents, special.tangent, np.ones(len(z)))
    return system, z, constants, [tangent, -tangent]


def start_period_doubling(system, z, constants, null_vector):
    """Return the `System` of doubled period, z, `SystemConstants` and a list with the tangent along a null vector."""
    doubled_system = system._replace(times=2 * system.times)
    if system.kind != ORBITS:
        return doubled_system, z, constants, [np.append(null_vector, 0.0)]
    shooting_points, (period, parameter_value) = z[:-2], z[-2:]
    tangent = np.concatenate([null_vector, -null_vector, np.zeros(2)]) / np.sqrt(2.0)
    return (
        doubled_system,
        np.concatenate([shooting_points, shooting_points, [2.0 * period, parameter_value]]),
        constants,
        [tangent],
    )
