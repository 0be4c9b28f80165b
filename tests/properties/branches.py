"""Branches of random scenes for the properties: each is computed once for a kind and a number."""

from functools import cache

import numpy as np

import jaxvibro as jv

from .orbits import settled_orbit

NAMES = ("amplitude", "frequency", "damping", "left.position", "right.position")
MOST_POINTS = 300
FAILURES = {"STEP", "POINTS", "NUMBER"}
SYMMETRIC_KINDS = "two_walls", "solver", "contact_law"
FEW = 8  # impacts: towards complete chatter there is no end of special points
STUCK = 2  # from this side on a row of a branch is one at which a wall releases the mass


def parameter(kind, number):
    """Return the parameter of a branch: the amplitude for the first draws."""
    names = settled_orbit(kind, number).scene.names
    return "amplitude" if number < 2 else [name for name in NAMES if name in names][number % 3]


def bounds_of(scene, name, narrow=1.0):
    """Return the bounds of a branch around the value of a scene."""
    value = float(scene.parameter(name))
    if "position" in name:
        return value - 0.15 * narrow, value + 0.15 * narrow
    return value * (1.0 - 0.6 * narrow), value * (1.0 + 0.9 * narrow)


@cache
def branch_of(kind, number):
    """Return the branch of a draw, of at most MOST_POINTS points."""
    orbit, name = settled_orbit(kind, number), parameter(kind, number)
    return jv.follow(orbit, name, bounds_of(orbit.scene, name), max_points=MOST_POINTS)


def branch_with(kind, number, kinds_of_point):
    """Return the branch of a draw, or one of the next draws if it is the first with such a special point."""
    branches = (branch_of(kind, number + k) for k in range(4))
    having = (branch for branch in branches if {point.kind for point in branch.special} & set(kinds_of_point))
    return next(having, branch_of(kind, number))


@cache
def switched_branches(kind, number):
    """Return (special point, the branches that leave it) of the first PD and SB of a branch.

    Walls that are alike are placed symmetrically for it, so that there are SB.
    """
    branch, switched = None, []
    if kind.name in SYMMETRIC_KINDS:
        branches = (symmetric_branch(kind, number + k) for k in range(4))
        branch = next((each for each in branches if each and (each.points("SB") or each.points("PD"))), None)
    branch = branch or branch_with(kind, number, ("PD", "SB"))
    for kind_of_point in ("PD", "SB"):
        for point in branch.points(kind_of_point)[:1]:
            room = 0.02 * (1.0 + abs(point.value))
            low, high = max(branch.bounds[0], point.value - room), min(branch.bounds[1], point.value + room)
            switched.append((point, jv.switch(point, (low, high))))
    return switched


def symmetric_branch(kind, number):
    """Return the branch along the amplitude of a draw's scene with its walls placed symmetrically, None without one."""
    scene = settled_orbit(kind, number).scene
    half = 0.5 * (float(scene.right.position) - float(scene.left.position))
    changes = {"left.position": -half, "right.position": half}
    if "right.restitution" in scene.names:
        changes["left.restitution"] = scene.parameter("right.restitution")
    scene = scene.replace(**changes)
    try:
        orbit = jv.find_orbit(scene, jv.State(0.5 * half, -1.0), settle=400)
        return jv.follow(orbit, "amplitude", bounds_of(scene, "amplitude"), max_points=MOST_POINTS)
    except jv.OrbitError:
        return None


def end_names(branch):
    return [end.name for end in branch.ends]


def significant(branch):
    """Return the special points that another computation of the branch must have as well."""
    return [point for point in branch.special if point.kind not in ("EP", "CH") and len(point.spot.times) <= FEW]


def is_whole(branch):
    """Return whether a branch ends neither at a limit of its computation nor in complete chatter."""
    partial = {"MAX_POINTS", "MAX_SECONDS", "CHATTER", "UNSETTLED", "REST"}
    return not partial & set(end_names(branch)) and not branch.points("CH")


def assert_same_points(branch, other, tolerance):
    """Check that two branches have the same special points, in this order, the reverse one, or cyclically if closed."""
    first, second = ([(point.kind, point.value) for point in significant(each)] for each in (branch, other))
    first, second = (sorted(rows, key=lambda row: (row[1], row[0])) for rows in (first, second))
    assert len(first) == len(second), (first, second)
    np.testing.assert_allclose([value for _, value in first], [value for _, value in second], rtol=0, atol=tolerance)
    assert sorted(kind for kind, _ in first) == sorted(kind for kind, _ in second)


def is_on(orbit, diagram):
    """Return whether an orbit is on a branch of a diagram: between two points of it, near the line between them.

    Orbits that stick are compared by their fastest impacts, as a branch leaves out some of the slowest bounces.
    """
    value, size = float(orbit.scene.parameter(diagram.name)), max(1.0, abs(orbit.impacts.speed).max(initial=0.0))
    for branch in diagram.branches:
        data, values = branch.data, branch.values
        if data.sizes["period"] != orbit.periods:
            continue
        for k in np.flatnonzero((values[:-1] - value) * (values[1:] - value) <= 0):
            rows = [data["speed"].values[j][abs(data["side"].values[j]) == 1] for j in (k, k + 1)]
            rows = [np.sort(row)[::-1] for row in (*rows, orbit.impacts.speed)]
            count = min(map(len, rows))
            if orbit.rests == (abs(data["side"].values[k]) >= STUCK).any() and (
                orbit.rests or count == max(map(len, rows))
            ):
                first, second, speeds = (row[:count] for row in rows)
                line = first + (second - first) * (value - values[k]) / (values[k + 1] - values[k] or 1.0)
                if abs(line - speeds).max(initial=0.0) < 2e-2 * size:
                    return True
    return False
