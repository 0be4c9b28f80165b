"""Soft walls towards rigid ones: R_eff, the hardness, and how fast motions and saddle-nodes tend to the rigid ones."""

import jax
import numpy as np
import pytest
from scipy.linalg import expm

import jaxvibro as jv
from jaxvibro.branches.explore import _resumed_exploration, make_exploration_request
from tests.reference import soft_orbits

RIGID_SN = 0.508057896812
HARDNESSES = np.linspace(5.0, 8.0, 4)
START = jv.State(x=0.9, v=-1.1)
START_OF_SN = 2.1, 1.66, 1.25, 0.003  # frequency, phase, speed and duration of the contact with stiffness 1e6


def rigid(**changes):
    return jv.make_scene(2.0, 2.1, 0.05, 0.7, walls=(-1.0, 1.0)).replace(**changes)


@pytest.mark.parametrize("stiffness", [0.3, 1e3, 1e8])
@pytest.mark.parametrize("restitution", [1.0, 0.7, 0.2, 1e-6])
def test_effective_restitution_is_that_of_half_a_swing(stiffness, restitution):
    damping = jv.contact_damping(stiffness, restitution)
    assert jv.effective_restitution(stiffness, damping) == pytest.approx(restitution, rel=1e-12)
    half = np.pi / np.sqrt(1 + stiffness - damping**2)
    left = expm(half * np.array([[0, 1], [-1 - stiffness, -2 * damping]])) @ [0, 1]
    assert left == pytest.approx([0, -restitution], abs=1e-12)


def test_critical_damping_has_restitution_0():
    assert jv.contact_damping(99.0, 0.0) == 10.0
    assert list(jv.effective_restitution(99.0, np.array([10.0, 30.0]))) == [0, 0]
    assert jax.grad(jv.effective_restitution, 1)(99.0, 30.0) == 0


def test_both_functions_have_derivatives():
    loss = -np.log(0.7)
    slope = -10 * np.pi**2 / (np.pi**2 + loss**2) ** 1.5 / 0.7
    assert jax.grad(jv.contact_damping, 1)(99.0, 0.7) == pytest.approx(slope, rel=1e-12)
    there = jv.contact_damping(99.0, 0.7)
    assert jax.grad(jv.effective_restitution, 1)(99.0, there) == pytest.approx(1 / slope, rel=1e-12)


@pytest.mark.parametrize(
    ("function", "values", "message"),
    [
        (jv.contact_damping, (0.0, 0.7), "^stiffness: must be greater than 0"),
        (jv.contact_damping, (1.0, 1.1), "^restitution: must lie between 0 and 1"),
        (jv.effective_restitution, (1.0, -0.1), "^damping: must not be negative"),
        (jv.effective_restitution, ("hard", 0.1), "^stiffness: must be a real number"),
    ],
)
def test_invalid_numbers_are_refused(function, values, message):
    with pytest.raises(jv.ArgumentError, match=message):
        function(*values)


def test_soften_keeps_the_restitution_of_each_wall():
    walls = jv.Wall(-1.0, restitution=0.5, motion=jv.Motion(0.1, 0.2, 3)), jv.Wall(1.0)
    scene = jv.make_scene(2.0, 2.1, 0.05, 0.7, walls)
    soft = jv.soften(scene, np.array([1e4, 1e5]))
    for wall, restitution in ((soft.left, 0.5), (soft.right, 0.7)):
        assert list(wall.stiffness) == [1e4, 1e5]
        assert jv.effective_restitution(wall.stiffness, wall.damping) == pytest.approx(restitution, rel=1e-13)
    assert soft.left.motion.harmonic == 3 and soft.right.motion is None and soft.shape == (2,)
    mixed = jv.soften(jv.make_scene(2.0, 2.1, 0.05, 0.7, (walls[0], soft.right)), 7.0)
    assert list(mixed.right.stiffness) == [1e4, 1e5] and mixed.left.stiffness == 7
    for given, stiffness, rule in (
        (soft, 1e6, "^scene: must have a rigid wall"),
        (scene, -1.0, "^stiffness: must be greater than 0"),
        (scene, [1e4, 1e5], "^stiffness: must be a number or an array, not a list"),
    ):
        with pytest.raises(jv.ArgumentError, match=rule):
            jv.soften(given, stiffness)


