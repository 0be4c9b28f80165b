"""Start branches of periodic orbits at Hopf points and detect their ends in Hopf points."""

import numpy as np

from . import augmented_systems, event_search
from .branch_segment import SpecialIndex
from .driver import End, Termination
from .errors import ContinuationError
from .point_rows import head, insert_row, row_at
from .problem import EQUILIBRIA, System, eigenvalues_at, matrix_at, problem_of

SMALL_ORBIT = 0.02  # size, relative to 1 + the largest coordinate, below which a shrinking orbit is near a Hopf point


def hopf_orbit_start(special, orbits, constants):
    """Return (z, unit tangent) of the periodic orbits at a Hopf point.

    z consists of the point itself and the period of the critical eigenvalues; the tangent is one revolution of their
    eigenvector (Kuznetsov, 10.2).
    """
    matrix = matrix_at(special.system, "", special.names, special.z, constants)
    eigenvalues, eigenvectors = np.linalg.eig(matrix)
    critical_index = int(np.argmin(np.where(eigenvalues.imag > 0, abs(eigenvalues.real), np.inf)))
    # This phase makes the real and imaginary parts of q orthogonal.
    q = eigenvectors[:, critical_index] * np.exp(
        -0.5j * np.angle(eigenvectors[:, critical_index] @ eigenvectors[:, critical_index])
    )
    phase_factors = np.exp(2j * np.pi * np.arange(orbits.segments) / orbits.segments)
    points, direction = np.tile(special.u, orbits.segments), np.outer(phase_factors, q).real.reshape(-1)
    z = np.concatenate([points, [2.0 * np.pi / eigenvalues[critical_index].imag], special.z[-1:]])
    return z, np.append(direction / np.linalg.norm(direction), [0.0, 0.0])


def first_orbit(task, start):
    """Return the `Point` one step away from a Hopf point, where the equations are singular; or raise an error."""
    point = event_search.take_step(task.problem, start, task.first_step, task.control, task.args)
    if not point.converged:
        rule = "must lead to a periodic orbit; reduce first_step or the tolerance of `periodic_orbits`"
        raise ContinuationError("first_step", rule, task.first_step)
    return point._replace(step=np.zeros(()), accepted=np.True_)


def find_hopf_end(system, names, task, points):
    """Return the `Termination` at the Hopf point into which orbits of `SMALL_ORBIT` size shrink, or None."""
    n_unknowns, n_segments = points.z.shape[1] - len(names), system.segments * system.times
    orbit_points = points.z[:, : n_unknowns - 1].reshape(len(points.z), n_segments, -1)
    centres = orbit_points.mean(axis=1)
    orbit_sizes = np.linalg.norm(orbit_points - centres[:, None], axis=(1, 2)) / (1.0 + abs(centres).max(axis=1))
    small_rows = 1 + np.flatnonzero((orbit_sizes[1:] < SMALL_ORBIT) & (orbit_sizes[1:] < orbit_sizes[:-1]))
    if not len(small_rows) or n_segments < 2:
        return None
    row = int(small_rows[0])
    equilibrium_system = System(system.function, EQUILIBRIA)
    (test_function,) = problem_of(equilibrium_system, names).test_functions
    hopf_point = augmented_systems.locate_singularity(
        problem_of(equilibrium_system, names),
        test_function,
        np.append(centres[row], points.z[row, n_unknowns:]),
        task.args,
    )
    if hopf_point.z is None or not test_function.is_valid(hopf_point.z, task.args):
        return None
    eigenvalues = eigenvalues_at(equilibrium_system, names, hopf_point.z, task.args)
    frequency = eigenvalues[np.argmin(abs(eigenvalues - 2j * np.pi / points.z[row, n_unknowns - 1]))].imag
    z = np.concatenate(
        [np.tile(hopf_point.z[: -len(names)], n_segments), [2.0 * np.pi / frequency], hopf_point.z[-len(names) :]]
    )
    length = float(np.linalg.norm(z - points.z[row]))
    if length > 3.0 * orbit_sizes[row] * (1.0 + abs(z).max()):
        return None
    end_point = row_at(points, row)._replace(z=z, step=np.float64(length), residual=np.float64(hopf_point.residual))
    return Termination(
        insert_row(head(points, row + 1), row + 1, end_point), SpecialIndex(0, "HB", hopf_point.residual), End.HOPF
    )
