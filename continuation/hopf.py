"""Where periodic orbits are born: from a Hopf point on, and back into one."""

import numpy as np

from . import event_search, locate
from .driver import End, Met
from .errors import ContinuationError
from .problem import EQUILIBRIA, System, eigenvalues_at, matrix_at, problem_of
from .rows import at, put, upto
from .stretch import Mark

LITTLE = 0.02  # of 1 + the largest number: orbits as small, and shrinking, are about to end in a Hopf point


def born(special, orbits, given):
    """(z, the unit tangent) of the periodic orbits at a Hopf point: the point itself, the eigenvalues' period, and one
    round of their eigenvector (Kuznetsov, 10.2)."""
    matrix = matrix_at(special.system, "", special.names, special.z, given)
    values, vectors = np.linalg.eig(matrix)
    place = int(np.argmin(np.where(values.imag > 0, abs(values.real), np.inf)))
    q = vectors[:, place] * np.exp(-0.5j * np.angle(vectors[:, place] @ vectors[:, place]))  # real, imaginary: across
    turned = np.exp(2j * np.pi * np.arange(orbits.segments) / orbits.segments)
    points, along = np.tile(special.u, orbits.segments), np.outer(turned, q).real.reshape(-1)
    z = np.concatenate([points, [2.0 * np.pi / values[place].imag], special.z[-1:]])
    return z, np.append(along / np.linalg.norm(along), [0.0, 0.0])


def first_orbit(task, start):
    """The `Point` a first step away from a Hopf point, where the equations are singular. Raises ContinuationError."""
    one = event_search.step(task.problem, start, task.first, task.control, task.args)
    if not one.met:
        rule = "must lead to an orbit: take a shorter one, or a smaller tolerance of `periodic_orbits`"
        raise ContinuationError("first_step", rule, task.first)
    return one._replace(step=np.zeros(()), kept=np.True_)


def ahead(system, names, task, points):
    """`Met` at the Hopf point into which a row of orbits shrinks, once they are `LITTLE`; None where none does."""
    size, count = points.z.shape[1] - len(names), system.segments * system.times
    rounds = points.z[:, : size - 1].reshape(len(points.z), count, -1)
    middles = rounds.mean(axis=1)
    swings = np.linalg.norm(rounds - middles[:, None], axis=(1, 2)) / (1.0 + abs(middles).max(axis=1))
    little = 1 + np.flatnonzero((swings[1:] < LITTLE) & (swings[1:] < swings[:-1]))
    if not len(little) or count < 2:
        return None
    k = int(little[0])
    steady = System(system.function, EQUILIBRIA)
    (test,) = problem_of(steady, names).tests
    found = locate.singular(problem_of(steady, names), test, np.append(middles[k], points.z[k, size:]), task.args)
    if found.z is None or not test.holds(found.z, task.args):
        return None
    values = eigenvalues_at(steady, names, found.z, task.args)
    own = values[np.argmin(abs(values - 2j * np.pi / points.z[k, size - 1]))].imag
    z = np.concatenate([np.tile(found.z[: -len(names)], count), [2.0 * np.pi / own], found.z[-len(names) :]])
    length = float(np.linalg.norm(z - points.z[k]))
    if length > 3.0 * swings[k] * (1.0 + abs(z).max()):
        return None
    one = at(points, k)._replace(z=z, step=np.float64(length), residual=np.float64(found.residual))
    return Met(put(upto(points, k + 1), k + 1, one), Mark(0, "HB", found.residual), End.HOPF)
