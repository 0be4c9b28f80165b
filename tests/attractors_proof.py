"""What 200 starts miss: `python -m tests.attractors_proof COUNT FOLDER` for so many random scenes, then a summary.

For each scene `find_attractors` with its default starts is held against MANY starts from another seed: which attractors
are missed, how often that had to be, and whether the bounds of the shares hold those of the many. A free response that
attracts must always be there: whether it does is told from its closed form. FOLDER keeps a file a scene, so that an
interrupted proof goes on.
"""

import json
import sys
import time
from pathlib import Path

import jax
import numpy as np

import jaxvibro as jv
from jaxvibro.attractors.basin_fraction_bounds import compute_share_bounds
from jaxvibro.attractors.basin_labels import build_neighbourhoods, label_starts_in_parallel
from jaxvibro.attractors.classify_attractors import find_chaotic_attractors, find_periodic_attractors
from jaxvibro.attractors.transients import settle_lanes
from jaxvibro.maps.initial_conditions import draw_initial_states, initial_box
from jaxvibro.orbits.orbit_comparison import samples_fill_same_set
from jaxvibro.output.atomic_write import atomic_file
from jaxvibro.scene.codes import Status
from tests.test_tried import clearance

MANY, SEED = 4000, 17
KINDS = ("two", "two", "two", "one", "one", "moving", "moving", "soft")  # in turn
QUICK = 400  # drive periods after which a start that is in no trap is settled instead
NEAR = 1e-6  # of the largest x and v: points of one orbit


def drawn(kind, place):
    """A random scene, most of them with walls that the free response hits."""
    rng = np.random.default_rng((SEED, place))
    frequency, damping, amplitude = rng.uniform(0.3, 4.0), 10 ** rng.uniform(-2.0, 0.176), rng.uniform(0.2, 10.0)
    size = amplitude / np.hypot(1.0 - frequency**2, 2.0 * damping * frequency)
    centre, gaps = rng.uniform(-0.3, 0.3) * size, rng.uniform(0.05, 1.3, 2) * size

    def wall(position):
        if kind == "soft":
            return jv.Wall(position, stiffness=10 ** rng.uniform(0.5, 3.0), damping=rng.uniform(0.1, 2.0))
        swing = jv.Motion(rng.uniform(0.0, 0.3) * gaps.min(), rng.uniform(-np.pi, np.pi))
        return jv.Wall(position, rng.uniform(0.0, 0.95), motion=swing if kind == "moving" else None)

    left, right = wall(centre - gaps[0]), wall(centre + gaps[1])
    return jv.make_scene(amplitude, frequency, damping, 0.5, (None if kind == "one" else left, right))


def p100_attracts(scene):
    """Whether the free response keeps off the walls, from its closed form."""
    return all(clearance(scene, -1 if side == "left" else 1, wall) > 1e-9 for side, wall in scene.walls.items())


def is_same(numbers, one):
    """Whether an attractor's fields, as `classify` gives them, are those of an `Attractor`."""
    if numbers["kind"] != one.kind or numbers["periods"] != one.periods:
        return False
    points = numbers["points"]
    if one.kind == "chaotic":
        return samples_fill_same_set(points, one.points)
    near = NEAR * (1.0 + abs(points).max())
    return any(abs(np.roll(points, k, axis=0) - one.points).max() <= near for k in range(one.periods))


