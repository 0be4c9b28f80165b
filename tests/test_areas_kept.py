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


@pytest.mark.slow
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
