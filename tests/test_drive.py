"""Drives of several terms and constant forces: a branch, a fit, starts, symmetry, parameters and files.

`tests/properties` compare their flights, derivatives and free responses with references (the kind drive_terms).
"""

import math

import numpy as np
import pytest

import jaxvibro as jv
from jaxvibro.maps.initial_conditions import initial_box
from jaxvibro.scene.scene_properties import is_symmetric

OMEGA, GAMMA, R = 2.1, 0.05, 0.7
TERMS = [(0.5, 3, 0.625), (0.25, 0, 0.0), (-0.375, 1, 0.5)]


def driven(*terms, walls=(-1.0, 1.0)):
    """Return a scene whose drive has terms of the harmonics 3, 0 and 1, so that all of them compile once."""
    given = {harmonic: (size, harmonic, phase) for size, harmonic, phase in terms}
    drive = [given.get(harmonic, (0.0, harmonic, 0.0)) for harmonic in (3, 0, 1)]
    walls = tuple(None if place is None else jv.Wall(place, R) for place in walls)
    return jv.make_scene(2.0, OMEGA, GAMMA, R, walls, drive=drive)


def test_a_branch_along_a_term_is_found_by_its_file_and_again_from_its_point(tmp_path):
    scene = jv.make_scene(2.0, OMEGA, GAMMA, R, (-1.0, 1.0), drive=[(0.3, 2, 0.5)])
    branch = jv.follow(jv.find_orbit(scene, jv.State(0.9, -1.1), settle=300), "drive.0.amplitude", bounds=(0.0, 3.0))
    point = next(one for one in branch.special if one.kind in ("SN", "PD"))
    there, spot = scene.replace(**{"drive.0.amplitude": point.value}), point.spot
    state = jv.State(spot.x, spot.v)
    end, _ = jv.strobe(there, state, spot.periods)
    assert abs(end.x - spot.x) + abs(end.v - spot.v) < 1e-8
    multipliers = np.linalg.eigvals(jv.monodromy(there, state, spot.periods))
    assert abs(multipliers - (1.0 if point.kind == "SN" else -1.0)).min() < 1e-5
    branch.save(tmp_path / "branch.nc")
    again = jv.load_branch(tmp_path / "branch.nc")
    assert np.array_equal(again.values, branch.values) and again.scene.drive[0].harmonic == 2
    assert abs(float(jv.located(point)(there)) - point.value) < 1e-10


def test_a_fit_finds_the_numbers_of_terms():
    scene = driven(*TERMS)
    _, hits = jv.strobe(scene, jv.State(0.3, 1.5), periods=12, slots=60)
    count = int(hits.count)
    record = jv.ImpactRecord(np.asarray(hits.time)[:count], np.asarray(hits.side)[:count], 1e-9)
    off = scene.replace(**{"drive.0.amplitude": 0.51, "drive.1.amplitude": 0.245})
    found = jv.fit(off, record, {"drive.0.amplitude": 0.05, "drive.1.amplitude": 0.05})
    there = found.scene
    assert count > 12
    assert abs(float(there.drive[0].amplitude) - 0.5) < 1e-7 and abs(float(there.drive[1].amplitude) - 0.25) < 1e-7


def test_the_box_of_starts_knows_every_term():
    terms = [(2.0, 1), (0.5, 3), (2.5, 0), (-0.375, 1)]
    scene = driven(*((size, n, 0.5 * n) for size, n in terms[1:]), walls=(None, None))
    sizes = [abs(size) / abs(1 - (n * OMEGA) ** 2 + 2j * GAMMA * n * OMEGA) for size, n in terms]
    paces = [size * n * OMEGA for size, (_, n) in zip(sizes, terms, strict=True)]
    expected = -2 * sum(sizes), 2 * sum(sizes), 3 * sum(paces)
    np.testing.assert_allclose(initial_box(scene), expected, rtol=1e-13)


def test_odd_forces_and_harmonics_are_symmetric():
    cubic, square = (jv.Force("polynomial", {"c1": 1.0, "damping": 0.1, power: 0.3}) for power in ("c3", "c2"))
    for scene, symmetric in (
        (driven((0.5, 3, 0.2), (0.1, 1, 0.3)), True),
        (driven((0.5, 0, 0.0)), False),
        (jv.make_scene(2.0, OMEGA, restitution=R, walls=(-1.0, 1.0), force=cubic), True),
        (jv.make_scene(2.0, OMEGA, restitution=R, walls=(-1.0, 1.0), force=square), False),
    ):
        assert is_symmetric(scene) == symmetric


def test_numbers_of_the_terms_are_parameters_by_name():
    scene = driven(*TERMS)
    new = scene.replace(**{"drive.2.amplitude": np.array([1.0, 2.0]), "drive.0.phase": 0.1})
    assert new.shape == (2,) and float(new.drive[0].phase) == 0.1 and new.drive[0].harmonic == 3
    data = jv.sweep(scene, "amplitude", [2.0], jv.State(0.0, 0.0), settle=1, keep=1)
    assert "drive.0.harmonic" in data.attrs and "cos(3 frequency t + drive.0.phase)" in data.attrs["equation"]


@pytest.mark.parametrize(
    ("drive", "key"),
    [
        ((0.4, 3, 0.5), "drive.0"),
        ([(0.4, 3)], "drive.0"),
        (0.4, "drive"),
        ([(0.4, -1, 0.0)], "drive.0.harmonic"),
        ([(0.4, 2.5, 0.0)], "drive.0.harmonic"),
        ([(0.4, 1001, 0.0)], "drive.0.harmonic"),
        ([(0.4, 1, 0.0), (math.nan, 1, 0.0)], "drive.1.amplitude"),
        ([(0.4, 1, "0")], "drive.0.phase"),
        ([(0.4, 1, 0.0)] * 33, "drive"),
        ([([0.4, 0.5], 1, 0.0)], "drive.0.amplitude"),
    ],
)
def test_a_drive_that_breaks_a_rule_is_refused(drive, key):
    with pytest.raises(jv.SceneError) as caught:
        jv.make_scene(2.0, OMEGA, GAMMA, R, (-1.0, 1.0), drive=drive)
    assert caught.value.key == key and len(str(caught.value)) <= 300


def test_a_scene_file_with_a_wrong_term_is_refused(tmp_path):
    path = tmp_path / "scene.toml"
    path.write_text(
        "[scene]\namplitude = 2.0\nfrequency = 2.1\ndamping = 0.05\nrestitution = 0.7\n"
        "[[scene.drive]]\namplitude = 0.4\nharmonic = 3\n[scene.left]\nposition = -1.0\n"
    )
    assert float(jv.load_scene(path).drive[0].phase) == 0.0
    for wrong, key in (("harmonic = -3", "scene.drive.0.harmonic"), ("harmonc = 3", "scene.drive[0].harmonc")):
        other = tmp_path / "wrong.toml"
        other.write_text(path.read_text().replace("harmonic = 3", wrong))
        with pytest.raises(jv.SceneError) as caught:
            jv.load_scene(other)
        assert caught.value.key == key
