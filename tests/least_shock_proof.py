"""`least_shock` against very many other shocks: `python -m tests.least_shock_proof COUNT SHOCKS [FIRST]`.

COUNT attractors of scenes with several: some at amplitudes of figure 4, most random. Of each, SHOCKS random shocks
below the size found: does one leave? Half of them are even over the disc, half over its radius; of a chaotic attractor
they strike states of a run of its own. The least one found, one 1 % larger and one just below are run on alone as well,
by `strobe`, without the traps that basins are told by; where the one 1 % larger does not leave, SHOCKS others of just
that size are tried. By turns dv alone and both.
"""

import sys
import time
from itertools import count as numbers

import jax
import numpy as np

import jaxvibro as jv
from jaxvibro.attractors.basin_labels import build_neighbourhoods as homes_of
from jaxvibro.attractors.basin_labels import label_starts_in_parallel
from jaxvibro.maps.initial_conditions import initial_box
from tests.attractors_proof import KINDS, drawn
from tests.force_specials import duffing

FIGURE_4 = {"frequency": 2.1, "damping": 0.05, "restitution": 0.7, "walls": (-1.0, 1.0)}
PHASES = (0.0, 1.0, 2.5, 4.0)
LONG, NEAR = 3000, 1e-6  # drive periods of a motion alone; so near it is on an orbit
MOST = 3  # attractors of a scene, its rarest ones first
HAIR = 1e-4  # of the size: smaller than that by more counts


def scenes(first):
    """(name, scene): of 16 one at figure 4's amplitudes, one of Duffing's, the others random, half less damped."""
    for place in numbers(first):
        rng, kind = np.random.default_rng((4, place)), KINDS[place % len(KINDS)]
        if place % 16 == 0:
            amplitude = rng.uniform(1.0, 6.0)
            yield f"figure 4 at {amplitude:.3f}", jv.make_scene(amplitude, **FIGURE_4)
        elif place % 16 == 8:
            amplitude = rng.uniform(2.0, 6.0)
            yield f"Duffing at {amplitude:.3f}", duffing(amplitude=amplitude)
        else:
            scene = drawn(kind, place)
            scene = scene.replace(damping=10 ** rng.uniform(-2.5, -1.0)) if place % 2 else scene
            yield f"{kind} {place}", scene


def tried(scene, attractors, place, phase, plane, size, shocks, rng, just=False):
    """(sizes, labels) of random shocks below a size, or of just this one."""
    left, right, fast = (float(edge) for edge in initial_box(scene))
    homes = homes_of(scene, attractors, phase, max(abs(left), abs(right), fast))
    points = homes[place].points
    if attractors[place].kind == "chaotic":  # other states of it than those that were searched
        some = attractors[place].points[rng.integers(len(attractors[place].points), size=64)]
        run = jv.sections(scene, jv.State(float(some[0, 0]), float(some[0, 1])), phase, 4000)
        points = np.stack([run["x"].values, run["v"].values], -1)[100:]
    start = points[rng.integers(len(points), size=shocks)]
    share = rng.random(shocks)
    share[::2] **= 0.5
    share = np.ones(shocks) if just else share
    turn = 2.0 * np.pi * rng.random(shocks)
    way = np.stack([np.cos(turn), np.sin(turn)], -1) if plane else np.stack([0.0 * turn, np.sign(turn - np.pi)], -1)
    z = start + size * share[:, None] * way
    label, _ = label_starts_in_parallel(scene, *z.T, phase, homes, 2000)
    return size * share, label


def some_way(scene, attractors, place, phase, plane, size, shocks, rng):
    """Whether one of many shocks of just this size leaves."""
    _, label = tried(scene, attractors, place, phase, plane, size, shocks, rng, just=True)
    return bool(((label >= 0) & (label != place)).any())


