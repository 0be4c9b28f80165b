"""Soft walls in studies: exponents, sections, return maps, basins and manifolds against other methods.

`tests/properties/test_flight.py` has the inverse map, sums of exponents, and grazings from within.
"""

from dataclasses import replace

import numpy as np
import pytest

import jaxvibro as jv
from tests.plane_curves import bisected, distance
from tests.reference.soft_lanes import Lanes, Wall, exponents

GAMMA = 0.045
MIXED = (jv.Wall(-0.9, stiffness=10.0, damping=0.2, motion=jv.Motion(0.1, 0.4, 2)), jv.Wall(1.0, 0.6))
TWO = tuple(jv.Wall(place, stiffness=10.0, damping=0.3) for place in (-1.0, 1.0))


def lanes(scene, walls, x, v):
    return Lanes(float(scene.amplitude), float(scene.frequency), float(scene.damping), walls, x, v)


@pytest.mark.parametrize("size", ["small", "large"])
def test_exponents_of_chaos_are_those_of_another_method(size):
    lane_count, periods, error = {"small": (32, 60, 0.05), "large": (128, 150, 0.01)}[size]
    scene = jv.make_scene(1.0, 2.285, GAMMA, 0.7, (None, jv.Wall(0.28, stiffness=10.0, damping=0.1)))
    found = jv.spectrum(scene, "amplitude", [1.0], jv.State(0.18, 0.3), error=error)
    rng = np.random.default_rng(1)
    x, v = np.full(lane_count, 0.18), 0.3 + 1e-7 * rng.normal(size=lane_count)
    reference = lanes(scene, [Wall(1, 0.28, None, 10.0, 0.1)], x, v)
    rates, hits, spent = exponents(reference, periods, 200)
    errors = np.maximum(rates.std(axis=0, ddof=1) / lane_count**0.5, 1 / periods)
    assert found.exponent[0, 0] > 0.05
    assert (abs(found.exponent[0] - rates.mean(axis=0)) < 4 * np.hypot(found.error[0], errors)).all()
    assert abs(found.within[0, 1] - spent[1].mean()) < 2 * error and abs(found.impacts[0] - hits[1].mean()) < 3 * error


def test_exponents_of_an_orbit_are_its_multipliers():
    scene = jv.make_scene(2.0, 2.1, 0.05, 0.7, MIXED)
    found = jv.spectrum(scene, "amplitude", [2.0], jv.State(0.5, -1.1))
    orbit = jv.find_orbit(scene, jv.strobe(scene, jv.State(0.5, -1.1), 600)[0])
    expected = np.sort(np.log(abs(orbit.multipliers)) / orbit.periods)[::-1]
    assert found.periods[0] == orbit.periods and abs(found.exponent[0] - expected).max() < 1e-10


def test_sections_of_soft_walls_and_the_maps_between_their_points():
    """At a soft wall a point is an entry: the map leads from each to the next, through the contact."""
    scene = jv.make_scene(2.0, 2.1, 0.05, 0.7, MIXED)
    found = jv.sections(scene, jv.State(0.5, -1.1), phase=1.0, periods=40, settle=3)
    assert (found["left_velocity"] < 0).all() and (found["right_velocity"] < 0).all()
    end, _ = jv.strobe(scene, jv.State(found["x"].values[:-1], found["v"].values[:-1], 1.0))
    assert np.abs(found["x"].values[1:] - end.x).max() < 1e-10
    phase, velocity = found["left_phase"].values, found["left_velocity"].values
    after = jv.return_map(scene, "left", phase[:-1], velocity[:-1], periods=4)
    assert np.asarray(after.found).all()
    assert abs(np.angle(np.exp(1j * (phase[1:] - np.asarray(after.phase))))).max() < 1e-9
    assert np.abs(velocity[1:] - after.velocity).max() < 1e-9


def test_basins_and_their_boundary():
    """Labels against the reference, also of starts within walls; the boundary by bisection lies on the manifold."""
    scene = jv.make_scene(1.0, 1.6, 0.05, 0.7, TWO)
    attractors = jv.find_attractors(scene, starts=20)
    x, v = np.linspace(-1.5, 1.5, 16), np.linspace(-3.0, 3.0, 16)
    data = jv.basins(scene, x, v, 0.0, attractors)
    label = data["label"].values
    assert (label >= 0).all() and min(data["fraction"].values) > 0.1
    across, along = (each.ravel() for each in np.meshgrid(x, v))
    reference = lanes(scene, [Wall(side, float(side), None, 10.0, 0.3) for side in (-1, 1)], across, along)
    for _ in range(150):
        reference.period()
    points = np.stack([data["point_x"].values[:, 0], data["point_v"].values[:, 0]], -1)
    apart = abs(np.stack([reference.x, reference.v], -1)[:, None] - points).max(axis=-1)
    assert apart.min(axis=1).max() < 1e-6 and (apart.argmin(axis=1) == label.ravel()).all()
    saddle = next(each for each in jv.find_orbits(scene, 1, 64) if abs(each.multipliers[0]) > 1)
    curve = jv.manifold(saddle, "stable", 12.0, 0.0)
    row, column = next((i, j) for i, j in np.argwhere(label[1:] != label[:-1]) if abs(x[j]) > 1.05)
    point = bisected(scene, attractors, (x[column], v[row]), (x[column], v[row + 1]))
    assert distance(curve, point[None])[0] < 1e-6
    critical = replace(saddle, scene=scene.replace(**{"right.damping": 4.0}))  # this wall takes all speed
    with pytest.raises(jv.ArgumentError, match=r"^right.damping: must be less than critical"):
        jv.manifold(critical, "stable", 1.0, 0.0)


def test_manifolds_of_stiff_walls_are_those_of_rigid_ones():
    rigid = jv.make_scene(4.65, 2.1, 0.05, 0.7, (-1.0, 1.0))
    curves = []
    for scene in (rigid, jv.soften(rigid, 1e8)):
        orbits = jv.find_orbits(scene, 1, 64)
        orbit = next(each for each in orbits if each.label == "P111" and each.multipliers[0].real > 1)
        curves.append(jv.manifold(orbit, "stable", 4.0, 0.0))
    hard, soft = curves
    z = np.stack([soft["x"].values, soft["v"].values], -1)
    free = abs(z[:, 0]) < 0.9999
    assert distance(hard, z[free][::40]).max() < 5e-3
