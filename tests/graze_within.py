"""Branches through grazings from within a soft wall, where contacts split or join, against closed forms."""

import numpy as np

import jaxvibro as jv
from tests.reference import soft_orbits

BOUNDS = 0.75, 1.2  # of the frequency at which a branch starts


def drawn(seed):
    """Return a scene and its reference: one soft wall or two at rest, with damping up to 0.3 of critical."""
    rng = np.random.default_rng([seed, 7])
    frequency, gamma = float(rng.uniform(0.3, 0.7)), float(rng.uniform(0.02, 0.2))
    right, left = float(rng.uniform(-0.1, 0.4)), -float(rng.uniform(0.8, 2.0))
    walls = {}
    for side, position in ((1, right), (-1, left)) if rng.random() < 1 / 3 else ((1, right),):
        stiffness = float(10 ** rng.uniform(0.5, 1.7))
        walls[side] = position, stiffness, float(rng.uniform(0.02, 0.3) * (1 + stiffness) ** 0.5)
    amplitude = float(rng.uniform(0.5, 2.0))
    ours = [walls.get(side) and jv.Wall(walls[side][0], None, *walls[side][1:]) for side in (-1, 1)]
    return jv.make_scene(amplitude, frequency, gamma, 0.7, tuple(ours)), soft_orbits.Oscillator(amplitude, gamma, walls)


def grazings_of(scene):
    """Return the grazings from within on the branch of the attractor of a scene along the frequency."""
    state, _ = jv.strobe(scene, jv.State(-0.1, 0.0), 300)
    try:
        start = jv.find_orbit(scene, state)
    except jv.OrbitError:
        return []
    if start.periods > 1 or not 0 < int(start.impacts.count) < 5:
        return []
    value = float(scene.frequency)
    branch = jv.follow(start, "frequency", bounds=(BOUNDS[0] * value, BOUNDS[1] * value))
    inner = [point for point in branch.special if 0 < point.place < len(branch) - 1]
    return [point for point in inner if point.kind == "GR" and point.normal_form is None]


def error(point, oscillator):
    """Return the error of the frequency of a grazing, solved again with one contact that goes on after the touch."""
    spot, frequency = point.spot, point.value
    rows = list(zip(spot.times.tolist(), spot.speeds.tolist(), spot.sides.tolist(), strict=True))
    touch = min(range(len(rows)), key=lambda k: rows[k][1])
    contacts = [
        [time, speed, soft_orbits.duration(oscillator, side, frequency, time, speed)] for time, speed, side in rows
    ]
    late = (rows[touch][0] - rows[touch - 1][0]) % (2 * np.pi / frequency)
    contacts[touch - 1][2] = late + contacts[touch][2]
    sides = [side for _, _, side in rows]
    del contacts[touch], sides[touch]
    row = touch - 1 if touch else len(contacts) - 1
    return abs(float(soft_orbits.grazing(oscillator, sides, frequency, contacts, row, late)) - frequency)
