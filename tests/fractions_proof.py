"""Shares and names along parameters: `python -m tests.fractions_proof [CASE] [VALUES] [PERIODS]`, a case of CASES.

Shares: at each of so many values the bounds of `fractions` are held against MANY starts from another seed, labelled by
the traps of `basins` (`attractors_proof.counted`). Names: every periodic attractor of at most so many periods is looked
for on the branches of `explore`. From value to value one name is to stay on one branch, or to go on by a point where a
branch is left (PD, SB, BP); and no branch that is stable from one value to the next may change its name.
"""

import sys
import time

import jax
import numpy as np

import jaxvibro as jv
from jaxvibro.maps.iterate import iterate
from jaxvibro.orbits.orbit_comparison import impacts_as_points, samples_fill_same_set
from jaxvibro.surveys.attractor_matching import nearest_rotation
from tests.attractors_proof import MANY, counted

WALLS = (-1.0, 1.0)
CASES = {
    "fig4": ((4.65, 2.1, 0.05, 0.7, WALLS), "amplitude", (3.5, 6.0)),
    "faster": ((4.0, 2.1, 0.05, 0.7, WALLS), "frequency", (1.7, 2.7)),
    "bouncy": ((2.6, 2.3, 0.04, 0.7, WALLS), "restitution", (0.2, 0.9)),
    "uneven": ((4.0, 2.1, 0.05, 0.7, (-1.5, 1.0)), "amplitude", (0.5, 7.0)),
    "one": ((3.0, 2.1, 0.05, 0.7, (None, 1.0)), "amplitude", (0.5, 6.0)),
    "moved": ((4.0, 2.1, 0.05, 0.6, WALLS), "left.position", (-1.6, -0.4)),
    "moving": ((3.0, 2.1, 0.05, 0.7, (-1.0, jv.Wall(1.0, motion=jv.Motion(0.1, 0.5)))), "amplitude", (0.5, 5.0)),
}
NEAR = 0.03  # of the largest x and v: a state so near to the line between two points of a branch is on it
LONG = 16  # times 64 periods of a chaotic motion that are compared


def hits(scene, x, v):
    """The impacts, as points, of a long motion from a state on."""
    state, parts = jv.State(*(np.array([one], float) for one in (x, v, 0.0, 0.0))), []
    for _ in range(LONG):
        run = iterate(scene, state, 64, max_single_lanes=0)
        state = run.state
        parts.append(impacts_as_points(float(scene.frequency), run.time[:, 0], run.side[:, 0], run.speed[:, 0], 3.0))
    return np.concatenate(parts)


def is_it(scene, one, entry):
    """Whether an `Attractor` is what a value's entry tells of."""
    if str(entry.kind.values) != one.kind or int(entry.periods) != one.periods:
        return False
    state = float(entry.state_x), float(entry.state_v)
    if one.periods:
        return bool(abs(one.points - state).max(axis=1).min() < 1e-5)
    return samples_fill_same_set(hits(scene, *state), hits(scene, one.state.x, one.state.v))


def shares(scene, found, name):
    """Prints how many shares of MANY other starts lie within the bounds."""
    held, lost, missed, began = [], [], [], time.perf_counter()
    for k, value in enumerate(found[name].values):
        at, here = scene.replace(**{name: value}), found.isel({name: k})
        for starts in (200, 2000):
            known = [one for one in jv.find_attractors(at, starts, 1000 + k) if one.kind != "unresolved"]
            counts, others, off = counted(at, known, 100_000 + k)
            if not others:
                break
        there = [place for place in range(found.sizes["attractor"]) if str(here.label[place].values)]
        for one, count in zip(known, counts, strict=True):
            place = next((each for each in there if is_it(at, one, here.isel(attractor=each))), None)
            if place is None:
                missed.append((float(value), one.label, count / MANY))
                continue
            entry = here.isel(attractor=place)
            there.remove(place)
            held.append(bool(entry.share_low <= count / MANY <= entry.share_high))
        missed += [(float(value), label, count / MANY) for label, count in others]
        lost.append(bool(here.unresolved_low <= off / MANY <= here.unresolved_high))
        extra = [(float(value), str(here.label[place].values), float(here.share[place])) for place in there]
        missed += [(*one, "of these starts alone") for one in extra if one[2] > 0]
    print(f"bounds hold the share of {MANY} other starts: {sum(held)} of {len(held)}, {100 * np.mean(held):.1f} %")
    print(f"bounds of the unresolved: {sum(lost)} of {len(lost)}; {time.perf_counter() - began:.0f} s")
    print(f"known to one of both alone: {missed}", flush=True)


