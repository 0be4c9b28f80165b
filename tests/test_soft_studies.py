"""Soft walls in every study: exponents, sections, basins, manifolds, the way back, grazings from within."""

import jax
import numpy as np
import pytest

import jaxvibro as jv
from jaxvibro.maps.strobe_inverse import require_reversible, strobe_backward
from jaxvibro.problem.end import End
from tests.graze_within_proof import branch_of, drawn, held, within
from tests.plane_curves import bisected, distance
from tests.reference.soft_lanes import Lanes, Wall, exponents

GAMMA = 0.045
CHAOTIC = (jv.Wall(0.28, stiffness=10.0, damping=0.1), Wall(1, 0.28, None, 10.0, 0.1))
MIXED = (jv.Wall(-0.9, stiffness=10.0, damping=0.2, motion=jv.Motion(0.1, 0.4, 2)), jv.Wall(1.0, 0.6))
TWO = tuple(jv.Wall(place, stiffness=10.0, damping=0.3) for place in (-1.0, 1.0))
BACK = jax.jit(lambda scene, state: strobe_backward(scene, state, 16))


def lanes(scene, walls, x, v):
    return Lanes(float(scene.amplitude), float(scene.frequency), float(scene.damping), walls, x, v)


def pull(t, x, v, p):
    return -x - 0.1 * v


def test_the_reference_agrees_with_the_strobe():
    scene = jv.make_scene(2.0, 1.7, 0.1, 0.7, MIXED)
    walls = [Wall(-1, -0.9, None, 10.0, 0.2, 0.1, 2, 0.4), Wall(1, 1.0, 0.6)]
    rng = np.random.default_rng(0)
    x, v = rng.uniform(-1.2, 0.9, 16), rng.normal(size=16)
    one = lanes(scene, walls, x, v)
    one.period()
    end, _ = jv.strobe(scene, jv.State(x, v))
    assert np.abs(one.x - end.x).max() < 1e-12 and np.abs(one.v - end.v).max() < 1e-12
    true = np.moveaxis(one.tangents, 2, 0).transpose(0, 2, 1)
    assert np.abs(true - np.asarray(jv.monodromy(scene, jv.State(x, v)))).max() < 1e-9


def test_exponents_of_chaos_against_another_method_and_their_sum():
    wall, other = CHAOTIC
    scene = jv.make_scene(1.0, 2.285, GAMMA, 0.7, (None, wall))
    found = jv.spectrum(scene, "amplitude", [1.0], jv.State(0.18, 0.3), error=0.01)
    rng = np.random.default_rng(1)
    x, v = np.full(128, 0.18), 0.3 + 1e-7 * rng.normal(size=128)
    rates, hits, spent = exponents(lanes(scene, [other], x, v), 150, 200)
    errors = np.maximum(rates.std(axis=0, ddof=1) / 128**0.5, 1 / 150)
    assert found.exponent[0, 0] > 0.05
    assert (abs(found.exponent[0] - rates.mean(axis=0)) < 4 * np.hypot(found.error[0], errors)).all()
    assert abs(found.within[0, 1] - spent[1].mean()) < 0.01 and abs(found.impacts[0] - hits[1].mean()) < 0.02
    total = -2 * GAMMA * 2 * np.pi / 2.285 - 2 * (0.1 - GAMMA) * found.within[0, 1]
    assert abs(found.exponent[0].sum() - total) < 1e-12


def test_exponents_of_an_orbit_between_a_soft_wall_and_a_rigid_one():
    scene = jv.make_scene(2.0, 2.1, 0.05, 0.7, MIXED)
    found = jv.spectrum(scene, "amplitude", [2.0], jv.State(0.5, -1.1))
    state = jv.strobe(scene, jv.State(0.5, -1.1), 600)[0]
    orbit = jv.find_orbit(scene, state)
    true = np.sort(np.log(abs(orbit.multipliers)) / orbit.periods)[::-1]
    assert found.periods[0] == orbit.periods and abs(found.exponent[0] - true).max() < 1e-10
    total = -0.1 * 2 * np.pi / 2.1 - 2 * 0.15 * found.within[0, 0] + 2 * np.log(0.6) * found.impacts_on[0, 1]
    assert abs(found.exponent[0].sum() - total) < 1e-12


def test_sections_of_soft_walls_and_the_maps_between_their_points():
    """At a soft wall a point is an entry: the map leads from each to the next, through the stay."""
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


WALLS = {
    "soft": TWO,
    "stiff": tuple(jv.Wall(place, stiffness=1e8, damping=1100.0) for place in (-1.0, 1.0)),
    "moving": MIXED,
}


NAMES = [pytest.param(name, marks=pytest.mark.long) for name in ("soft", "stiff", "moving")]


