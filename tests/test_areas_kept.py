"""Branches of scenes that lose nothing: multipliers on the unit circle, and where they are roots of 1."""

import numpy as np
import pytest

import jaxvibro as jv

KEPT = {"damping": 0.0, "restitution": 1.0}


def test_resonances_of_the_motion_without_impacts():
    scene = jv.make_scene(0.1, 2.5, walls=(None, 1.0), **KEPT)
    branch = jv.follow(jv.find_orbit(scene, jv.State(-0.1 / 5.25, 0.0), settle=0), "frequency", (2.5, 4.5))
    assert [one.kind for one in branch.special] == ["EP", "R3", "R4", "EP"]  # multipliers exp(+-2 pi i / omega)
    assert [one.value for one in branch.special] == pytest.approx([2.5, 3.0, 4.0, 4.5], abs=1e-10)


def test_resonances_of_orbits_with_impacts():
    scene = jv.make_scene(1.5, 2.7, walls=(None, 0.5), **KEPT)
    found = next(
        one for one in jv.find_orbits(scene, max_period=2) if one.label == "P201" and one.multipliers[0].real < 0
    )
    branch = jv.follow(found, "frequency", (2.6, 3.6))
    (doubling,), (third,), (fourth,) = (branch.points(kind) for kind in ("PD", "R3", "R4"))
    assert doubling.value < third.value < fourth.value
    for point, trace in ((third, -1.0), (fourth, 0.0)):
        matrix = np.asarray(jv.monodromy(point.scene, point.orbit.state, 2))
        assert np.trace(matrix) == pytest.approx(trace, abs=1e-9)
        assert np.linalg.det(matrix) == pytest.approx(1.0, abs=1e-12)


def test_with_losses_there_are_none():
    scene = jv.make_scene(0.1, 2.5, damping=0.01, restitution=1.0, walls=(None, 1.0))
    branch = jv.follow(jv.find_orbit(scene, jv.State(0.0, 0.0)), "frequency", (2.5, 4.5))
    assert [one.kind for one in branch.special] == ["EP", "EP"]


@pytest.fixture(scope="module")
def elliptic():
    scene = jv.make_scene(1.5, 3.2, walls=(None, 0.5), **KEPT)
    (orbit,) = (one for one in jv.find_orbits(scene, max_period=2) if one.label == "P201" and one.multipliers[0].imag)
    return orbit


def test_the_twist_is_what_rotation_numbers_say(elliptic):
    told = jv.twist(elliptic)
    angle = abs(np.angle(elliptic.multipliers[0]))
    middle = np.array([float(elliptic.state.x), float(elliptic.state.v)])
    matrix = np.asarray(jv.monodromy(elliptic.scene, elliptic.state, 2))
    roots, vectors = np.linalg.eig(matrix)
    frame = vectors[:, roots.imag > 0][:, 0]
    plane = np.stack([frame.real, -frame.imag], 1)  # z q + its conjugate, halved, is this matrix times (re z, im z)
    count, away = 1024, 2e-3
    turned = []
    start = middle + plane @ [away, 0.0]
    state = jv.State(*start, elliptic.state.phase)
    for _ in range(count):
        turned.append(np.linalg.solve(plane, np.array([float(state.x), float(state.v)]) - middle))
        state, _ = jv.strobe(elliptic.scene, state, 2, 0)
    z = np.array(turned) @ [1.0, 1.0j]
    late = (np.arange(count - 1) + 1.0) / count
    weight = np.exp(-1.0 / (late * (1.0 - late)))  # of a mean that converges fast
    weight /= weight.sum()
    off = np.angle(z[1:] / z[:-1] * np.exp(-1.0j * angle))
    action = abs(np.linalg.det(plane)) * np.sum(weight * abs(z[1:]) ** 2) / 2.0
    assert np.sum(weight * off) / action == pytest.approx(told, rel=1e-5)


def test_a_motion_without_impacts_has_no_twist():
    free = jv.find_orbit(jv.make_scene(0.1, 2.5, walls=(None, 1.0), **KEPT), jv.State(-0.1 / 5.25, 0.0), settle=0)
    assert jv.twist(free) == pytest.approx(0.0, abs=1e-14)


def test_the_twist_of_what_loses_areas_is_refused():
    scene = jv.make_scene(0.1, 2.5, damping=0.01, restitution=1.0, walls=(None, 1.0))
    with pytest.raises(jv.ArgumentError, match="orbit: must be elliptic"):
        jv.twist(jv.find_orbit(scene, jv.State(0.0, 0.0)))
