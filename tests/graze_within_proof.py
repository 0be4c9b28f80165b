"""Branches through grazings from within, both sides held against 34 digits: `python -m tests.graze_within_proof 20`.

Random scenes with soft walls at rest, followed in the frequency: where one contact splits into two, or two join, the
grazing itself and the nearest orbits of the branch on both sides are solved again by tests/reference/graze_within.py.
"""

import sys
from itertools import pairwise

import jax
import numpy as np

import jaxvibro as jv
from tests.reference.graze_within import Oscillator, flown, grazing, orbit

NEAR, SLOW = 1e-3, 0.05  # speeds that are looked at; at which a flight between contacts is told without samples
SAMPLES = 4000  # of a drive period
BOUNDS = 0.75, 1.2  # of the frequency where a branch starts


def drawn(seed):
    """(scene, the reference's): one soft wall, or one in three two, of any damping up to 0.3 of critical."""
    rng = np.random.default_rng([seed, 7])
    frequency, gamma = float(rng.uniform(0.3, 0.7)), float(rng.uniform(0.02, 0.2))
    place, other = float(rng.uniform(-0.1, 0.4)), -float(rng.uniform(0.8, 2.0))
    walls = {}
    for side, position in ((1, place), (-1, other)) if rng.random() < 1 / 3 else ((1, place),):
        stiffness = float(10 ** rng.uniform(0.5, 1.7))
        walls[side] = position, stiffness, float(rng.uniform(0.02, 0.3) * (1 + stiffness) ** 0.5)
    amplitude = float(rng.uniform(0.5, 2.0))
    ours = [
        (side in walls and jv.Wall(walls[side][0], stiffness=walls[side][1], damping=walls[side][2])) or None
        for side in (-1, 1)
    ]
    return jv.make_scene(amplitude, frequency, gamma, 0.7, tuple(ours)), Oscillator(amplitude, gamma, walls)


def branch_of(scene):
    """The branch of what the scene settles on, None where that is no orbit or has none."""
    state, _ = jv.strobe(scene, jv.State(-0.1, 0.0), 300)
    try:
        one = jv.find_orbit(scene, state)
    except jv.OrbitError:
        return None
    if one.periods > 1 or not 0 < int(one.impacts.count) < 5:
        return None
    value = float(scene.frequency)
    return jv.follow(one, "frequency", bounds=(BOUNDS[0] * value, BOUNDS[1] * value))


def contacts_at(scene, other, data, place):
    """([(time, speed, about how long it stays) of each contact], sides) of a row of a branch's data."""
    row = data.isel(point=place)
    keep = row["side"].values != 0
    times, speeds, sides = (row[name].values[keep].tolist() for name in ("time", "speed", "side"))
    frequency = float(row["frequency"])
    here, found = scene.replace(frequency=frequency), []
    for k, (time, speed, side) in enumerate(zip(times, speeds, sides, strict=True)):
        after = (k + 1) % len(times)
        later = times[after] + (2 * np.pi / frequency if after <= k else 0.0)
        if sides[after] == side and after != k and speeds[after] < SLOW:
            pull = side * (other.amplitude * np.cos(frequency * later) - other.walls[side][0])
            stay = later - time - hop(other, side, frequency, later, speeds[after], 2 * speeds[after] / pull)
        else:
            stay = first_exit(here, jv.State(other.walls[side][0], side * speed, frequency * time, 3.0 * side), side)
        found.append((time, speed, stay))
    return found, sides


def hop(other, side, frequency, end, speed, guess):
    """About how long the short flight from a wall took that comes back to it at a time with a speed."""
    for _ in range(5):
        x, v = flown(other, 0, frequency, end, -guess, other.walls[side][0], side * speed)
        guess += float((x - other.walls[side][0]) / v)
    return guess


def first_exit(scene, start, side):
    """About how long a stay lasts."""
    times = np.arange(1, SAMPLES) * 2 * np.pi / float(scene.frequency) / SAMPLES
    path, _ = jv.sample(scene, start, times)
    gone = side * (np.asarray(path.x) - float(start.x)) <= 0
    k = int(np.argmax(gone))
    return float(times[k] - 0.5 * times[0])


def within(branch):
    """(row with fewer contacts, row with more, frequency) next to each grazing from within of a branch."""
    ends = [(one.last, after.first) for one, after in pairwise(branch.segments)]
    for point in branch.special:
        if point.kind == "GR" and point.normal_form is None:
            last, first = next(pair for pair in ends if point.place in pair)
            if not 0 < last < first + 1 < len(branch.data["segment"]):  # one that the branch goes no further than
                continue
            rows = sorted((last - 1, first + 1), key=lambda k: int((branch.data["side"].values[k] != 0).sum()))
            on = 1 if rows[1] == first + 1 else -1
            speed, piece = branch.data["speed"].values, branch.data["segment"].values
            same = np.flatnonzero((piece == piece[rows[1]]) & (np.nanmin(speed, axis=1) > NEAR))
            if not len(same):  # all of it near where there is another, of speed below 0
                continue
            rows[1] = int(same[0] if on > 0 else same[-1])
            yield *rows, point.value


def held(branch, scene, other, few, many, value):
    """How far off are the grazing's frequency, the orbit with fewer contacts, that with more: (3,)."""
    one, sides = contacts_at(scene, other, branch.data, few)
    two, more = contacts_at(scene, other, branch.data, many)
    off = []
    for place, given, walls in ((few, one, sides), (many, two, more)):
        true = orbit(other, walls, 1, float(branch.data["frequency"][place]), given)
        off.append(
            max(abs(float(a - b)) for x, y in zip(given, true, strict=True) for a, b in zip(x[:2], y, strict=False))
        )
    gaps = [(two[k][1], k) for k in range(len(two)) if more[k - 1] == more[k]]
    slow = min(gaps)[1]
    span = 2 * np.pi / value
    before = min(range(len(one)), key=lambda k: abs((one[k][0] - two[slow - 1][0] + span / 2) % span - span / 2))
    late = (two[slow][0] - two[slow - 1][0]) % span
    found, _, _ = grazing(other, sides, 1, value, one, before, late)
    return np.array([abs(float(found) - value), *off])


def main(count=20, first=0, most=400):
    """Print a line for each grazing from within, then the worst."""
    worst, done = np.zeros(3), 0
    for seed in range(first, first + most):
        scene, other = drawn(seed)
        branch = branch_of(scene)
        if branch is None:
            continue
        found = list(within(branch))
        print(f"seed {seed}:", *(end.name for end in branch.ends), flush=True)
        for few, many, value in found:
            try:
                off = held(branch, scene, other, few, many, value)
            except ArithmeticError:
                print(f"seed {seed}: {value:.12f}: the reference has no root near what it starts from", flush=True)
                continue
            worst = np.maximum(worst, off)
            print(f"seed {seed}: {value:.12f}", *(f"{each:.1e}" for each in off), flush=True)
        done += bool(found)
        if done >= count:
            break
    print(f"{done} branches; largest differences: of the frequency, the orbits with fewer contacts, with more:", *worst)


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    main(*map(int, sys.argv[1:]))
