"""All periodic orbits of a scene, stable or not, by brute force: cells on a section and the closed walks among them.

It takes `strobe` and `monodromy` from the package and nothing else: no trajectory is waited for to recur, no start is
random. Cells cover the section between the walls. Nodes tell where the image of a cell may reach, and it is widened; a
cell through which no walk of n cells closes holds no point of an orbit of n periods. The others are split in four, and
so on. A walk's errors are those of single periods, so neither the growth over n periods nor the square root of a graze
blows up the number of cells: it stays about the same while they shrink. In the end Newton's method starts from a walk
through each cell, the points of all periods unknown. The map jumps where a period ends with an impact: walks that lead
along a wall need have no orbit.
"""

from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.spatial import KDTree

import jaxvibro as jv

BATCH, FEW = 1 << 13, 1 << 9  # states of a call of strobe and of monodromy
BLOCK = 2000  # pieces or cells looked at together, as memory allows
PIECES = 4  # into how many each way a cell is cut to find its image
TRUST = 2.0  # how much farther an image may reach than those of the nodes
SMALLEST = 1e-6  # half-width of a cell that is not split
STEPS = 30  # of Newton's method, each the best of some fractions
FRACTIONS = 0.5 ** np.arange(8)
EXACT = 1e-11  # error of an orbit's points, each against the strobe of the point before
APART = 1e-8  # distance of different points


class Orbit(NamedTuple):
    """A periodic orbit: x, v on the section at phase 0, a row a period; multipliers, the larger one first."""

    points: np.ndarray
    multipliers: np.ndarray


def orbits(scene, max_period, columns=100):
    """All orbits of minimal period up to max_period of a single scene between two walls at rest: a list of `Orbit`.

    columns: of the coarsest cells, from wall to wall.
    """
    cells, half = cover(scene, columns)
    reach, result = reached(scene, cells, half), []
    for n in range(1, max_period + 1):
        last, walks = shrunk(scene, n, half, cells, reach)
        rings, errors = solved(scene, last[walks])
        rings = [ring for ring in distinct(rings[errors < EXACT]) if len(ring) == n]
        result += [Orbit(ring, multipliers(scene, ring)) for ring in rings]
    return result


def cover(scene, columns):
    """Cells over the velocities that two periods leave of any, and a tenth more at each end: middles and half-width."""
    left, right = float(scene.left.position), float(scene.right.position)
    half = 0.5 * (right - left) / columns
    points = product(np.linspace(left, right, 101), np.sinh(np.linspace(-7.0, 7.0, 1001)))
    speeds = strobed(scene, strobed(scene, points))[:, 1]
    low, high = speeds.min() - 0.1 * np.ptp(speeds), speeds.max() + 0.1 * np.ptp(speeds)
    return product(left + half * np.arange(1, 2 * columns, 2), np.arange(low, high + half, 2.0 * half)), half


def product(x, v):
    """All pairs of two lists of numbers, shape (pairs, 2)."""
    return np.stack(np.meshgrid(x, v, indexing="ij"), -1).reshape(-1, 2)


def split(cells, half, pieces):
    """The middles of pieces x pieces parts of each cell, shape (cells pieces^2, 2)."""
    inner = half / pieces * np.arange(1 - pieces, pieces, 2)
    return (cells[:, None] + product(inner, inner)).reshape(-1, 2)


def batched(function, size, points):
    """The function of x and v, called with a fixed number of points at a time."""
    padded = np.pad(points, ((0, -len(points) % size), (0, 0)), mode="edge")
    return np.concatenate([function(*part.T) for part in padded.reshape(-1, size, 2)])[: len(points)]


def strobed(scene, points):
    """x, v one period later, shape (points, 2)."""

    def run(x, v):
        state, _ = jv.strobe(scene, jv.State(x, v), 1, 0)
        return np.stack([state.x, state.v], -1)

    return batched(run, BATCH, points)


def derivative(scene, points):
    """The derivative of one period, shape (points, 2, 2); zero where there is none."""
    matrices = batched(lambda x, v: np.asarray(jv.monodromy(scene, jv.State(x, v))), FEW, points)
    return np.where(np.isfinite(matrices), matrices, 0.0)


def multipliers(scene, ring):
    """The multipliers of an orbit, the larger one first."""
    values = np.linalg.eigvals(np.linalg.multi_dot([np.eye(2), *derivative(scene, ring)[::-1], np.eye(2)]))
    return values[np.argsort(-(values.imag if np.iscomplexobj(values) else abs(values)))]


