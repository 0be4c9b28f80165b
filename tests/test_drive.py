"""Drives of several terms and constant forces: closed forms, derivatives, a branch, a fit, parameters and files."""

import cmath
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxvibro as jv
from jaxvibro.maps.initial_conditions import forced_amplitude, initial_box
from jaxvibro.scene.symmetry import is_symmetric, stays_symmetric, symmetrise_scene
from tests.reference import orbit
from tests.reference.scene import Scene, Term, Wall

OMEGA, GAMMA, R = 2.1, 0.05, 0.7
TERMS = [(0.5, 3, 0.625), (0.25, 0, 0.0), (-0.375, 1, 0.5)]
NAMES = [f"drive.{k}.{name}" for k in range(3) for name in ("amplitude", "phase")]


def driven(*terms, walls=(-1.0, 1.0)):
    """Return a scene whose drive has terms of the harmonics 3, 0 and 1, so that all of them compile once."""
    given = {harmonic: (size, harmonic, phase) for size, harmonic, phase in terms}
    drive = [given.get(harmonic, (0.0, harmonic, 0.0)) for harmonic in (3, 0, 1)]
    walls = tuple(None if place is None else jv.Wall(place, R) for place in walls)
    return jv.make_scene(2.0, OMEGA, GAMMA, R, walls, drive=drive)


def test_the_free_response_is_the_sum_of_the_responses_to_all_terms():
    scene = driven(*TERMS, walls=(None, None))
    orbit = jv.find_orbit(scene, jv.State(0.0, 0.0))
    x = v = 0.0
    for size, n, phase in [(2.0, 1, 0.0), *TERMS]:
        rate = n * OMEGA
        response = size * cmath.exp(1j * phase) / (1 - rate**2 + 2j * GAMMA * rate)
        x, v = x + response.real, v + (1j * rate * response).real
    assert abs(orbit.state.x - x) < 1e-12 and abs(orbit.state.v - v) < 1e-12


def _differences(scene, name, start):
    """d(x, v) by a number of a term, by two differences of ball arithmetic."""
    _, place, own = name.split(".")

    def end(change):
        term = scene.drive[int(place)]
        moved = term._replace(**{own: getattr(term, own) + change})
        drive = tuple(moved if k == int(place) else each for k, each in enumerate(scene.drive))
        record = orbit.strobe(scene._replace(drive=drive), *start)
        return np.array([record.x, record.v])

    h = 2.0**-18
    single, double = ((end(step) - end(-step)) / (2 * step) for step in (h, 2 * h))
    return np.array([float(one) for one in (4 * single - double) / 3])


def test_derivatives_by_each_term_against_ball_arithmetic():
    terms = tuple(Term(*term) for term in TERMS)
    reference = Scene(GAMMA, OMEGA, 2.0, Wall(-1.0, R), Wall(1.0, R), terms)
    scene, state = driven(*TERMS), jv.State(0.3, 1.5)
    values = [float(scene.parameter(name)) for name in NAMES]

    def end(values):
        found, _ = jv.strobe(scene.replace(**dict(zip(NAMES, values, strict=True))), state)
        return jnp.stack([found.x, found.v])

    forward = np.asarray(jax.jacfwd(end)(jnp.array(values)))
    backwards = np.asarray(jax.jacrev(end)(jnp.array(values)))
    true = np.stack([_differences(reference, name, (0.3, 1.5)) for name in NAMES], 1)
    assert int(jv.strobe(scene, state)[1].count) > 0 and abs(true).max() > 0.1
    assert abs(forward - true).max() < 1e-11 and abs(backwards - forward).max() < 1e-12


def test_a_branch_along_a_term_has_the_points_that_the_strobe_has(tmp_path):
    scene = jv.make_scene(2.0, OMEGA, GAMMA, R, (-1.0, 1.0), drive=[(0.3, 2, 0.5)])
    branch = jv.follow(jv.find_orbit(scene, jv.State(0.9, -1.1), settle=300), "drive.0.amplitude", bounds=(0.0, 3.0))
    point = next(one for one in branch.special if one.kind in ("SN", "PD"))
    there = scene.replace(**{"drive.0.amplitude": point.value})
    x, v = point.spot.x, point.spot.v

    def end(x, v):
        found = jv.State(x, v)
        for _ in range(point.spot.periods):
            found, _ = jv.strobe(there, jv.State(found.x, found.v))
        return jnp.stack([found.x, found.v])

    by = np.stack(jax.jacfwd(end, (0, 1))(x, v), 1)
    assert abs(np.asarray(end(x, v)) - [x, v]).max() < 1e-8
    wanted = 1.0 if point.kind == "SN" else -1.0
    assert abs(np.linalg.eigvals(by) - wanted).min() < 1e-5
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


