"""Several harmonics of drive and constant forces: against ball arithmetic, closed forms and scenes that equal them."""

import cmath
import math
from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxvibro as jv
from jaxvibro.attractors.sweep import equation_text, non_parameter_attributes
from jaxvibro.design.impact_prediction import Impact, MotionPredictor
from jaxvibro.flight.flight_coefficients import flow_coefficients
from jaxvibro.maps.initial_conditions import forced_amplitude, initial_box
from jaxvibro.maps.strobe_inverse import strobe_backward
from jaxvibro.orbits.free_response import free_response
from jaxvibro.scene.scene_table import make_scene_table
from jaxvibro.scene.symmetry import is_symmetric, stays_symmetric, symmetrise_scene
from jaxvibro.scene.typical_scales import typical_length
from jaxvibro.studies.scene_file import parse_limited_toml, parse_tables
from tests import harmonics_proof
from tests.lanes import one_by_one
from tests.proof import SLOTS
from tests.reference import orbit, soft
from tests.reference.scene import Scene, Term, Wall

OMEGA, GAMMA, R = 2.1, 0.05, 0.7
TERMS = [(0.5, 3, 0.625), (0.25, 0, 0.0), (-0.375, 1, 0.5)]
LANES = harmonics_proof.WIDE
NAMES = [f"drive.{k}.{name}" for k in range(3) for name in ("amplitude", "phase")]


def driven(*terms, amplitude=2.0, frequency=OMEGA, walls=(-1.0, 1.0)):
    """A scene whose drive has terms of the harmonics 3, 0 and 1, so that all of them compile once."""
    given = {harmonic: (size, harmonic, phase) for size, harmonic, phase in terms}
    drive = [given.get(harmonic, (0.0, harmonic, 0.0)) for harmonic in (3, 0, 1)]
    return jv.make_scene(amplitude, frequency, GAMMA, R, rigid(walls), drive=drive)


def plain(walls=(-1.0, 1.0)):
    return jv.make_scene(2.0, OMEGA, GAMMA, R, rigid(walls))


def rigid(walls):
    return tuple(None if place is None else jv.Wall(place, R) for place in walls)


def starts(seed=0, phase=0.0):
    rng = np.random.default_rng(seed)
    return jv.State(rng.uniform(-0.7, 0.7, LANES), rng.normal(0, 2, LANES), np.full(LANES, phase))


def told(scene, state):
    """The strobe, as `harmonics_proof` asks for it, so that it is compiled for once."""
    lanes = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (LANES,)), scene)
    lanes = replace(lanes, restitution=scene.restitution)
    given = jv.State(state.x, state.v, state.phase)
    return jax.tree.map(np.asarray, jv.strobe(lanes, given, slots=SLOTS, clearance=True))


def near(one, other, slack):
    """Ends and impacts of two strobes are the same."""
    (end, hits), (its, theirs) = one, other
    assert np.array_equal(hits.side, theirs.side) and hits.count.sum() > LANES / 2
    assert max(abs(end.x - its.x).max(), abs(end.v - its.v).max()) < slack
    full = hits.side != 0
    assert abs(hits.time[full] - theirs.time[full]).max() < slack
    assert abs(hits.speed[full] - theirs.speed[full]).max() < slack


# ---- the flow ----------------------------------------------------------------------------------------------------


def test_random_scenes_against_ball_arithmetic():
    kinds = len(harmonics_proof.KINDS)
    members = [harmonics_proof.referred(seed) for seed in range(0, 60 * kinds, kinds)]
    members = [(drawn, record) for _, drawn, record in members if not isinstance(record, str)][:LANES]
    assert len(members) == LANES
    rows = harmonics_proof.rows(members, partial(one_by_one, harmonics_proof.measured))
    assert all(row.right for row in rows) and sum(row.count for row in rows) > LANES / 2
    assert max(row.state for row in rows) < 0.01 and max(row.speeds for row in rows) < 0.01
    assert max(row.clearance for row in rows) < 0.01


@pytest.mark.parametrize("place", [5, 9])
def test_moving_and_soft_walls_against_ball_arithmetic(place):
    kinds = len(harmonics_proof.KINDS)
    members = [harmonics_proof.referred(seed) for seed in range(place, place + 30 * kinds, kinds)]
    members = [(drawn, record) for _, drawn, record in members if not isinstance(record, str)]
    rows = harmonics_proof.rows(members)
    assert len(rows) > 8 and all(row.right for row in rows) and sum(row.count for row in rows) > 8
    assert max(row.state for row in rows) < 1 and max(row.speeds for row in rows) < 1


