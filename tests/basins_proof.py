"""The numbers behind basins and manifolds at figure 5 of the paper: `python -m tests.basins_proof [cells a side]`."""

import sys
import time

import jax
import numpy as np
from scipy.spatial import cKDTree

import jaxvibro as jv

SCENE = {"amplitude": 4.65, "frequency": 2.1, "damping": 0.05, "restitution": 0.7, "walls": (-1.0, 1.0)}
DEEP, LONG = 200, 3000  # starts, periods
BENT, NEAR, ENOUGH = 0.02, 100, 1e-12  # of a chord; chords at most; so near is on the curve
MARGIN = 10  # cells around a deep start, all of its label


def grid(count):
    return np.linspace(-1.0, 1.0, count), np.linspace(-3.0, 3.0, count)


def timed(function):
    start = time.perf_counter()
    found = function()
    return found, time.perf_counter() - start


def deep_starts(label, rng):
    """Rows and columns of starts whose neighbourhood has one label."""
    size = 2 * MARGIN + 1
    windows = np.lib.stride_tricks.sliding_window_view(label, (size, size))[:: MARGIN // 2, :: MARGIN // 2]
    rows, columns = np.nonzero(windows.min(axis=(2, 3)) == windows.max(axis=(2, 3)))
    chosen = rng.choice(len(rows), min(DEEP, len(rows)), replace=False)
    return rows[chosen] * (MARGIN // 2) + MARGIN, columns[chosen] * (MARGIN // 2) + MARGIN


def alone(scene, data, x, v, phase=0.0):
    """(place of the nearest attractor, distance) of states run on for LONG periods in one call."""
    end, _ = jv.strobe(scene, jv.State(x, v, phase), LONG, 0)
    points = np.stack([data["point_x"].values, data["point_v"].values], -1)
    apart = abs(np.stack([end.x, end.v], -1)[:, None, None] - points).max(axis=-1).min(axis=-1)
    return apart.argmin(axis=1), apart.min(axis=1)


def edge(label):
    """Cells with a neighbour of another label, across, up or down."""
    found = np.zeros(label.shape, bool)
    for one, other in (
        ((slice(1, None),), (slice(None, -1),)),
        ((slice(None), slice(1, None)), (slice(None), slice(-1))),
    ):
        differ = label[one] != label[other]
        found[one] |= differ
        found[other] |= differ
    return found


def filled(curve, step):
    """The points of a manifold and more between them, (points, 2), no further apart than a step."""
    z = np.stack([curve["x"].values, curve["v"].values], -1)
    piece = curve["piece"].values
    apart = np.where(np.diff(piece) == 0, np.hypot(*np.diff(z, axis=0).T), 0.0)
    parts = np.maximum(1, np.ceil(apart / step).astype(int))
    share = np.concatenate([np.arange(n) / n for n in parts])
    first = np.repeat(np.arange(len(parts)), parts)
    more = z[first] + share[:, None] * (z[first + 1] - z[first])
    return np.concatenate([more, z])


def distance(curve, points):
    """How far points (lanes, 2) are from a manifold, as cubics through four of its points in a row, of one piece.

    Sheets lie close: the nearest of the curve's points is often on another one. So its chords are asked, those first
    that may be nearest, as a cubic is off its chord by BENT of its length at most.
    """
    z, piece = np.stack([curve["x"].values, curve["v"].values], -1), curve["piece"].values
    new = np.append(True, (np.diff(piece) != 0) | np.diff(z, axis=0).any(axis=1))
    z, piece = z[new], piece[new]
    chords = np.flatnonzero(np.diff(piece) == 0)
    start, way = z[chords], np.diff(z, axis=0)[chords]
    size = np.hypot(*way.T)
    found = cKDTree(z).query(points)[0]
    for lane, point in enumerate(points):
        share = np.clip(((point - start) * way).sum(axis=1) / size**2, 0.0, 1.0)
        least = np.hypot(*(start + share[:, None] * way - point).T) - BENT * size
        for near in np.argsort(least)[:NEAR]:
            if found[lane] <= max(least[near], ENOUGH):
                break
            place = chords[near]
            low, high = np.searchsorted(piece, [piece[place], piece[place] + 1])
            count = min(4, high - low)
            for first in range(max(low, place - 2), min(place, high - count) + 1):
                some = z[first : first + count]
                knots = np.append(0.0, np.cumsum(np.hypot(*np.diff(some, axis=0).T)))
                cubic = np.polyfit(knots / knots[-1], some - point, count - 1)
                found[lane] = min(found[lane], _least(cubic))
    return found


def _least(cubic):
    """The least size of a cubic (4, 2) between its ends."""
    square = np.polyadd(np.polymul(cubic[:, 0], cubic[:, 0]), np.polymul(cubic[:, 1], cubic[:, 1]))
    roots = np.roots(np.polyder(square))
    places = np.append(np.clip(roots[abs(roots.imag) < 1e-6].real, 0.0, 1.0), [0.0, 1.0])
    return np.hypot(np.polyval(cubic[:, 0], places), np.polyval(cubic[:, 1], places)).min()


def bisected(scene, attractors, first, second, phase=0.0):
    """The point of the line between two starts of different labels where the label changes, to 1e-12 of the line.

    Newton-independent, and of `manifold` too: only where states end is asked.
    """
    first, second = np.array(first), np.array(second)
    points = np.array([one.points[0] for one in attractors])

    def ends(shares):
        z = first + shares[:, None] * (second - first)
        end, _ = jv.strobe(scene, jv.State(*z.T, phase), 200, 0)
        apart = abs(np.stack([end.x, end.v], -1)[:, None] - points).max(axis=-1)
        return apart.argmin(axis=1)

    low, high = 0.0, 1.0
    while high - low > 1e-12:
        shares = np.linspace(low, high, 64)
        found = ends(shares)
        place = np.flatnonzero(found != found[0])[0]
        low, high = shares[place - 1], shares[place]
    return first + 0.5 * (low + high) * (second - first)


def followed(scene, saddles, point, periods=20):
    """(label of the saddle that a state comes nearest to, how near)."""
    state, best = jv.State(*point), ("", np.inf)
    for _ in range(periods):
        state, _ = jv.strobe(scene, state, 1, 0)
        for one in saddles:
            apart = float(np.hypot(state.x - one.state.x, state.v - one.state.v))
            best = min(best, (one.label, apart), key=lambda each: each[1])
    return best


def crossings(label, x, v, rng, count):
    """Pairs of neighbouring starts of different labels, as (start, start)."""
    rows, columns = np.nonzero((label[:-1] != label[1:]) & (label[:-1] >= 0) & (label[1:] >= 0))
    return [((x[j], v[i]), (x[j], v[i + 1])) for i, j in np.stack([rows, columns], -1)[rng.choice(len(rows), count)]]


def along(scene, curve, count, rng):
    """(how far images of a manifold's points are from it, at worst; how many): one map towards the saddle."""
    from_here = np.flatnonzero((curve["image"].values > 0) & (abs(curve["v"].values) < 4.0))
    some = rng.choice(from_here, min(count, len(from_here)), replace=False)
    z = np.stack([curve["x"].values, curve["v"].values], -1)[some]
    end, _ = jv.strobe(scene, jv.State(*z.T, curve.attrs["phase"]), 1, 0)
    return distance(curve, np.stack([end.x, end.v], -1))


def main(count=1001):
    jax.config.update("jax_enable_x64", True)
    rng, scene = np.random.default_rng(0), jv.make_scene(**SCENE)
    attractors = jv.find_attractors(scene)
    x, v = grid(count)
    jv.basins(scene, x[:3], v[:3], 0.0, attractors)
    data, seconds = timed(lambda: jv.basins(scene, x, v, 0.0, attractors))
    label = data["label"].values
    print(f"{count} x {count} starts: {seconds:.1f} s; unresolved {(label < 0).sum()}")
    for place, one in enumerate(attractors):
        share, error = (float(data[name][place]) for name in ("fraction", "fraction_error"))
        print(f"  {one.label} mirror of {one.mirror_of}: {share:.5f} +- {error:.5f}")
    print("  " + ", ".join(f"{key} {data.attrs[key]:.4f}" for key in list(data.attrs) if key.split("_")[0] in told))
    for name, (rows, columns) in {
        "deep": deep_starts(label, rng),
        "any": rng.integers(0, count, (2, DEEP)),
    }.items():
        place, apart = alone(scene, data, x[columns], v[rows])
        wrong = (place != label[rows, columns]).sum()
        print(f"{len(rows)} {name} starts run on alone: {wrong} wrong, {apart.max():.1e} from their attractor at most")
    turned = jv.basins(scene, x, v, np.pi, attractors)["label"].values[::-1, ::-1]
    print(f"mirrored grid at phase pi: {(turned != data['mirror_of'].values[label]).mean():.1e} of the cells differ")
    saddles = [one for one in jv.find_orbits(scene, 1) if not one.stable]
    curves = []
    for saddle in saddles:
        curve, seconds = timed(lambda saddle=saddle: jv.manifold(saddle, "stable", 60.0, 0.0, 0.0025, 0.01, 30.0))
        apart = along(scene, curve, 400, rng)
        print(f"stable manifold of {saddle.label}: {curve.sizes['point']} points, {seconds:.1f} s; ends", end=" ")
        print({str(why): int((curve["ended"] == why).sum()) for why in np.unique(curve["ended"])})
        print(f"  images on it: 99 % within {np.quantile(apart, 0.99):.1e}, all within {apart.max():.1e}")
        curves.append(curve)
    bound = edge(label)
    cell = np.array([x[1] - x[0], v[1] - v[0]])
    tree = cKDTree(np.concatenate([filled(curve, 0.001) for curve in curves]) / cell)
    rows, columns = np.nonzero(bound)
    apart = tree.query(np.stack([x[columns], v[rows]], -1) / cell, p=np.inf)[0]
    print(f"{bound.sum()} boundary cells: {(apart > 1.0).sum()} further than a cell, {apart.max():.2f} at most")
    for i, j in zip(rows[apart > 1.0][:8], columns[apart > 1.0][:8], strict=True):
        across = next((a, b) for a, b in ((i - 1, j), (i + 1, j), (i, j - 1), (i, j + 1)) if label[a, b] != label[i, j])
        point = bisected(scene, attractors, (x[j], v[i]), (x[across[1]], v[across[0]]))
        name, least = followed(scene, saddles, point)
        print(f"  at {point[0]:.3f} {point[1]:.6f}, by bisection: comes to within {least:.0e} of the saddle {name}")
    for first, second in crossings(label, x, v, rng, 5):
        point = bisected(scene, attractors, first, second)
        least = min(distance(curve, point[None])[0] for curve in curves)
        print(f"boundary at {point[0]:+.6f} {point[1]:+.6f} by bisection: {least:.1e} from a stable manifold")


told = ("basin", "boundary")

if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
