"""Compute the starting points and directions of the branches that emanate from a special point."""

import numpy as np

from . import augmented_systems, hopf
from . import branch_switching as crossing
from .problem import ORBITS, Constants, matrix_at, problem_of

KINDS = ("BP", "SB", "PD", "HB")  # special points from which branches emanate


def emanating_directions(special, orbits):
    """Return the `System`, z, `Constants` and tangents of the branches that emanate from a special point."""
    names, system, z = special.names, special.system, special.z
    constants = Constants({name: value for name, value in special.p.items() if name not in names}, special.args)
    if special.kind == "HB":
        z, tangent = hopf.hopf_orbit_start(special, orbits, constants)
        return orbits, z, constants, [tangent]
    if special.kind in ("SB", "PD"):
        system = system._replace(within=False)
    if special.kind == "PD":
        null_vector = augmented_systems.null_vector(matrix_at(system, "PD", names, z, constants))
        return double_period(system, z, constants, null_vector)
    tangents = crossing.branch_tangents(problem_of(system, names), z, np.ones(len(z)), constants)
    tangent = crossing.farther_tangent(tangents, special.tangent, np.ones(len(z)))
    return system, z, constants, [tangent, -tangent]


def double_period(system, z, constants, null_vector):
    """Return the `System` of doubled period, z, `Constants` and the tangent along a null vector."""
    doubled_system = system._replace(times=2 * system.times)
    if system.kind != ORBITS:
        return doubled_system, z, constants, [np.append(null_vector, 0.0)]
    points, (period, value) = z[:-2], z[-2:]
    tangent = np.concatenate([null_vector, -null_vector, np.zeros(2)]) / np.sqrt(2.0)
    return doubled_system, np.concatenate([points, points, [2.0 * period, value]]), constants, [tangent]