def test_a_term_of_the_first_harmonic_is_the_drive_itself():
    state = starts()
    near(told(driven((2.0, 1, 0.0), amplitude=0.0), state), told(driven(), state), 1e-13)


def test_terms_without_amplitude_are_a_scene_without_them():
    state = starts(3)
    near(told(driven((2.0, 1, 0.0), amplitude=0.0), state), told(plain(), state), 1e-13)
    near(told(driven(), state), told(plain(), state), 1e-13)


def test_a_constant_force_shifts_the_walls_and_the_motion():
    state, force = starts(), 0.25
    end, hits = told(driven(walls=(-1.0 - force, 1.0 - force)), replace(state, x=state.x - force))
    near(told(driven((force, 0, 0.0)), state), (replace(end, x=end.x + force), hits), 1e-13)


def test_a_mass_that_a_constant_force_holds_to_a_wall_rests_and_is_released():
    """By drives that grow, some of which let it go: the press changes its sign."""
    force, strength = 1.75, np.linspace(0.1, 3.0, LANES)
    state = jv.State(np.full(LANES, 1.0), np.zeros(LANES), np.full(LANES, 0.5))
    scene = driven((force, 0, 0.0)).replace(amplitude=strength)
    end, _ = told(scene, state)
    walls = plain(walls=(-1.0 - force, 1.0 - force)).replace(amplitude=strength)
    its, _ = told(walls, replace(state, x=state.x - force))
    assert np.array_equal(end.contact, its.contact) and {0.0, 2.0} <= set(end.contact.tolist())
    assert max(abs(end.x - its.x - force).max(), abs(end.v - its.v).max()) < 1e-12


def test_a_third_harmonic_alone_is_a_scene_of_three_times_the_frequency():
    state, scene, end, count = starts(), driven(frequency=3 * OMEGA), starts(phase=0.625), 0
    for _ in range(3):
        end, hits = told(scene, end)
        count = count + hits.count
    found, hits = told(driven((2.0, 3, 0.625), amplitude=0.0), state)
    assert np.array_equal(hits.count, count) and count.sum() > LANES / 2
    assert max(abs(found.x - end.x).max(), abs(found.v - end.v).max()) < 1e-12


def steady(scene, t):
    """x of the motion that meets no wall, phase 0 at time 0."""
    total, gamma, omega = 0.0, float(scene.damping), float(scene.frequency)
    for size, n, phase in [(scene.amplitude, 1, 0.0), *((d.amplitude, d.harmonic, d.phase) for d in scene.drive)]:
        rate = n * omega
        total += float(size) * cmath.exp(1j * (rate * t + float(phase))) / (1 - rate**2 + 2j * gamma * rate)
    return total.real


def test_the_free_response_is_the_sum_of_those_to_each_term():
    scene = driven(*TERMS, walls=(None, None))
    found, h = free_response(scene), 1e-3
    slope = (8 * (steady(scene, h) - steady(scene, -h)) - steady(scene, 2 * h) + steady(scene, -2 * h)) / (12 * h)
    assert abs(found.x - steady(scene, 0.0)) < 1e-14 and abs(found.v - slope) < 1e-10


# ---- derivatives -------------------------------------------------------------------------------------------------


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


def test_the_product_of_p_and_q_is_the_derivative():
    scene, state = driven(*TERMS), jv.State(0.3, 1.5)

    def end(x, v):
        found, _ = jv.strobe(scene, jv.State(x, v))
        return jnp.stack([found.x, found.v])

    by = np.stack(jax.jacfwd(end, (0, 1))(0.3, 1.5), 1)
    assert abs(np.asarray(jv.monodromy(scene, state)) - by).max() < 1e-12 * abs(by).max()


def test_the_way_back_leads_back():
    scene, state = driven(*TERMS), starts(1)
    end, hits = jv.strobe(scene, state)
    back, _ = jax.jit(strobe_backward, static_argnums=2)(scene, end, 1)
    assert int(np.sum(hits.count)) > LANES / 2
    assert max(abs(np.asarray(back.x) - state.x).max(), abs(np.asarray(back.v) - state.v).max()) < 1e-11


# ---- beside a force of one's own ---------------------------------------------------------------------------------


def spring(t, x, v, p):
    return -x - 2.0 * p["damping"] * v


def test_beside_a_force_that_is_the_spring_it_is_the_same():
    scene, state = driven(*TERMS), starts(2)
    force = jv.Force(spring, {"damping": GAMMA})
    drive = list(scene.drive)
    own = jv.make_scene(2.0, OMEGA, restitution=R, walls=rigid((-1.0, 1.0)), force=force, drive=drive)
    near(told(own, state), told(scene, state), 1e-10)


