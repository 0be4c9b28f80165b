"""Loci from special points of random scenes: `python -m tests.locus_proof N [seed]`, `... steps N [seed]`.

Each is followed in two random parameters; every tenth point is held against tests/reference/special.py. steps: each is
followed with largest steps of 0.02, 0.1 and 0.5, which are to give the same special points and ends, and one curve.
"""

import sys
import time

import jax
import numpy as np

import jaxvibro as jv
from jaxvibro.branches.follow import set_up_equations
from jaxvibro.problem.grazing_contact import find_grazing_contacts
from jaxvibro.scene.typical_scales import typical_length
from tests.branch_proof import branches, plain
from tests.reference import special as reference
from tests.reference.codim import codim

NAMES = (
    "amplitude",
    "frequency",
    "damping",
    "restitution",
    "right.position",
    "left.position",
    "right.motion.amplitude",
)
EVERY = 10  # points
STEPS = 0.02, 0.1, 0.5
ALIKE = 1e-5  # of 1 + abs value: special points as near are one


def error(locus, place, digits=40, near=None):
    """How far the first parameter at a point is from the reference's, the second being as it is; near: the place of
    another point, of another locus perhaps, whose impacts the reference begins with."""
    one, k = near or (locus, place)
    row = one.data.isel(point=k)
    times, speeds = (row[key].values.tolist() for key in ("time", "speed"))
    sides = [int(side) for side in row["side"].values]
    first, second = locus.names
    value, other = (float(locus.data[name].values[place]) for name in locus.names)
    scene = plain(locus.scene.replace(**{first: value, second: other}))
    impacts = times, speeds, sides, locus.data.attrs["periods"]
    true = reference.special(scene, theirs(locus.scene, first), locus.kind, value, *impacts, digits=digits)
    return abs(float(true - value))


def codim_error(point, kind, closing, half=False):
    """How far both parameters at a `Codim2` are from the reference's; closing: the locus' kind."""
    spot, half = point.spot, half or closing == "SB"
    rows = [each.tolist() for each in (spot.times, spot.speeds)]
    sides, touch = [int(side) for side in spot.sides], None
    if kind == "GR" and min(rows[1]) > 1e-9:
        along, z = set_up_equations(point.scene, next(iter(point.values)), spot)
        one = find_grazing_contacts(along, z, typical_length(point.scene))[0]
        touch = one.row, spot.times[one.row] + one.time_since_impact, one.side, "SN" if closing == "SN" else "PD"
    values = list(point.values.values())
    names = [theirs(point.scene, name) for name in point.values]
    true = codim(plain(point.scene), names, kind, values, *rows, sides, spot.periods, half, touch)
    return max(abs(float(a - b)) for a, b in zip(true, values, strict=True))


def theirs(scene, name):
    """The references' name of a parameter: to them, "restitution" is that of both walls."""
    if name != "restitution":
        return name
    own = {key: getattr(scene, key) for key in ("left", "right")}
    shared = [key for key, wall in own.items() if wall is not None and wall.restitution is None]
    alone = len(shared) == 1 and None not in own.values()
    return f"{shared[0]}.restitution" if alone else name


def picked(branch, rng):
    """(special point, two names, bounds) at random, or None."""
    points = [one for one in branch.special if one.kind in ("SN", "PD", "SB", "GR") and len(one.spot.times) <= 8]
    if not points:
        return None
    point = points[rng.integers(len(points))]
    free = [name for name in NAMES if name in branch.scene.names]
    if point.kind == "SB":
        free = [name for name in free if "." not in name]
    names = tuple(str(name) for name in rng.choice(free, 2, replace=False))
    return point, names, {name: room(point.scene, name) for name in names}


def room(scene, name):
    """Bounds about a parameter's value."""
    value = float(scene.parameter(name))
    if name == "restitution":
        return 0.05, 1.0
    if name == "damping":
        return 0.0, 2.0 * value + 0.2
    return tuple(sorted((0.5 * value - 0.2, 1.8 * value + 0.3))) if name != "frequency" else (0.5 * value, 1.6 * value)


