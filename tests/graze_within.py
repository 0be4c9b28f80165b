"""Branches through grazings from within a soft wall, where contacts split or join, against 40 digits.

Random scenes with soft walls at rest are followed in the frequency. The grazing is solved again, from the orbits of the
branch on both sides, by tests/reference/soft_orbits.py.
"""

from itertools import pairwise

import numpy as np

import jaxvibro as jv
from tests.reference.soft_orbits import Oscillator, duration, flown, grazing

NEAR, SLOW = 1e-3, 0.05  # speeds: of rows that are not used; below which a hop is computed without samples
BOUNDS = 0.75, 1.2  # of the frequency at which a branch starts


def drawn(seed):
    """Return a scene and its reference: one soft wall or two, with damping up to 0.3 of critical."""
    rng = np.random.default_rng([seed, 7])
    frequency, gamma = float(rng.uniform(0.3, 0.7)), float(rng.uniform(0.02, 0.2))
    right, left = float(rng.uniform(-0.1, 0.4)), -float(rng.uniform(0.8, 2.0))
    walls = {}
    for side, position in ((1, right), (-1, left)) if rng.random() < 1 / 3 else ((1, right),):
        stiffness = float(10 ** rng.uniform(0.5, 1.7))
        walls[side] = position, stiffness, float(rng.uniform(0.02, 0.3) * (1 + stiffness) ** 0.5)
    amplitude = float(rng.uniform(0.5, 2.0))
    ours = [walls.get(side) and jv.Wall(walls[side][0], None, *walls[side][1:]) for side in (-1, 1)]
    return jv.make_scene(amplitude, frequency, gamma, 0.7, tuple(ours)), Oscillator(amplitude, gamma, walls)


def branch_of(scene):
    """Return the branch of the attractor of a scene, None if that is no simple orbit."""
    state, _ = jv.strobe(scene, jv.State(-0.1, 0.0), 300)
    try:
        start = jv.find_orbit(scene, state)
    except jv.OrbitError:
        return None
    if start.periods > 1 or not 0 < int(start.impacts.count) < 5:
        return None
    value = float(scene.frequency)
    return jv.follow(start, "frequency", bounds=(BOUNDS[0] * value, BOUNDS[1] * value))


def contacts_at(oscillator, data, row):
    """Return (time, speed, approximate duration) of each contact of a row of a branch, and the sides."""
    row = data.isel(point=row)
    keep = row["side"].values != 0
    times, speeds, sides = (row[name].values[keep].tolist() for name in ("time", "speed", "side"))
    frequency, contacts = float(row["frequency"]), []
    for k, (time, speed, side) in enumerate(zip(times, speeds, sides, strict=True)):
        after = (k + 1) % len(times)
        later = times[after] + (2 * np.pi / frequency if after <= k else 0.0)
        if sides[after] == side and after != k and speeds[after] < SLOW:
            pull = side * (oscillator.amplitude * np.cos(frequency * later) - oscillator.walls[side][0])
            guess = 2 * speeds[after] / pull
            stay = later - time - hop(oscillator, side, frequency, later, speeds[after], guess)
        else:
            stay = duration(oscillator, side, frequency, time, speed)
        contacts.append((time, speed, stay))
    return contacts, sides


def hop(oscillator, side, frequency, end, speed, guess):
    """Return the approximate duration of a short flight that returns to a wall at a time with a speed."""
    wall = oscillator.walls[side][0]
    for _ in range(5):
        x, v = flown(oscillator, 0, frequency, end, -guess, wall, side * speed)
        guess += float((x - wall) / v)
    return guess


def adjacent_orbits(branch):
    """Yield (row with fewer contacts, row with more, frequency) next to each grazing from within of a branch."""
    ends = [(segment.last, following.first) for segment, following in pairwise(branch.segments)]
    for point in branch.special:
        if point.kind != "GR" or point.normal_form is not None:
            continue
        last, first = next(pair for pair in ends if point.place in pair)
        if not 0 < last < first + 1 < len(branch.data["segment"]):  # the branch ends at it
            continue
        rows = sorted((last - 1, first + 1), key=lambda k: int((branch.data["side"].values[k] != 0).sum()))
        forward = rows[1] == first + 1
        speed, segment = branch.data["speed"].values, branch.data["segment"].values
        same = np.flatnonzero((segment == segment[rows[1]]) & (np.nanmin(speed, axis=1) > NEAR))
        if len(same):
            rows[1] = int(same[0] if forward else same[-1])
            yield *rows, point.value


def error(branch, oscillator, fewer, more, value):
    """Return the error of the frequency of the grazing, from the rows with fewer and with more contacts beside it."""
    first, sides = contacts_at(oscillator, branch.data, fewer)
    second, other_sides = contacts_at(oscillator, branch.data, more)
    slow = min((second[k][1], k) for k in range(len(second)) if other_sides[k - 1] == other_sides[k])[1]
    span = 2 * np.pi / value
    apart = [abs((contact[0] - second[slow - 1][0] + span / 2) % span - span / 2) for contact in first]
    late = (second[slow][0] - second[slow - 1][0]) % span
    return abs(float(grazing(oscillator, sides, value, first, int(np.argmin(apart)), late)) - value)
