"""The ways in which branches leave a special point of one."""

import numpy as np

from . import branch_switching as crossing
from . import hopf, locate
from .problem import ORBITS, Given, matrix_at, problem_of

KINDS = ("BP", "SB", "PD", "HB")  # special points that other branches leave


def ways(special, orbits):
    """(the system of what leaves, z, its `Given`, the tangents)."""
    names, system, z = special.names, special.system, special.z
    given = Given({name: value for name, value in special.p.items() if name not in names}, special.args)
    if special.kind == "HB":
        z, tangent = hopf.born(special, orbits, given)
        return orbits, z, given, [tangent]
    if special.kind in ("SB", "PD"):
        system = system._replace(within=False)
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
    tangent = np.concatenate([null, -null, np.zeros(2)]) / np.sqrt(2.0)
    return twice, np.concatenate([points, points, [2.0 * period, value]]), given, [tangent]
