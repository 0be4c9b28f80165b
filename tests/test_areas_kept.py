"""Branches of scenes that lose nothing: multipliers on the unit circle, and where they are roots of 1."""

import numpy as np
import pytest

import jaxvibro as jv

KEPT = {"damping": 0.0, "restitution": 1.0}


def test_resonances_of_the_motion_without_impacts():
    """They are where the multipliers exp(+-2 pi i / omega) are roots of 1, and only without losses."""
    lossy, kept = (jv.make_scene(0.1, 2.5, damping, 1.0, (None, 1.0)) for damping in (0.01, 0.0))
    branch = jv.follow(jv.find_orbit(lossy, jv.State(0.0, 0.0)), "frequency", (2.5, 4.5))
    assert [one.kind for one in branch.special] == ["EP", "EP"]
    with pytest.raises(jv.ArgumentError, match="orbit: must be elliptic"):
        jv.twist(branch.orbit(0))
    free = jv.find_orbit(kept, jv.State(-0.1 / 5.25, 0.0), settle=0)
    assert jv.twist(free) == pytest.approx(0.0, abs=1e-14)
    branch = jv.follow(free, "frequency", (2.5, 4.5))
    assert [one.kind for one in branch.special] == ["EP", "R3", "R4", "EP"]
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


def test_the_twist_is_what_rotation_numbers_say():
    scene = jv.make_scene(1.5, 3.2, walls=(None, 0.5), **KEPT)
    (orbit,) = (one for one in jv.find_orbits(scene, max_period=2) if one.label == "P201" and one.multipliers[0].imag)
    middle = np.array([float(orbit.state.x), float(orbit.state.v)])
    roots, vectors = np.linalg.eig(np.asarray(jv.monodromy(scene, orbit.state, 2)))
    frame = vectors[:, roots.imag > 0][:, 0]
    plane = np.stack([frame.real, -frame.imag], 1)  # z q + its conjugate, halved, is this matrix times (re z, im z)
    count, states = 1024, []
    state = jv.State(*(middle + plane @ [2e-3, 0.0]), orbit.state.phase)
    for _ in range(count):
        states.append((float(state.x), float(state.v)))
        state, _ = jv.strobe(scene, state, 2, 0)
    z = np.linalg.solve(plane, (np.array(states) - middle).T).T @ [1.0, 1.0j]
    late = (np.arange(count - 1) + 1.0) / count
    weight = np.exp(-1.0 / (late * (1.0 - late)))  # of a mean that converges fast
    off = np.angle(z[1:] / z[:-1] * np.exp(-1.0j * abs(np.angle(orbit.multipliers[0]))))
    action = abs(np.linalg.det(plane)) * np.sum(weight * abs(z[1:]) ** 2) / 2.0
    assert np.sum(weight * off) / action == pytest.approx(jv.twist(orbit), rel=1e-5)
