"""Follow a branch through a known orbit with SciPy: shooting on the map, pseudo-arclength, both directions."""

import numpy as np

from benchmarks.scipy_arclength import FEW, FREE, GROWTH, LONGEST, SHORTEST, correct, stroboscopic, survey

MOST = 400  # largest number of points in each direction


def followed(family, bounds, place, step):
    """Follow a branch in both directions within the bounds of A.

    Returns (points (points, 3), x, v and A in order along the branch; [(kind, A)], special points between them). `step`
    is the first step, arclength in (x, v, A). SN is where A turns; PD is where det(M + 1) and SB where that of the
    bordered Jacobian changes sign, A by interpolation.
    """
    sides = (-1, 1) if family.symmetric else (1,)
    strobe = stroboscopic(family.omega, family.gamma, family.restitution, sides, family.periods)
    ways = [one_way(strobe, bounds, place, sign * FREE, step) for sign in (-1.0, 1.0)]
    points = [turned(each) for each in reversed(ways[0][1:])] + ways[1]
    return np.array([each.place for each in points]), labelled(points)


def one_way(strobe, bounds, place, ahead, step):
    """Return the `Point` objects from a point on, in the direction within a right angle of `ahead`."""
    start = survey(strobe, place, ahead)
    found, length = [start], step
    while len(found) < MOST and bounds[0] < found[-1].place[2] < bounds[1]:
        there, maps = correct(strobe, found[-1], length)
        new = None if there is None else survey(strobe, there, found[-1].tangent)
        if new is None or not np.isfinite(new.slopes).all():
            length *= 0.5
            if length < SHORTEST * step:
                break
            continue
        found.append(new)
        if maps <= FEW:
            length = min(GROWTH * length, LONGEST * step)
    return found


def turned(point):
    """Return the point with reversed tangent."""
    return point._replace(tangent=-point.tangent)


def labelled(points):
    """Return [(kind, A)] where a test function changes sign between two points, linear in the arclength."""
    tests = {
        "SN": lambda point: point.tangent[2],
        "PD": lambda point: np.linalg.det(point.slopes[:, :2] + np.eye(2)),
        "SB": lambda point: np.linalg.det(np.vstack([point.slopes - np.eye(2, 3), point.tangent])),
    }
    found = []
    for kind, test in tests.items():
        values = np.array([test(point) for point in points])
        for k in np.flatnonzero(values[:-1] * values[1:] < 0):
            found.append((kind, between(points[k], points[k + 1], values[k] / (values[k] - values[k + 1]))))
    return found


def between(one, other, share):
    """Return A at a fraction of the arclength between two points, by the cubic with their tangents."""
    length = np.linalg.norm(other.place - one.place)
    low, high, slope, last = one.place[2], other.place[2], length * one.tangent[2], length * other.tangent[2]
    square, cube = share**2, share**3
    told = (2 * cube - 3 * square + 1) * low + (3 * square - 2 * cube) * high
    return float(told + (cube - 2 * square + share) * slope + (cube - square) * last)
