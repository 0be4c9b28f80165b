"""All periodic orbits of a scene, stable or not, by brute force: cells on a section and the closed walks among them.

It takes `strobe` and `monodromy` from the package and nothing else: no trajectory is waited for to recur, no start is
random. Cells cover the section between the walls. Nodes tell where the image of a cell may reach, and it is widened; a
cell through which no walk of n cells closes holds no point of an orbit of n periods. The others are split in four, and
so on. A walk's errors are those of single periods, so neither the growth over n periods nor the square root of a graze
blows up the number of cells: it stays about the same while they shrink. In the end Newton's method starts from a walk
through each cell, the points of all periods unknown. The map jumps where a period ends with an impact: walks that lead
along a wall need have no orbit.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse
from scipy.spatial import KDTree

import jaxvibro as jv

BATCH, FEW = 1 << 13, 1 << 9  # states given to strobe and to monodromy, which are compiled for each number anew
BLOCK = 2000  # pieces or cells looked at together, as memory allows
TRUST = 2.0  # how much farther an image may reach than those of the nodes
SMALLEST = 1e-6  # half-width of a cell that is not split
NEAR = 100.0  # half-widths: farther from its orbit no cell is
STEPS = 30  # of Newton's method, each the best of some fractions
FRACTIONS = 0.5 ** np.arange(8)
EXACT = 1e-11  # error of an orbit's points, each against the strobe of the one before
APART = 1e-8  # distance of different points
LETTERS = {-1: "L", 0: "", 1: "R"}


@dataclass(frozen=True)
class Orbit:
    """A periodic orbit.

    itinerary: a word of L and R for each period of the least number of them; points: x, v on the section, one a period;
    multipliers: of strobe^period, the larger one first; residual: the largest error of a point; least_speed,
    least_clearance: as `Impacts` has them; hits: speeds of the impacts in order, negative on the left; twin: the place
    of the mirror image, its own where the orbit is symmetric, None where there is none.
    """

    itinerary: tuple[str, ...]
    points: np.ndarray
    multipliers: np.ndarray
    residual: float
    least_speed: float
    least_clearance: float
    hits: np.ndarray
    twin: int | None = None

    def index(self, n):
        """The sign of det(1 - M) over n periods; over all fixed points of strobe^n it sums to 1 (Lefschetz)."""
        return int(np.sign(np.prod(1.0 - self.multipliers ** (n // len(self.points))).real))


def orbits(scene, max_period, columns=100, pieces=4, phase=0.0, told=print):
    """All orbits of minimal period up to max_period in a single scene with two resting walls: a list of `Orbit`.

    columns: of the coarsest cells, from wall to wall; pieces: into how many each way a cell is cut to find its image;
    phase: of the section; told: called with a line for each period.
    """
    cells, half = cover(scene, columns, phase)
    reach, found = reached(scene, cells, half, pieces, phase), []
    for n in range(1, max_period + 1):
        least, last, walks = shrunk(scene, n, (half, cells, reach), pieces, phase)
        rings, errors = solved(scene, last[walks], phase)
        rings = distinct(rings[errors < EXACT])
        found += [orbit(scene, ring, phase) for ring in rings if len(ring) == n]
        fixed = [one for one in found if n % len(one.points) == 0]
        alone = KDTree(np.concatenate([one.points for one in fixed])).query(last)[0] > NEAR * least
        jumps = (beside(scene, last) < NEAR * least)[walks].any(1)
        told(
            f"period {n}: {sum(len(one.points) == n for one in fixed)} orbits; the indices of all fixed points sum to "
            f"{sum(len(one.points) * one.index(n) for one in fixed)}; {len(last)} cells, {sum(alone & jumps)} off any "
            f"orbit at jumps and {sum(alone & ~jumps)} elsewhere"
        )
    return paired(found)


def cover(scene, columns, phase):
    """Cells over the velocities that two periods leave of any, and a tenth more at each end: middles and half-width."""
    left, right = float(scene.left.position), float(scene.right.position)
    half = 0.5 * (right - left) / columns
    points = product(np.linspace(left, right, 101), np.sinh(np.linspace(-7.0, 7.0, 1001)))
    speeds = strobed(scene, strobed(scene, points, phase), phase)[:, 1]
    low, high = speeds.min() - 0.1 * np.ptp(speeds), speeds.max() + 0.1 * np.ptp(speeds)
    return product(left + half * np.arange(1, 2 * columns, 2), np.arange(low, high + half, 2.0 * half)), half


def product(x, v):
    """All pairs of two lists of numbers, shape (pairs, 2)."""
    return np.stack(np.meshgrid(x, v, indexing="ij"), -1).reshape(-1, 2)


def split(cells, half, pieces):
    """The middles of pieces x pieces parts of each cell, shape (cells pieces^2, 2)."""
    inner = half / pieces * np.arange(1 - pieces, pieces, 2)
    return (cells[:, None] + product(inner, inner)).reshape(-1, 2)


def beside(scene, points):
    """The distances to the nearer wall."""
    return np.minimum(points[:, 0] - float(scene.left.position), float(scene.right.position) - points[:, 0])


def batched(function, size, points):
    """The function of x and v, called with a fixed number of points at a time."""
    padded = np.pad(points, ((0, -len(points) % size), (0, 0)), mode="edge")
    return np.concatenate([function(*part.T) for part in padded.reshape(-1, size, 2)])[: len(points)]


def strobed(scene, points, phase):
    """x, v one period later, shape (points, 2)."""

    def run(x, v):
        state, _ = jv.strobe(scene, jv.State(x, v, phase), 1, 0)
        return np.stack([state.x, state.v], -1)

    return batched(run, BATCH, points)


def derivative(scene, points, phase):
    """The derivative of one period, shape (points, 2, 2); zero where there is none."""
    found = batched(lambda x, v: np.asarray(jv.monodromy(scene, jv.State(x, v, phase))), FEW, points)
    return np.where(np.isfinite(found), found, 0.0)


def reached(scene, cells, half, pieces, phase):
    """Which cells the image of each may reach: for each piece a box along the principal axes of its nodes' images."""
    size, tree, pairs = len(cells), KDTree(cells), []
    parts, inner = split(cells, half, pieces), half / pieces
    for first in range(0, len(parts), BLOCK):
        nodes = (parts[first : first + BLOCK, None] + inner * product([-1, 0, 1], [-1, 0, 1])).reshape(-1, 2)
        nodes[:, 0] = np.clip(nodes[:, 0], float(scene.left.position), float(scene.right.position))
        images = strobed(scene, nodes, phase).reshape(-1, 9, 2)
        middle = images.mean(1)
        spread = images - middle[:, None]
        _, axes = np.linalg.eigh(np.einsum("cki,ckj->cij", spread, spread))
        room = TRUST * abs(spread @ axes).max(1) + half * abs(axes).sum(1)
        near = tree.query_ball_point(middle, np.linalg.norm(room, axis=1))
        row, column = np.repeat(np.arange(len(near)), [len(one) for one in near]), np.concatenate(near).astype(int)
        hit = (abs(np.einsum("ci,cij->cj", cells[column] - middle[row], axes[row])) <= room[row]).all(-1)
        pairs.append(np.unique((first + row[hit]) // pieces**2 * size + column[hit]))
    rows, columns = np.divmod(np.concatenate(pairs), size)
    return sparse.csr_array((np.ones(len(rows), np.float32), (rows, columns)), shape=(size, size))


def shrunk(scene, n, level, pieces, phase):
    """Half-width and middles of the smallest cells with closed walks of n steps, and a walk from each (`walked`)."""
    half, cells, reach = level
    while True:
        keep = closed(reach, n)
        cells, reach = cells[keep], reach[keep][:, keep]
        if half <= SMALLEST:
            return half, cells, walked(reach, n)
        cells, half = split(cells, half, 2), 0.5 * half
        reach = reached(scene, cells, half, pieces, phase)


def closed(reach, n):
    """The cells from which n steps may lead back."""
    there, home, kept = reach.sign(), reach.T.tocsr().sign(), []
    for first in range(0, reach.shape[0], BLOCK):
        forth = back = sparse.eye_array(reach.shape[0], dtype=np.float32, format="csr")[first : first + BLOCK]
        for _ in range(n // 2):
            forth = (forth @ there).sign()
        for _ in range(n - n // 2):
            back = (back @ home).sign()
        kept.append(first + np.flatnonzero(forth.multiply(back).sum(1)))
    return np.concatenate(kept)


def walked(reach, n):
    """For each cell a closed walk of n steps, as places among the cells, shape (cells, n)."""
    home = [sparse.eye_array(reach.shape[0], dtype=np.float32, format="csr")]  # whence k steps may lead where, reversed
    for _ in range(n):
        home.append((home[-1] @ reach.T.tocsr()).sign())
    walk = [np.arange(reach.shape[0])]
    for k in range(n - 1, 0, -1):
        walk.append(np.asarray(reach[walk[-1]].multiply(home[k]).argmax(1)).ravel())
    return np.stack(walk, -1)


def solved(scene, rings, phase):
    """Newton's method for the points of whole orbits, shape (orbits, n, 2): (rings, largest error of each)."""
    n, left, right = rings.shape[1], float(scene.left.position), float(scene.right.position)

    def errors(rings):
        return strobed(scene, rings.reshape(-1, 2), phase).reshape(rings.shape) - np.roll(rings, -1, axis=-2)

    for _ in range(STEPS):
        slopes = derivative(scene, rings.reshape(-1, 2), phase).reshape(-1, n, 2, 2)
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
    found = []
    for ring in rings:
        n = len(ring)
        least = next(m for m in range(1, n + 1) if n % m == 0 and abs(np.roll(ring, -m, axis=0) - ring).max() < APART)
        if not any(len(one) == least and abs(one - ring[0]).max(1).min() < APART for one in found):
            found.append(ring[:least])
    return found


def orbit(scene, ring, phase):
    """What there is to know about an orbit, from its points."""
    end, impacts = jv.strobe(scene, jv.State(*ring.T, phase), slots=32, clearance=True)
    words = ["".join(LETTERS[one] for one in row) for row in impacts.side.tolist()]
    turn = min(range(len(ring)), key=lambda k: (words[k:] + words[:k], *ring[k]))
    signed = np.roll(np.asarray(impacts.side * impacts.speed), -turn, axis=0)
    slopes = derivative(scene, ring, phase)
    trace, area = np.trace(np.linalg.multi_dot([np.eye(2), *slopes[::-1], np.eye(2)])), np.prod(np.linalg.det(slopes))
    root = np.emath.sqrt(trace**2 - 4.0 * area)
    large = 0.5 * (trace + (root if trace >= 0 else -root))
    return Orbit(
        itinerary=tuple(words[turn:] + words[:turn]),
        points=np.roll(ring, -turn, axis=0),
        multipliers=np.array([large, area / large if large else 0.0]),
        residual=float(abs(np.stack([end.x, end.v], -1) - np.roll(ring, -1, axis=0)).max()),
        least_speed=float(impacts.least_speed.min()),
        least_clearance=float(impacts.least_clearance.min()),
        hits=signed[signed != 0],
    )


def paired(found):
    """The orbits with the places of their mirror images: the same impacts in order, on the other walls."""

    def alike(one, other):
        turns, sizes = range(max(1, len(one.hits))), [(len(each.points), len(each.hits)) for each in (one, other)]
        return sizes[0] == sizes[1] and any(np.allclose(np.roll(one.hits, k), -other.hits, atol=1e-6) for k in turns)

    return [replace(one, twin=next((k for k, two in enumerate(found) if alike(one, two)), None)) for one in found]
