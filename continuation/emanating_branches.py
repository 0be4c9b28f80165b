"""Compute the starting points and directions of the branches that emanate from a special point."""

import numpy as np

from . import augmented_systems, hopf_orbits
from . import branch_point_tangents as crossing
from .branch import unknowns_and_constants
from .problem import ORBITS, make_problem, matrix_of_kind

KINDS = ("BP", "SB", "PD", "HB")  # special points from which branches emanate


def emanating_directions(special, orbit_system):
    """Return the `System`, z, `SystemConstants` and tangents of the branches that emanate from a special point."""
    param_names, system = special.names, special.system
    z, constants = unknowns_and_constants(special, param_names)
    if special.kind == "HB":
        z, tangent = hopf_orbits.hopf_orbit_start(special, orbit_system, constants)
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
