"""Properties of curves of special points in two parameters, and of the curves that leave their points."""

import mpmath
import numpy as np
import pytest

import jaxvibro as jv
from tests.kinds import wall_ends
from tests.reference import closed
from tests.reference.search import Discard
from tests.tiers import generator, of_numbers

from . import special_points
from .special_points import (
    SLOW,
    codim2_error,
    find_loci,
    locus_error,
    resonance,
)

OWN_KINDS = special_points.OWN_KINDS
CODIM2 = ("GR", "RG", "CP", "GPD", "DSB", "SN", "PD", "SB")


@of_numbers
def test_points(kind, number):
    """The orbits of a locus are periodic, and have the multiplier, or touch the wall, that its kind says.

    The multipliers are those of the reference implementation, where it decides the motion.
    """
    compared = 0
    for locus in find_loci(kind.name, number).values():
        size = 1.0 + abs(locus.values).max()
        assert len(locus) > 3
        assert locus.data["residual"].max() <= 1e3 * kind.tolerance * size
        assert locus.data["least_clearance"].min() >= -1e-8 * size
        for place in {1, len(locus) // 2, len(locus) - 2}:
            (scene, spot), orbit = locus.located(place), locus.orbit(place)
            if locus.kind == "GR":
                compared += touches_wall(scene, orbit.state, spot)
            else:
                compared += closes(kind, scene, orbit, -1.0 if locus.kind == "PD" else 1.0)
    assert compared >= 1


def closes(kind, scene, orbit, multiplier):
    """Check the multiplier of an orbit by the reference; return whether it decides the motion."""
    x, v = float(orbit.state.x), float(orbit.state.v)
    if kind.name == "contact_law" and orbit.periods > 1:
        return False
    try:
        truth = kind.truth(scene, x, v, float(orbit.state.phase), orbit.periods)
    except Discard:
        return False
    assert max(abs(float(truth.x) - x), abs(float(truth.v) - v)) < 1e3 * kind.tolerance * truth.allowed
    norm, slowest = np.linalg.norm(truth.matrix), min(float(speed) for speed in truth.speeds)
    closing = 1.0 - multiplier * np.trace(truth.matrix) + np.linalg.det(truth.matrix)
    assert abs(closing) < 1e4 * kind.tolerance * (1.0 + norm) ** 2 * (1.0 + 1.0 / slowest)
    return True


def touches_wall(scene, state, spot):
    """Check that the orbit is at rest relative to a wall at its first touch; return whether it has one."""
    touches = np.flatnonzero(spot.speeds < SLOW)
    if not len(touches):
        return False
    time, side = float(spot.times[touches[0]]), int(spot.sides[touches[0]] > 0)
    seen, _ = jv.sample(scene, state, np.array([time]))
    ends = [wall_ends(scene, float(scene.frequency) * (time + late))[side] for late in (-1e-5, 0.0, 1e-5)]
    assert abs(seen.x[0] - ends[1]) < 1e-8
    assert abs(seen.v[0] - (ends[2] - ends[0]) / 2e-5) < 1e-5
    return True


@of_numbers
def test_reference(kind, number):
    """Points of a locus, and its points of codimension two, are those of the reference in high precision."""
    for name, locus in find_loci(kind.name, number).items():
        for place in {0, len(locus) // 3, 2 * len(locus) // 3, len(locus) - 1}:
            if place not in {point.place for point in locus.special if point.kind != "EP"}:
                assert locus_error(locus, place) < 1e-11 * (1.0 + abs(locus.values[place, 0])), name
        for point in locus.special:
            if point.kind in CODIM2:
                assert codim2_error(point) < 1e-9


@of_numbers
def test_other_end(kind, number):
    """A locus from a special point near its other end, with the parameters exchanged, is the same curve."""
    compared = 0
    for name, locus in find_loci(kind.name, number).items():
        point = point_near_end(locus)
        if point is None:
            continue
        compared += 1
        other = jv.locus(point, locus.names[::-1], locus.bounds, first_step=0.1, largest_step=0.5)
        ends, others = (curve.values[[0, -1]] for curve in (locus, other))
        others = others[:, ::-1]
        if np.linalg.norm(ends - others) > np.linalg.norm(ends - others[::-1]):
            others = others[::-1]
        assert ends == pytest.approx(others, abs=1e-7), name
        known, found = (sorted(point.kind for point in curve.special) for curve in (locus, other))
        assert known == found
        extent = np.ptp(locus.values, axis=0)
        assert farthest(locus.values / extent, other.values[:, ::-1] / extent) < 0.05
    assert compared >= 1


def point_near_end(locus):
    """Return the special point of a branch through an orbit near the end of a locus; None if it has none."""
    place = max(1, len(locus) - 3)
    name, value = locus.names[0], locus.values[place, 0]
    try:
        branch = jv.follow(locus.orbit(place), name, (0.97 * value, 1.03 * value), max_points=60)
    except (jv.OrbitError, jv.ArgumentError):
        return None
    points = [point for point in branch.points(locus.kind) if abs(point.value - value) < 1e-8 * (1.0 + abs(value))]
    return points[0] if points else None


def farthest(curve, points):
    """Return the largest distance of points from a polyline."""
    ways, worst = np.diff(curve, axis=0), 0.0
    for point in points:
        share = np.clip(np.sum((point - curve[:-1]) * ways, 1) / np.maximum(np.sum(ways**2, 1), 1e-300), 0.0, 1.0)
        worst = max(worst, np.linalg.norm(curve[:-1] + share[:, None] * ways - point, axis=1).min())
    return worst


@of_numbers
def test_switching(kind, number):
    """The loci that leave points of codimension two begin there, and have points of the reference."""
    for locus in find_loci(kind.name, number).values():
        for point in locus.special:
            if point.kind not in ("RG", "GPD", "DSB") and (point.on, point.kind) not in (("GR", "PD"), ("GR", "SB")):
                continue
            for branch in jv.switch(point):
                start = [branch.special[0].values[name] for name in point.values]
                assert start == pytest.approx(list(point.values.values()), abs=1e-8)
                if len(branch) > 3:
                    place = len(branch) // 2
                    assert locus_error(branch, place) < 1e-10 * (1.0 + abs(branch.values[place, 0]))


@of_numbers
def test_resonant_grazing(kind, number):
    """SN and PD of an orbit with an impact leave the resonant grazing of one wall as the closed form says."""
    rng = generator(kind, number)
    gamma, restitution, wall = rng.uniform((0.01, 0.3, 0.3), (0.4, 0.95, 2.0))
    m = 2 if number == 0 else int(rng.integers(1, 4))
    with mpmath.workdps(40):
        omega, *coefficients = resonance(gamma, restitution, wall, m)
        amplitude = closed.grazing(gamma, omega, wall)
    scene = jv.make_scene(1e-3, 0.95 * float(omega), gamma, restitution, (None, wall))
    branch = jv.follow(jv.find_orbit(scene, jv.State(0.0, 0.0)), "amplitude", (0.0, 30.0), stop="GR")
    bounds = {"amplitude": (0.0, 30.0), "frequency": (0.9 * float(omega), 1.1 * float(omega))}
    locus = jv.locus(branch.points("GR")[0], tuple(bounds), bounds)
    for place in range(0, len(locus), 5):
        with mpmath.workdps(30):
            assert abs(float(closed.grazing(gamma, locus.values[place, 1], wall)) - locus.values[place, 0]) < 1e-11
    (point,) = locus.points("RG")
    assert point.values == pytest.approx({"amplitude": float(amplitude), "frequency": float(omega)}, abs=1e-9)
    beside = {}
    for gap in (1e-4, 1e-5):
        low, high = (point.values["frequency"] + way * gap for way in (-1.0, 1.0))
        for curve in jv.switch(point, bounds | {"frequency": (low, high)}, first_step=1e-3):
            assert curve.special[0].values == pytest.approx(point.values, abs=1e-9)
            assert abs(curve.data["least_speed"][0]) < 1e-11 and curve.data["least_speed"][1:].min() > 0
            assert curve.reasons[0].startswith("it left RG at amplitude ")
            beside.setdefault(curve.kind, []).append((gap, *curve.values[-1]))
    assert sorted(beside) == ["PD", "SN"]
    for name, coefficient in zip(("SN", "PD"), coefficients, strict=True):
        with mpmath.workdps(30):
            away = [float(value - closed.grazing(gamma, edge, wall)) for _, value, edge in beside[name]]
        shares = [far / gap**2 / float(coefficient) for far, (gap, *_) in zip(away, beside[name], strict=True)]
        assert abs((10.0 * shares[1] - shares[0]) / 9.0 - 1.0) < 1e-3
