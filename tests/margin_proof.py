"""Nearest bifurcations of random designs: `python -m tests.margin_proof loci N`, `... rays N`, `... force N`.

loci: in two numbers, against the curves of special points that are traced in them. rays: in three to five numbers,
against where the orbit ends along 500 other ways, and Newton's method from other ends of ways. force: as loci, in the
amplitude and the cubic term of Duffing oscillators between two walls that both are hit once a period.
"""

import sys

import jax
import numpy as np

import jaxvibro as jv
from tests.branch_proof import scene_of
from tests.force_specials import duffing

NAMES = ("amplitude", "frequency", "damping", "right.position", "restitution")
UNITS = {"amplitude": 0.5, "frequency": 0.2, "damping": 0.1, "right.position": 0.2, "restitution": 0.2}
UNITS |= {"force.cubic": 0.5}
FIT = 2  # points on either side of the nearest, through which a polynomial is laid


def designs(rng, sizes):
    """(orbit, {name: unit}) of random scenes that settle on an orbit that can be followed."""
    while True:
        scene = scene_of(rng)
        try:
            orbit = jv.find_orbit(scene, jv.State(float(scene.right.position) - 0.1, 0.0))
        except (jv.OrbitError, jv.ArgumentError):
            continue
        if orbit.periods > 3 or orbit.impacts.count > 6 or orbit.unknowns == "state":
            continue
        names = [name for name in NAMES if name in scene.names]
        names = rng.choice(names, rng.choice(sizes), replace=False)
        yield orbit, {str(name): UNITS[name] for name in names}


def duffings(rng):
    """The same of Duffing oscillators; what is compiled is the same for all."""
    while True:
        walls = (-rng.uniform(0.8, 1.2), rng.uniform(0.8, 1.2))
        ends = {"amplitude": (2.0, 4.5), "cubic": (0.2, 1.0), "damping": (0.03, 0.15), "frequency": (1.8, 2.6)}
        scene = duffing(walls, restitution=0.7, **{name: rng.uniform(*each) for name, each in ends.items()})
        try:
            orbit = jv.find_orbit(scene, jv.State(walls[1] - 0.1, 0.0))
        except (jv.OrbitError, jv.ArgumentError):
            continue
        if orbit.label == "P111":
            yield orbit, {name: UNITS[name] for name in ("amplitude", "force.cubic")}


def nearest_on(locus, orbit, free):
    """The least distance, in units, of the points of a locus: of a polynomial through the nearest, of degree 4."""
    offsets = np.stack(
        [(locus.data[name].values - float(orbit.scene.parameter(name))) / unit for name, unit in free.items()], 1
    )
    squares = (offsets**2).sum(axis=1)
    place = int(np.argmin(squares))
    if not FIT <= place < len(squares) - FIT:
        return None
    some = slice(place - FIT, place + FIT + 1)
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(offsets[some], axis=0), axis=1))])
    length -= length[FIT]
    scale = length[-1]
    paths = np.stack([np.polyfit(length / scale, each, 2 * FIT) for each in offsets[some].T])
    square = sum(np.polymul(path, path) for path in paths)
    ends = np.roots(np.polyder(square))
    real = ends[abs(ends.imag) < 1e-9].real
    return min(np.sqrt(np.polyval(square, each)) for each in real if abs(each) <= 1.0)


def by_loci(orbit, near, free):
    """|distance - that to the locus through the nearest point|; nan where that cannot be traced, or ends there."""
    point = near.points[0]
    names = tuple(free)
    start = special_at(orbit, point, names[0])
    if start is None:
        return np.nan
    there = {name: float(point.scene.parameter(name)) for name in names}
    bounds = {name: (value - 0.3 * free[name], value + 0.3 * free[name]) for name, value in there.items()}
    locus = jv.locus(start, names, bounds, 0.002, 0.004)
    found = nearest_on(locus, orbit, free)
    return np.nan if found is None else abs(found - near.points[0].distance)


def special_at(orbit, point, name):
    """The special point of a branch along a parameter that lies at a near point; the orbit is found anew again and
    again on the straight way there, and followed from just before it. None where there is none."""
    here = orbit
    for share in np.linspace(0.0999, 0.999, 10):
        values = {key: float(orbit.scene.parameter(key)) + share * change for key, change in point.change.items()}
        here = jv.find_orbit(orbit.scene.replace(**values), here.state, here.periods, settle=0)
    value, begun = float(point.scene.parameter(name)), float(here.scene.parameter(name))
    low, high = min(begun, value) - 0.05 * UNITS[name], max(begun, value) + 0.05 * UNITS[name]
    branch = jv.follow(here, name, (low, high), "both", 1e-3, 1e-2)
    found = [one for one in branch.special if one.kind == point.kind]
    return min(found, key=lambda one: abs(one.value - value), default=None)


def main(what, count, seed=0):
    """Print what was found, the worst last."""
    jax.config.update("jax_enable_x64", True)
    rng, worst, left, kinds = np.random.default_rng(seed), 0.0, 0, {}
    found = 0
    for orbit, free in duffings(rng) if what == "force" else designs(rng, (2,) if what == "loci" else (3, 4, 5)):
        near = jv.margin(orbit, free)
        if not near.points or near.points[0].at_bound:
            continue
        found += 1
        kinds[near.points[0].kind] = kinds.get(near.points[0].kind, 0) + 1
        if what != "rays":
            try:
                error = by_loci(orbit, near, free)
            except (jv.OrbitError, jv.ArgumentError, ArithmeticError) as problem:
                print("  not traced:", str(problem)[:100])
                error = np.nan
        else:
            other = jv.margin(orbit, free, directions=510, seed=seed + found)
            error = max(0.0, near.distance - other.distance)
        told = " ".join(f"{one.kind} {one.distance:.4f}" for one in near.points)
        print(found, orbit.label, tuple(free), told, f"error {error:.1e}", flush=True)
        if np.isnan(error):
            left += 1
        else:
            worst = max(worst, error)
        if found == count:
            break
    print(f"{what}: {count} designs, {kinds}, {left} left out, largest error {worst:.3g}")


if __name__ == "__main__":
    main(sys.argv[1], *map(int, sys.argv[2:]))