@pytest.mark.parametrize("name", NAMES)
def test_the_way_back_is_the_inverse(name):
    """Also of states that are within a soft wall, and where the way goes through some."""
    scene, rng = jv.make_scene(2.0, 1.6, 0.05, 0.7, WALLS[name]), np.random.default_rng(0)
    deep = 0.3 if name == "soft" else 0.0
    given = np.stack([rng.uniform(-0.8 - deep, 0.98 + deep, 200), rng.normal(size=200)])
    before, impacts = BACK(scene, jv.State(*given, 0.3))
    good = (np.asarray(impacts.status) < 2) & (abs(np.asarray(before.v)) < 1e3)
    start = jv.State(np.asarray(before.x)[good], np.asarray(before.v)[good], 0.3)
    end, forward = jv.strobe(scene, start)
    error = np.hypot(end.x - given[0, good], end.v - given[1, good])
    stretch = abs(np.asarray(jv.monodromy(scene, start))).max(axis=(1, 2))
    assert good.mean() > (0.9 if name == "soft" else 0.2) and np.asarray(forward.count).max() > 0
    assert (error <= 1e-13 * np.maximum(1.0, stretch * np.maximum(1.0, abs(start.v)))).all()


def test_the_way_back_through_laws_of_contact():
    laws = jv.Push("hunt_crossley", {"stiffness": 30.0, "dissipation": 0.1}), jv.Push("hertz", {"stiffness": 20.0})
    walls = tuple(jv.Wall(place, law=law) for place, law in zip((-1.0, 1.0), laws, strict=True))
    scene, rng = jv.make_scene(1.0, 1.6, force=jv.Force(pull), restitution=0.7, walls=walls), np.random.default_rng(0)
    given = np.stack([rng.uniform(-1.2, 1.2, 64), rng.normal(size=64)])
    before, impacts = BACK(scene, jv.State(*given, 0.3))
    end, _ = jv.strobe(scene, jv.State(before.x, before.v, 0.3))
    assert (np.asarray(impacts.status) < 2).all()
    assert np.hypot(end.x - given[0], end.v - given[1]).max() < 1e-11


def test_a_soft_wall_that_takes_all_speed_has_no_way_back():
    scene = jv.make_scene(1.0, 2.0, 0.1, 0.7, (None, jv.Wall(1.0, stiffness=3.0, damping=2.0)))
    with pytest.raises(jv.ArgumentError, match=r"^right.damping: must be less than critical"):
        require_reversible(scene)


def test_basins_and_their_boundary():
    """Labels against the reference, starts within walls among them; the boundary by bisection lies on the manifold."""
    scene = jv.make_scene(1.0, 1.6, 0.05, 0.7, TWO)
    attractors = jv.find_attractors(scene, starts=20)
    x, v = np.linspace(-1.5, 1.5, 31), np.linspace(-3.0, 3.0, 30)
    data = jv.basins(scene, x, v, 0.0, attractors)
    label = data["label"].values
    assert (label >= 0).all() and min(data["fraction"].values) > 0.1
    across, along = (each.ravel() for each in np.meshgrid(x, v))
    one = lanes(scene, [Wall(side, float(side), None, 10.0, 0.3) for side in (-1, 1)], across, along)
    for _ in range(150):
        one.period()
    points = np.stack([data["point_x"].values[:, 0], data["point_v"].values[:, 0]], -1)
    apart = abs(np.stack([one.x, one.v], -1)[:, None] - points).max(axis=-1)
    assert apart.min(axis=1).max() < 1e-6 and (apart.argmin(axis=1) == label.ravel()).all()
    saddle = next(each for each in jv.find_orbits(scene, 1, 64) if abs(each.multipliers[0]) > 1)
    curve = jv.manifold(saddle, "stable", 12.0, 0.0)
    row, column = next((i, j) for i, j in np.argwhere(label[1:] != label[:-1]) if abs(x[j]) > 1.05)
    place = bisected(scene, attractors, (x[column], v[row]), (x[column], v[row + 1]))
    assert distance(curve, place[None])[0] < 1e-6


def test_manifolds_of_stiff_walls_are_those_of_rigid_ones():
    rigid = jv.make_scene(4.65, 2.1, 0.05, 0.7, (-1.0, 1.0))
    curves = []
    for scene in (rigid, jv.soften(rigid, 1e8)):
        orbit = next(one for one in jv.find_orbits(scene, 1, 64) if one.label == "P111" and one.multipliers[0].real > 1)
        curves.append(jv.manifold(orbit, "stable", 4.0, 0.0))
    hard, soft = curves
    z = np.stack([soft["x"].values, soft["v"].values], -1)
    free = abs(z[:, 0]) < 0.9999
    assert distance(hard, z[free][::40]).max() < 5e-3


def test_a_branch_goes_on_where_contacts_split_and_join():
    scene, other = drawn(3)
    branch = branch_of(scene)
    assert branch.ends == (End.BOUND, End.BOUND)
    found = list(within(branch))
    assert len(found) == 1
    off = held(branch, scene, other, *found[0])
    assert off[0] < 1e-10 and max(off[1:]) < 1e-10
    (point,) = branch.points("GR")
    last = branch.data["segment"].values.searchsorted(1)
    before, after = (branch.multipliers[k] for k in (last - 1, last))
    assert abs(np.sort_complex(before) - np.sort_complex(after)).max() < 1e-5 and point.normal_form is None
