"""The ways in which branches leave a special point of one."""

import numpy as np

from . import branch_switching as crossing
from . import cycles, event_search, locate
from .errors import ContinuationError
from .problem import ORBITS, Given, matrix_at, problem_of

KINDS = ("BP", "PD", "HB")  # special points that other branches leave


def phase_of(system, u, p, args):
    """The `cycles.Phase` of which an orbit itself is the reference. Raises ContinuationError."""
    count = system.segments * system.times
    if len(u) <= count or (len(u) - 1) % count:
        raise ContinuationError("u", f"must be {count} points, one after another, and the period", u)
    p = {name: float(value) for name, value in p.items()}
    return cycles.Phase(
        *(np.asarray(each) for each in cycles.phase_at(system.function, u[:-1].reshape(count, -1), p, args))
    )


def ways(special, orbits):
    """(the system of what leaves, z, its `Given`, the tangents)."""
    names, system, z = special.names, special.system, special.z
    given = Given({name: value for name, value in special.p.items() if name not in names}, special.args)
    if special.kind == "HB":
        return born(special, orbits, given)
    if system.kind == ORBITS:
        given = given._replace(phase=phase_of(system, special.u, special.p, special.args))
    if special.kind == "PD":
        null = locate.null(matrix_at(system, "PD", names, z, given))
        return doubled(system, z, given, null)
    found = crossing.directions(problem_of(system, names), z, np.ones(len(z)), given)
    tangent = crossing.other(found, special.tangent, np.ones(len(z)))
    return system, z, given, [tangent, -tangent]


def doubled(system, z, given, null):
    """The same of what goes round twice, away along a null vector."""
    twice = system._replace(times=2 * system.times)
    if system.kind != ORBITS:
        return twice, z, given, [np.append(null, 0.0)]
    points, (period, value) = z[:-2], z[-2:]
    phase = cycles.Phase(*(np.concatenate([each, each]) / np.sqrt(k) for k, each in enumerate(given.phase, 1)))
    tangent = np.concatenate([null, -null, np.zeros(2)]) / np.sqrt(2.0)
    return twice, np.concatenate([points, points, [2.0 * period, value]]), given._replace(phase=phase), [tangent]


def born(special, orbits, given):
    """The same of the periodic orbits at a Hopf point: a point, flown round once in the eigenvalues' period."""
    matrix = matrix_at(special.system, "", special.names, special.z, given)
    values, vectors = np.linalg.eig(matrix)
    place = int(np.argmin(np.where(values.imag > 0, abs(values.real), np.inf)))
    q, frequency = vectors[:, place], values[place].imag
    turned = np.exp(2j * np.pi * np.arange(orbits.segments) / orbits.segments)
    q = q * np.exp(-0.5j * np.angle(q @ q))  # its real and imaginary parts are at right angles
    around = np.outer(turned, q)
    points, along = np.tile(special.u, (orbits.segments, 1)), around.real.reshape(-1)
    phase = cycles.Phase(points, -around.imag / np.linalg.norm(around.imag))
    z = np.concatenate([points.reshape(-1), [2.0 * np.pi / frequency], special.z[-1:]])
    return orbits, z, given._replace(phase=phase), [np.append(along / np.linalg.norm(along), [0.0, 0.0])]


def first_orbit(task, start):
    """The `Point` a first step away from a Hopf point, where the equations are singular. Raises ContinuationError."""
    one = event_search.step(task.problem, start, task.first, task.control, task.args)
    if not one.met:
        raise ContinuationError("first_step", "must lead to an orbit", task.first)
    return one._replace(step=np.zeros(()), kept=np.True_)