def main(count, seed):
    """So many loci; what is found of each, then the worst of all."""
    rng, done, tried, worst, kinds, ends = np.random.default_rng(seed), 0, 0, 0.0, {}, {}
    raised = refused = 0
    far = 0.0
    for branch, _ in branches(rng, 10 * count):
        found = picked(branch, rng)
        if done == count:
            break
        if found is None:
            continue
        done += 1
        point, names, bounds = found
        told, began = [], time.perf_counter()
        try:
            locus = jv.locus(point, names, bounds)
        except jv.ArgumentError as why:
            refused += why.key in ("special", "names")
            raised += why.key not in ("special", "names")
            print(done, point.kind, point.label, names, "refused:", why, flush=True)
            continue
        except Exception as why:  # whatever it is, it is to be told
            raised += 1
            print(done, point.kind, point.label, names, bounds, point.scene, f"{type(why).__name__}: {why}", flush=True)
            continue
        took = time.perf_counter() - began
        for place in range(0, len(locus), EVERY):
            tried += 1
            try:
                off = error(locus, place) / (1.0 + abs(locus.values[place, 0]))
            except (ArithmeticError, ValueError, IndexError) as why:
                told.append(f"at {locus.values[place]}: {why};")
                continue
            worst = max(worst, off)
            if off > 1e-11:
                told.append(f"at {place}, {locus.values[place]} off by {off:.1e};")
        clear, slow, left = (locus.data[key].values for key in ("least_clearance", "least_speed", "residual"))
        size = 1.0 + abs(locus.values).max()
        if clear.min() < -1e-8 * size or slow[1:-1].min(initial=1.0) <= 0 or left.max() > 1e-11 * size:
            told.append(f"clearance {clear.min():.1e}, speed {slow.min():.1e}, residual {left.max():.1e};")
        for one in locus.special:
            kinds[one.kind] = kinds.get(one.kind, 0) + 1
            if one.kind not in ("GR", "CP", "GPD", "RG"):
                continue
            try:
                off = codim_error(one, one.kind, locus.kind, sum(one.spot.speeds < 1e-9) == 2)
            except (ArithmeticError, ValueError, IndexError) as why:
                told.append(f"{one.kind} {one.values}: {why};")
                continue
            far = max(far, off)
            if off > 1e-9:
                told.append(f"{one.kind} {one.values} off by {off:.1e};")
        for why in locus.reasons:
            ends[why.split(" 0")[0][:40]] = ends.get(why.split(" 0")[0][:40], 0) + 1
        reasons = " | ".join(locus.reasons)
        print(f"{done} {locus} {reasons};", *told, f"({took:.1f} s)", flush=True)
        if told:
            print("   ", point.scene, bounds, flush=True)
    print(f"{done} loci, {refused} refused, {raised} raised; {tried} points, worst error over 1 + value {worst:.1e}")
    print(f"points of codimension two off by {far:.1e}", kinds)
    for why, times in sorted(ends.items()):
        print(f"{times:5} {why}")


def steps(count, seed):
    """So many loci with long and short steps: what differs, then how often."""
    rng, done, other, far = np.random.default_rng(seed), 0, 0, 0
    for branch, _ in branches(rng, 10 * count):
        found = picked(branch, rng)
        if found is None:
            continue
        point, names, bounds = found
        try:
            fine, *coarse = (
                jv.locus(point, names, bounds, first_step=min(0.02, step), largest_step=step) for step in STEPS
            )
        except jv.ArgumentError as why:
            print("refused:", why, flush=True)
            continue
        done += 1
        for step, one in zip(STEPS[1:], coarse, strict=True):
            apart = different(fine, one)
            away = farthest(curve(fine), curve(one))
            other, far = other + bool(apart), far + (away > STEPS[0])
            if apart or away > STEPS[0]:
                print(done, point.kind, point.label, names, step, apart, f"{away:.1e} away", flush=True)
        if done == count:
            break
    print(f"{done} loci by {len(STEPS)} steps: {other} with other special points or ends, {far} off the curve")


def different(one, other):
    """What of two loci is not the same: their kinds, the places of their special points, or nothing."""
    if [each.kind for each in one.special] != [each.kind for each in other.special]:
        return "kinds"
    places = ([list(each.values.values()) for each in locus.special] for locus in (one, other))
    here, there = map(np.array, places)
    return "places" if (abs(here - there) > ALIKE * (1.0 + abs(here))).any() else ""


def curve(locus):
    """The parameters and the sum of the speeds at each point."""
    return np.column_stack([locus.values, np.nan_to_num(locus.data["speed"].values).sum(axis=1)])


def farthest(fine, coarse):
    """How far a point of one curve is from the other at the most, over the other's extent."""
    ways, worst = np.diff(fine, axis=0), 0.0
    for point in coarse:
        share = np.clip(np.sum((point - fine[:-1]) * ways, 1) / np.maximum(np.sum(ways**2, 1), 1e-300), 0.0, 1.0)
        worst = max(worst, np.linalg.norm(fine[:-1] + share[:, None] * ways - point, axis=1).min())
    return worst / np.ptp(fine, axis=0).max()


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    what, given = (steps, sys.argv[2:]) if sys.argv[1] == "steps" else (main, sys.argv[1:])
    number, *rest = given
    what(int(number), int(rest[0]) if rest else 0)