def counted(scene, known, seed):
    """(starts on each of the known attractors, [label, starts] of others, unresolved starts), of MANY other starts.

    Most are soon in a trap of `basins`; the rest are settled as `find_attractors` does.
    """
    given, (left, right, fast) = draw_initial_states(scene, MANY, seed), (float(edge) for edge in initial_box(scene))
    scale = max(abs(left), abs(right), fast)
    label, _ = label_starts_in_parallel(
        scene, given.x, given.v, 0.0, build_neighbourhoods(scene, known, 0.0, scale), QUICK
    )
    counts, others = [int((label == k).sum()) for k in range(len(known))], []
    rest = np.flatnonzero(label < 0)
    if not rest.size:
        return counts, others, 0
    state = jax.tree.map(lambda leaf: leaf[rest], given)
    found, periods, scale = settle_lanes(scene, state, 300, max(abs(left), abs(right)))
    orbits, _ = find_periodic_attractors(scene, found, periods, 300, scale)
    sets, _ = find_chaotic_attractors(scene, found, np.flatnonzero((periods == 0) & (found.status < Status.CAP)), scale)
    for one in orbits + sets:
        home = next((k for k, other in enumerate(known) if is_same(one.attractor_fields, other)), None)
        if home is None:
            others.append((one.attractor_fields["label"], len(one.lanes)))
        else:
            counts[home] += len(one.lanes)
    return counts, others, MANY - sum(counts) - sum(number for _, number in others)


def compared(place):
    """What came of one scene, as plain data."""
    kind = KINDS[place % len(KINDS)]
    scene, began = drawn(kind, place), time.perf_counter()
    few = jv.find_attractors(scene, seed=place)
    spent, known = time.perf_counter() - began, [one for one in few if one.kind != "unresolved"]
    counts, others, lost = counted(scene, known, 100_000 + place)
    listed = [(one.label, count, True, one.share, one.share_bounds) for one, count in zip(known, counts, strict=True)]
    listed += [(label, count, False, 0.0, compute_share_bounds(0, 200)) for label, count in others]
    names = ("label", "count", "found", "ours", "bounds")
    return {
        "place": place,
        "kind": kind,
        "rows": [dict(zip(names, row, strict=True)) | {"share": row[1] / MANY} for row in listed],
        "unresolved": [1.0 - sum(one.share for one in known), lost / MANY],
        "p100": [p100_attracts(scene), any(one.label == "P100" and not one.rests for one in few)],
        "seconds": [spent, time.perf_counter() - began - spent],
    }


def summary(results):
    """Prints what all scenes say together."""
    rows = [row for one in results for row in one["rows"]]
    for low, high in ((0.04, 1.01), (0.01, 0.04), (0.0, 0.01)):
        some = [row for row in rows if low < row["share"] <= high]
        missed, due = sum(not row["found"] for row in some), sum((1.0 - row["share"]) ** 200 for row in some)
        print(f"shares above {low} up to {high}: {len(some)} attractors, {missed} missed, {due:.1f} to be expected")
    held = [row["bounds"][0] <= row["share"] <= row["bounds"][1] for row in rows]
    print(f"bounds hold the share from {MANY} starts: {sum(held)} of {len(held)}, {100 * np.mean(held):.1f} %")
    stable = [one["p100"] for one in results if one["p100"][0]]
    print(f"P100 attracts in {len(stable)} scenes, missed in {sum(not listed for _, listed in stable)}")
    wrong = sum(listed and not attracts for attracts, listed in (one["p100"] for one in results))
    print(f"P100 listed where it does not attract: {wrong}")
    unresolved = np.array([one["unresolved"] for one in results])
    print(
        f"unresolved, mean share of starts: {unresolved.mean(axis=0)}; scenes with any: {(unresolved > 0).sum(axis=0)}"
    )
    for one in results:
        lost = [row for row in one["rows"] if row["share"] > 0.04 and not row["found"]]
        if lost or max(one["unresolved"]) > 0.02:
            print(f"  scene {one['place']} ({one['kind']}): missed {lost}, unresolved {one['unresolved']}")


def main(count, folder):
    """The proof over so many scenes."""
    folder.mkdir(exist_ok=True)
    results = []
    for place in sorted(range(count), key=lambda k: (k // 40, KINDS[k % len(KINDS)], k)):
        path = folder / f"{place}.json"
        if not path.exists():
            found = compared(place)
            with atomic_file(path) as part:
                part.write(json.dumps(found).encode())
            print(place, found["kind"], [round(each, 1) for each in found["seconds"]], len(found["rows"]), flush=True)
        results.append(json.loads(path.read_text()))
    summary(results)


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    main(int(sys.argv[1]), Path(sys.argv[2]))