def located(diagram, value, entry):
    """(branch, row, row after it) nearest to an attractor's points, None where none is near."""
    state, n, best = np.array([float(entry.state_x), float(entry.state_v)]), int(entry.periods), (NEAR, None)
    for b, branch in enumerate(diagram.branches):
        if branch.data.sizes["period"] != n:
            continue
        values, points = branch.values, np.stack([branch.data[key].values for key in "xv"], -1)
        size = abs(points).max()
        for k in np.flatnonzero((values[:-1] - value) * (values[1:] - value) <= 0):
            part = (value - values[k]) / (values[k + 1] - values[k] or 1.0)
            line = (1.0 - part) * points[k] + part * nearest_rotation(points[k + 1], points[k])
            apart = abs(line - state).max(axis=1).min() / size
            best = min(best, (apart, (b, int(k))), key=lambda one: one[0])
    return best[1]


def ways(branch, first, last):
    """The rows between two places of a branch, each the row before it; of a closed one also the other way."""
    low, high = sorted((first, last))
    yield np.arange(low + 1, high + 1)
    if any("closes" in str(one) for one in branch.reasons):
        yield np.concatenate([np.arange(high + 1, len(branch)), np.arange(low + 1)])


def stays(branch, first, last, low, high):
    """Whether a branch leads from the one place to the other without a turn, stable all the way."""
    return any(
        ((branch.values[rows] >= low) & (branch.values[rows] <= high) & branch.stable[rows]).all()
        for rows in ways(branch, first, last)
    )


def leaves(diagram, one, other, low, high):
    """Whether one of two branches begins or ends at a point where it leaves the other, between two values."""
    for a, b in ((one, other), (other, one)):
        ends = diagram.branches[b].values[[0, -1]]
        for point in diagram.branches[a].special:
            if point.kind in ("PD", "SB", "BP") and low <= point.value <= high and abs(ends - point.value).min() < 1e-3:
                return True
    return False


def identities(scene, found, name, bounds, periods):
    """Prints on which branches the names stay."""
    began = time.perf_counter()
    diagram = jv.explore(scene, name, (bounds[0] - 0.02, bounds[1] + 0.02), periods)
    print(
        f"explore: {len(diagram)} branches of up to {periods} periods in {time.perf_counter() - began:.0f} s",
        flush=True,
    )
    values, places, off = found[name].values, {}, []
    for k, value in enumerate(values):
        for a in range(found.sizes["attractor"]):
            entry = found.isel({name: k, "attractor": a})
            if 0 < int(entry.periods) <= periods:
                places[k, a] = located(diagram, value, entry)
                if places[k, a] is None:
                    off.append((float(value), str(entry.label.values)))
    print(f"orbits on a branch: {len(places) - len(off)} of {len(places)}; not: {off}")
    count, wrong, renamed = {"one branch": 0, "left at a point": 0}, [], []
    for (k, a), here in places.items():
        for (j, b), there in places.items():
            if j != k + 1 or here is None or there is None:
                continue
            low, high = values[k], values[j]
            same = here[0] == there[0] and stays(diagram.branches[here[0]], here[1], there[1], low, high)
            if a == b and same:
                count["one branch"] += 1
            elif a == b and leaves(diagram, here[0], there[0], low, high):
                count["left at a point"] += 1
            elif a == b:
                wrong.append((float(low), a, here, there))
            elif same:
                renamed.append((float(low), a, b, here, there))
    print(f"names from value to value: {count}; on other branches: {wrong}; renamed along a branch: {renamed}")


def main(case, values, periods):
    """The proof along so many values of a case."""
    numbers, name, bounds = CASES[case]
    scene, began = jv.make_scene(*numbers), time.perf_counter()
    found = jv.fractions(scene, name, np.linspace(*bounds, values))
    spent, there = time.perf_counter() - began, found.label != ""
    print(f"{case}: {values} values in {spent:.0f} s: {found.sizes['attractor']} names, {int(there.sum())} entries")
    print(f"entries that no start settled on: {int((there & (found.share == 0)).sum())}", flush=True)
    identities(scene, found, name, bounds, periods)
    shares(scene, found, name)


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    case, *given = sys.argv[1:] or ["fig4"]
    main(case, *([int(one) for one in given] + [50, 4][len(given) :]))