def test_starts_and_scales_know_every_term():
    scene = driven(*TERMS, walls=(None, None))
    sizes = [abs(size) / abs(1 - (n * OMEGA) ** 2 + 2j * GAMMA * n * OMEGA) for size, n, _ in [(2.0, 1, 0), *TERMS]]
    assert abs(forced_amplitude(scene) - sum(sizes)) < 1e-14
    paces = [size * n * OMEGA for size, (_, n, _) in zip(sizes, [(2.0, 1, 0), *TERMS], strict=True)]
    assert abs(initial_box(scene)[2] - 3 * sum(paces)) < 1e-12


def test_scenes_with_odd_forces_and_harmonics_are_symmetric():
    assert is_symmetric(driven((0.5, 3, 0.2), (0.1, 1, 0.3)))
    assert not is_symmetric(driven((0.5, 0, 0.0)))
    assert not is_symmetric(jv.make_scene(2.0, OMEGA, GAMMA, R, (-1.0, 1.0), drive=[(0.5, 2, 0.0)]))
    assert stays_symmetric(driven(), "drive.0.amplitude") and not stays_symmetric(driven(), "drive.1.amplitude")
    for powers, symmetric in (({"c3": 0.4}, True), ({"c2": 0.3}, False)):
        force = jv.Force("polynomial", {"c1": 1.0, "damping": 0.1, **powers})
        assert is_symmetric(jv.make_scene(2.0, OMEGA, restitution=R, walls=(-1.0, 1.0), force=force)) == symmetric
    part = symmetrise_scene(driven(*TERMS))
    assert is_symmetric(part) and [float(term.amplitude) for term in part.drive] == [0.5, 0.0, -0.375]


def test_numbers_of_the_terms_are_parameters_by_name():
    scene = driven(*TERMS)
    assert [name for name in scene.names if name.startswith("drive")] == NAMES
    assert float(scene.parameter("drive.0.phase")) == 0.625
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


def test_a_scene_file_has_the_terms(tmp_path):
    path = tmp_path / "scene.toml"
    path.write_text(
        "[scene]\namplitude = 2.0\nfrequency = 2.1\ndamping = 0.05\nrestitution = 0.7\n"
        "[[scene.drive]]\namplitude = 0.4\nharmonic = 3\nphase = 0.5\n"
        "[[scene.drive]]\namplitude = 0.2\nharmonic = 0\n[scene.left]\nposition = -1.0\n"
    )
    scene = jv.load_scene(path)
    assert [(float(d.amplitude), d.harmonic, float(d.phase)) for d in scene.drive] == [(0.4, 3, 0.5), (0.2, 0, 0.0)]
    jv.save_scene(scene, tmp_path / "again.toml")
    again = jv.load_scene(tmp_path / "again.toml")
    assert jax.tree.structure(again) == jax.tree.structure(scene) and jax.tree.leaves(again) == jax.tree.leaves(scene)
    for wrong, key in (("harmonic = -3", "scene.drive.0.harmonic"), ("harmonc = 3", "scene.drive[0].harmonc")):
        other = tmp_path / "wrong.toml"
        other.write_text(path.read_text().replace("harmonic = 3", wrong))
        with pytest.raises(jv.SceneError) as caught:
            jv.load_scene(other)
        assert caught.value.key == key


def test_terms_of_a_scene_in_units():
    scene = jv.scene_from_physical(2.0, 0.4, 8.0, 3.0, 4.2, R, (-0.5, 0.5), drive=[(1.0, 3, 0.5)])
    assert abs(float(scene.drive[0].amplitude) - 1.0 / (8.0 * 0.5)) < 1e-15 and scene.drive[0].harmonic == 3