# ---- orbits and branches -----------------------------------------------------------------------------------------


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


# ---- other ways through the same flow ----------------------------------------------------------------------------


def test_searched_impacts_are_those_of_ball_arithmetic():
    """`first_return`, by which fits look for impacts, rigid and soft."""
    terms = tuple(Term(*term) for term in TERMS)
    rigid = Scene(GAMMA, OMEGA, 2.0, Wall(-1.0, R), Wall(1.0, R), terms)
    record = orbit.strobe(rigid, 0.3, 2.5, periods=3)
    times, sides = [float(time) for time in record.times], record.sides
    first = Impact(float(sides[0]), times[0], float(record.speeds[0]))
    found = MotionPredictor(driven(*TERMS), 0.0).next_impacts(first, times[-1] + 1e-6, len(times))
    assert [one.side for one in found] == sides[1:] and len(found) > 2
    assert max(abs(one.time - time) for one, time in zip(found, times[1:], strict=True)) < 1e-9


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
    assert typical_length(scene) > typical_length(plain(walls=(None, None)))
    assert float(flow_coefficients(driven(*TERMS)).length_scale) == 2.0 + 2.0 + 0.5 + 0.25 + 0.375


def test_only_odd_harmonics_are_mirrored():
    assert is_symmetric(driven((0.5, 3, 0.2), (0.1, 1, 0.3)))
    assert not is_symmetric(driven((0.5, 0, 0.0)))
    assert not is_symmetric(jv.make_scene(2.0, OMEGA, GAMMA, R, (-1.0, 1.0), drive=[(0.5, 2, 0.0)]))
    assert stays_symmetric(driven(), "drive.0.amplitude") and not stays_symmetric(driven(), "drive.1.amplitude")
    part = symmetrise_scene(driven(*TERMS))
    assert is_symmetric(part) and [float(term.amplitude) for term in part.drive] == [0.5, 0.0, -0.375]


# ---- scenes ------------------------------------------------------------------------------------------------------


def test_numbers_of_the_terms_are_parameters_by_name():
    scene = driven(*TERMS)
    assert [name for name in scene.names if name.startswith("drive")] == NAMES
    assert float(scene.parameter("drive.0.phase")) == 0.625
    new = scene.replace(**{"drive.2.amplitude": np.array([1.0, 2.0]), "drive.0.phase": 0.1})
    assert new.shape == (2,) and float(new.drive[0].phase) == 0.1 and new.drive[0].harmonic == 3
    assert "drive.0.harmonic" in non_parameter_attributes(
        scene
    ) and "cos(3 frequency t + drive.0.phase)" in equation_text(scene)
    assert plain().drive == () and equation_text(plain()).endswith("(y- - v)") is equation_text(scene).endswith(
        "(y- - v)"
    )


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
    again = make_scene_table(scene).make()
    assert jax.tree.structure(again) == jax.tree.structure(scene) and jax.tree.leaves(again) == jax.tree.leaves(scene)
    for wrong, key in (("harmonic = -3", "scene.drive.0.harmonic"), ("harmonc = 3", "scene.drive[0].harmonc")):
        with pytest.raises(jv.SceneError) as caught:
            parse_tables(parse_limited_toml("scene", path.read_text().replace("harmonic = 3", wrong)))
        assert caught.value.key == key


def test_terms_of_a_scene_in_units():
    scene = jv.scene_from_physical(2.0, 0.4, 8.0, 3.0, 4.2, R, (-0.5, 0.5), drive=[(1.0, 3, 0.5)])
    assert abs(float(scene.drive[0].amplitude) - 1.0 / (8.0 * 0.5)) < 1e-15 and scene.drive[0].harmonic == 3


def test_a_soft_scene_of_several_terms_is_that_of_ball_arithmetic_in_its_derivative():
    place = 8
    kinds = len(harmonics_proof.KINDS)
    for seed in range(place, place + 60 * kinds, kinds):
        _, drawn, record = harmonics_proof.referred(seed)
        if not isinstance(record, str) and record["sides"]:
            break
    true = soft.strobe(*drawn)
    scene, start = harmonics_proof.batch([drawn])
    found = np.asarray(jv.monodromy(scene, start))[0]
    rows = np.array([[float(entry) for entry in row] for row in true.jacobian])
    assert abs(found - rows).max() < 1e-10 * max(1.0, true.product)