def alone(scene, attractors, z, phase):
    """Places of the attractors that states (lanes, 2) end on, run on alone; -1 where on no orbit."""
    end, _ = jv.strobe(scene, jv.State(*z.T, phase), LONG, 0)
    found = np.full(len(z), -1)
    for place, one in enumerate(attractors):
        if one.kind == "periodic":
            given = jv.State(one.state.x, one.state.v, 0.0, one.state.contact)
            run = jv.sections(scene, given, phase, one.periods)
            points = np.stack([run["x"].values, run["v"].values], -1)
            apart = abs(np.stack([end.x, end.v], -1)[:, None] - points).max(axis=-1).min(axis=1)
            found[apart < NEAR * (1.0 + abs(points).max())] = place
    return found


def judged(name, scene, attractors, place, phase, direction, shocks, seed):
    """What came of one attractor: a line, and the counts."""
    began = time.perf_counter()
    found = jv.least_shock(scene, attractors, place, phase, direction)
    spent = time.perf_counter() - began
    rng, size = np.random.default_rng(seed), min(found.size, found.reach)
    sizes, label = tried(scene, attractors, place, phase, direction == "xv", size, shocks, rng)
    leaving = sizes[(label >= 0) & (label != place)]
    least = leaving.min(initial=np.inf) / size
    counts = {"attractors": 1, "none leaves": int(not np.isfinite(found.size)), "smaller": int(least < 1.0 - HAIR)}
    counts |= {"undecided": int((label == -1).sum()), "by a hundredth": int(least < 0.99)}
    told = ""
    if np.isfinite(found.size):
        before, change = np.array([found.state.x, found.state.v]), np.array([found.dx, found.dv])
        ratios = np.array([1.0, 1.01, found.bracket[0] / size])
        ends = alone(scene, attractors, before + ratios[:, None] * change, phase)
        known = attractors[found.to].kind == "periodic"
        counts["leaves alone"] = int(ends[0] == found.to or not known)
        counts["1 % more leaves"] = int(found.until >= 1.01 * size)
        given = scene, attractors, place, phase, direction == "xv", 1.01 * size, shocks, rng
        counts["1 % more leaves some way"] = int(counts["1 % more leaves"] or some_way(*given))
        counts["1 % more leaves alone"] = int(ends[1] not in (place, -1) or not known)
        stays = ends[2] == (place if attractors[place].kind == "periodic" else -1)
        counts["just below stays alone"] = int(stays)
        told = f"to {attractors[found.to].label}, alone {ends.tolist()}, until {found.until / size:.4f}"
        told += f", 1 % more leaves some way: {bool(counts['1 % more leaves some way'])}"
    print(
        f"{name}, phase {phase}: {attractors[place].label}, {direction}: {found.size:.9g} in {spent:.1f} s,"
        f" safe {found.safe / size:.3f}, {found.below} smaller tried, {found.undecided} undecided {told};"
        f" of {len(sizes)} others the least that leaves {least:.6f}, undecided {counts['undecided']}",
        flush=True,
    )
    return counts, spent


def main(count=50, shocks=100_000, first=0):
    jax.config.update("jax_enable_x64", True)
    total, times = {}, []
    for place, (name, scene) in zip(numbers(first), scenes(first), strict=False):
        attractors = jv.find_attractors(scene)
        known = [k for k, one in enumerate(attractors) if one.kind != "unresolved"]
        if len(known) < 2:
            continue
        for k in known[::-1][:MOST]:
            phase, direction = PHASES[len(times) % len(PHASES)], ("v", "xv")[len(times) // 2 % 2]
            try:
                counts, spent = judged(name, scene, attractors, k, phase, direction, shocks, (place, k))
            except jv.ArgumentError as error:
                print(f"{name}, phase {phase}: {attractors[k].label}: {error}", flush=True)
                counts, spent = {"refused": 1}, np.nan
            times.append(spent)
            total = {key: total.get(key, 0) + counts.get(key, 0) for key in total | counts}
            if len(times) == count:
                print(total)
                print(f"seconds: median {np.nanmedian(times):.2f}, most {np.nanmax(times):.2f}")
                return


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