def test_the_hardness_changes_all_soft_walls_and_keeps_their_restitution():
    walls = jv.Wall(-1.0, stiffness=1e3, damping=5.0), jv.Wall(1.0, stiffness=4e3)
    scene = jv.make_scene(2.0, 2.1, 0.3, 0.7, walls)
    assert scene.parameter("hardness") == pytest.approx(3) and scene.names[-1] == "hardness"
    harder = scene.replace(hardness=5.0)
    assert [harder.left.stiffness, harder.right.stiffness] == pytest.approx([1e5, 4e5], rel=1e-14)
    for side, damping in (("left", 5.0), ("right", 0.3)):
        old, new = getattr(scene, side), getattr(harder, side)
        kept = [jv.effective_restitution(old.stiffness, damping), jv.effective_restitution(new.stiffness, new.damping)]
        assert kept[0] == pytest.approx(kept[1], rel=1e-13)
    same = scene.replace(hardness=scene.parameter("hardness"))
    assert same.left.stiffness == 1e3 and same.left.damping == 5.0 and same.right.damping == 0.3
    both = scene.replace(**{"left.stiffness": 7.0, "hardness": 5.0})
    assert both.left.stiffness == 7.0 and both.right.stiffness == harder.right.stiffness
    for value, message in (
        (np.nan, "^hardness: must be finite"),
        ("hard", "^hardness: must be a real number"),
        (400.0, "^left.stiffness: must be finite"),
        (-400.0, "^left.stiffness: must be greater than 0"),
    ):
        with pytest.raises(jv.ArgumentError, match=message):
            scene.replace(hardness=value)
    with pytest.raises(jv.ArgumentError, match=r"^hardness: is not a parameter of this scene"):
        rigid().replace(hardness=3.0)
    slope = jax.grad(lambda value: scene.replace(hardness=value).right.stiffness)(5.0)
    assert slope == pytest.approx(4e5 * np.log(10), rel=1e-12)


def test_a_diagram_along_the_hardness_resumes_from_any_of_its_values():
    soft = jv.soften(rigid(), 1e3)
    given = "hardness", (2.0, 4.0), 2, 0, None, 0.1
    first = make_exploration_request(soft, *given)
    part = jv.Diagram("hardness", first.bounds, first.scene, (), (), False, "", first.settings)
    assert _resumed_exploration(part, make_exploration_request(soft.replace(hardness=3.7), *given)) == ((), ())
    changes = {"damping": 0.06}, {"left.damping": 1.0}, {"right.position": 1.1}
    for other in (*(soft.replace(**each) for each in changes), jv.soften(rigid(restitution=0.6), 1e3)):
        with pytest.raises(jv.ArgumentError, match=r"^resume: must have the same scene"):
            _resumed_exploration(part, make_exploration_request(other, *given))


def edge(orbit):
    """Return the saddle-node in which P111 ends towards small amplitudes."""
    (point,) = jv.follow(orbit, "amplitude", (0.0, 2.0), direction="backward", stop="SN").points("SN")
    return point


def distances(orbit, other):
    """Return the largest distance of impact times, of speeds, and of multipliers."""
    pairs = [(np.sort(one.impacts.time), one.impacts.speed, one.multipliers) for one in (orbit, other)]
    return [abs(a - b).max() for a, b in zip(*pairs, strict=True)]


def test_orbits_and_folds_tend_to_the_rigid_ones_like_one_over_the_root_of_the_stiffness():
    """The slope of the logarithm of a distance is -1/2; the fold at the stiffness 1e6 is that of 40 digits."""
    hard = jv.find_orbit(rigid(), START)
    assert abs(edge(hard).value - RIGID_SN) < 1e-11
    rows = []
    for value in HARDNESSES:
        soft = jv.find_orbit(jv.soften(rigid(), 10.0**value), START)
        fold = edge(soft).value
        assert soft.label == "P111" and soft.stable
        rows.append([fold - RIGID_SN, *distances(soft, hard)])
        if value == 6.0:
            oscillator = soft_orbits.symmetric(fold, 0.05, float(soft.scene.left.damping), 1e6)
            assert abs(soft_orbits.fold(oscillator, *START_OF_SN) - 2.1) < 1e-10
    assert np.min(rows) > 0
    slopes = np.diff(np.log10(rows), axis=0) / np.diff(HARDNESSES)[:, None]
    assert abs(slopes + 0.5).max() < 0.01 and abs(np.polyfit(HARDNESSES, np.log10(rows), 1)[0] + 0.5).max() < 0.002
