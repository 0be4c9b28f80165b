"""Curves in the plane of the section: distances to a manifold, and boundaries of basins without a manifold."""

import numpy as np
from scipy.spatial import cKDTree

import jaxvibro as jv

BENT, NEAR, ENOUGH = 0.02, 100, 1e-12  # of a chord; chords at most; so near is on the curve


def points_of(curve):
    """Return the points of a manifold, (points, 2)."""
    return np.stack([curve["x"].values, curve["v"].values], -1)


def distance(curve, points):
    """Return how far points (lanes, 2) are from a manifold: from cubics through four points in a row of one piece.

    Sheets lie close: the nearest point of the curve is often on another one. So the chords are searched, those first
    that may be nearest, as a cubic is off its chord by BENT of its length at most.
    """
    z, piece = points_of(curve), curve["piece"].values
    new = np.append(True, (np.diff(piece) != 0) | np.diff(z, axis=0).any(axis=1))
    z, piece = z[new], piece[new]
    chords = np.flatnonzero(np.diff(piece) == 0)
    start, way = z[chords], np.diff(z, axis=0)[chords]
    size = np.hypot(*way.T)
    nearest = cKDTree(z).query(points)[0]
    for lane, point in enumerate(points):
        share = np.clip(((point - start) * way).sum(axis=1) / size**2, 0.0, 1.0)
        least = np.hypot(*(start + share[:, None] * way - point).T) - BENT * size
        for near in np.argsort(least)[:NEAR]:
            if nearest[lane] <= max(least[near], ENOUGH):
                break
            place = chords[near]
            low, high = np.searchsorted(piece, [piece[place], piece[place] + 1])
            count = min(4, high - low)
            for first in range(max(low, place - 2), min(place, high - count) + 1):
                some = z[first : first + count]
                knots = np.append(0.0, np.cumsum(np.hypot(*np.diff(some, axis=0).T)))
                cubic = np.polyfit(knots / knots[-1], some - point, count - 1)
                nearest[lane] = min(nearest[lane], _least_size(cubic))
    return nearest


def _least_size(cubic):
    """Return the least size of a cubic (4, 2) between its ends."""
    square = np.polyadd(np.polymul(cubic[:, 0], cubic[:, 0]), np.polymul(cubic[:, 1], cubic[:, 1]))
    roots = np.roots(np.polyder(square))
    places = np.append(np.clip(roots[abs(roots.imag) < 1e-6].real, 0.0, 1.0), [0.0, 1.0])
    return np.hypot(np.polyval(cubic[:, 0], places), np.polyval(cubic[:, 1], places)).min()


def bisected(scene, attractors, first, second, phase=0.0):
    """Return the point of the line between two starts where the attractor changes, to 1e-12 of the line.

    Independent of Newton's method and of manifolds: only where states end decides.
    """
    first, second = np.array(first), np.array(second)
    points = np.array([attractor.points[0] for attractor in attractors])
    low, high = 0.0, 1.0
    while high - low > 1e-12:
        shares = np.linspace(low, high, 64)
        end, _ = jv.strobe(scene, jv.State(*(first + shares[:, None] * (second - first)).T, phase), 200, 0)
        places = abs(np.stack([end.x, end.v], -1)[:, None] - points).max(axis=-1).argmin(axis=1)
        change = np.flatnonzero(places != places[0])[0]
        low, high = shares[change - 1], shares[change]
    return first + 0.5 * (low + high) * (second - first)