def reached(scene, cells, half):
    """Which cells the image of each may reach: for each piece a box along the principal axes of its nodes' images."""
    size, tree, pairs = len(cells), KDTree(cells), []
    parts, inner = split(cells, half, PIECES), half / PIECES
    for first in range(0, len(parts), BLOCK):
        nodes = (parts[first : first + BLOCK, None] + inner * product([-1, 0, 1], [-1, 0, 1])).reshape(-1, 2)
        nodes[:, 0] = np.clip(nodes[:, 0], float(scene.left.position), float(scene.right.position))
        images = strobed(scene, nodes).reshape(-1, 9, 2)
        middle = images.mean(1)
        spread = images - middle[:, None]
        _, axes = np.linalg.eigh(np.einsum("cki,ckj->cij", spread, spread))
        room = TRUST * abs(spread @ axes).max(1) + half * abs(axes).sum(1)
        near = tree.query_ball_point(middle, np.linalg.norm(room, axis=1))
        row, column = np.repeat(np.arange(len(near)), [len(some) for some in near]), np.concatenate(near).astype(int)
        hit = (abs(np.einsum("ci,cij->cj", cells[column] - middle[row], axes[row])) <= room[row]).all(-1)
        pairs.append(np.unique((first + row[hit]) // PIECES**2 * size + column[hit]))
    rows, columns = np.divmod(np.concatenate(pairs), size)
    return sparse.csr_array((np.ones(len(rows), np.float32), (rows, columns)), shape=(size, size))


def shrunk(scene, n, half, cells, reach):
    """Middles of the smallest cells with closed walks of n steps, and a walk from each (`walked`)."""
    while True:
        keep = closed(reach, n)
        cells, reach = cells[keep], reach[keep][:, keep]
        if half <= SMALLEST:
            return cells, walked(reach, n)
        cells, half = split(cells, half, 2), 0.5 * half
        reach = reached(scene, cells, half)


def closed(reach, n):
    """The cells from which n steps may lead back."""
    forward, backward, kept = reach.sign(), reach.T.tocsr().sign(), []
    for first in range(0, reach.shape[0], BLOCK):
        forth = back = sparse.eye_array(reach.shape[0], dtype=np.float32, format="csr")[first : first + BLOCK]
        for _ in range(n // 2):
            forth = (forth @ forward).sign()
        for _ in range(n - n // 2):
            back = (back @ backward).sign()
        kept.append(first + np.flatnonzero(forth.multiply(back).sum(1)))
    return np.concatenate(kept)


def walked(reach, n):
    """For each cell a closed walk of n steps, as indices of cells, shape (cells, n)."""
    home = [sparse.eye_array(reach.shape[0], dtype=np.float32, format="csr")]  # whence k steps may lead where, reversed
    for _ in range(n):
        home.append((home[-1] @ reach.T.tocsr()).sign())
    walk = [np.arange(reach.shape[0])]
    for k in range(n - 1, 0, -1):
        walk.append(np.asarray(reach[walk[-1]].multiply(home[k]).argmax(1)).ravel())
    return np.stack(walk, -1)


def solved(scene, rings):
    """Newton's method for the points of whole orbits, shape (orbits, n, 2): (rings, largest error of each)."""
    n, left, right = rings.shape[1], float(scene.left.position), float(scene.right.position)

    def errors(rings):
        return strobed(scene, rings.reshape(-1, 2)).reshape(rings.shape) - np.roll(rings, -1, axis=-2)

    for _ in range(STEPS):
        slopes = derivative(scene, rings.reshape(-1, 2)).reshape(-1, n, 2, 2)
        system = np.zeros((len(rings), n, 2, n, 2))
        for k in range(n):
            system[:, k, :, k] += slopes[:, k]
            system[:, k, :, (k + 1) % n] -= np.eye(2)
        change = -np.linalg.solve(system.reshape(-1, 2 * n, 2 * n), errors(rings).reshape(-1, 2 * n, 1))
        trials = rings + FRACTIONS[:, None, None, None] * change.reshape(rings.shape)
        trials[..., 0] = np.clip(trials[..., 0], left, right)
        rings = trials[abs(errors(trials)).max((2, 3)).argmin(0), np.arange(len(rings))]
    return rings, abs(errors(rings)).max((1, 2))


def distinct(rings):
    """Different orbits, each as the points of the least number of periods."""
    orbits = []
    for ring in rings:
        n = len(ring)
        least = next(m for m in range(1, n + 1) if n % m == 0 and abs(np.roll(ring, -m, axis=0) - ring).max() < APART)
        if not any(len(other) == least and abs(other - ring[0]).max(1).min() < APART for other in orbits):
            orbits.append(ring[:least])
    return orbits
