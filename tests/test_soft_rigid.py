"""Soft walls towards rigid ones: R_eff, the hardness, and how fast motions and saddle-nodes tend to the rigid ones."""

import jax
import mpmath as mp
import numpy as np
import pytest
from scipy.linalg import expm

import jaxvibro as jv
from jaxvibro.branches.explore import _resumed_exploration, make_exploration_request
from tests.reference import compliant

RIGID_SN = 0.508057896812
HARDNESSES = np.linspace(5.0, 8.0, 4)
START = jv.State(x=0.9, v=-1.1)
START_OF_SN = ("2.1", "1.66", "1.25", "0.003")  # frequency, phase, speed and duration of the contact: two digits


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
        assert wall.soft and list(wall.stiffness) == [1e4, 1e5] and wall.restitution is None
        assert jv.effective_restitution(wall.stiffness, wall.damping) == pytest.approx(restitution, rel=1e-13)
    assert soft.left.motion.harmonic == 3 and soft.right.motion is None and soft.shape == (2,)
    mixed = jv.make_scene(2.0, 2.1, 0.05, 0.7, (walls[0], soft.right))
    assert list(jv.soften(mixed, 7.0).right.stiffness) == [1e4, 1e5] and jv.soften(mixed, 7.0).left.stiffness == 7
    with pytest.raises(jv.ArgumentError, match=r"^scene: must have a rigid wall"):
        jv.soften(soft, 1e6)
    with pytest.raises(jv.ArgumentError, match=r"^stiffness: must be greater than 0"):
        jv.soften(scene, -1.0)
    with pytest.raises(jv.ArgumentError, match=r"^stiffness: must be a number or an array, not a list"):
        jv.soften(scene, [1e4, 1e5])


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
    """The saddle-node in which P111 ends towards small amplitudes."""
    (found,) = jv.follow(orbit, "amplitude", (0.0, 2.0), direction="backward", stop="SN").points("SN")
    return found


def distances(orbit, other):
    """Of impact times, speeds and multipliers, the largest each."""
    pairs = [(np.sort(one.impacts.time), one.impacts.speed, one.multipliers) for one in (orbit, other)]
    return [abs(a - b).max() for a, b in zip(*pairs, strict=True)]


def test_orbits_and_folds_tend_to_the_rigid_ones_like_one_over_the_root_of_the_stiffness():
    """Issue table: slope of log distance to the rigid SN, k2 1e5 to 1e8, R held: -0.50 +- 0.01."""
    hard = jv.find_orbit(rigid(), START)
    assert abs(edge(hard).value - RIGID_SN) < 1e-11
    rows = []
    for value in HARDNESSES:
        soft = jv.find_orbit(jv.soften(rigid(), 10.0**value), START)
        assert soft.label == "P111" and soft.stable
        rows.append([edge(soft).value - RIGID_SN, *distances(soft, hard)])
    assert np.min(rows) > 0
    slopes = np.diff(np.log10(rows), axis=0) / np.diff(HARDNESSES)[:, None]
    whole = np.polyfit(HARDNESSES, np.log10(rows), 1)[0]
    assert abs(slopes + 0.5).max() < 0.01 and abs(whole + 0.5).max() < 0.002


def test_a_saddle_node_is_that_of_34_digits():
    soft = jv.find_orbit(jv.soften(rigid(), 1e6), START)
    point = edge(soft)
    damping = float(soft.scene.left.damping)
    with mp.workdps(34):
        start = [mp.mpf(each) for each in START_OF_SN]
        numbers = mp.mpf(point.value), mp.mpf("0.05"), mp.mpf(damping), mp.mpf(10) ** 6
        assert abs(compliant.fold(numbers, *start) - mp.mpf("2.1")) < 1e-10


def test_at_a_fixed_damping_the_limit_is_elastic():
    orbits = []
    for value in HARDNESSES:
        walls = [jv.Wall(place, stiffness=10.0**value, damping=0.1) for place in (-1.0, 1.0)]
        orbits.append(jv.find_orbit(jv.make_scene(2.0, 2.1, 0.05, 0.7, walls), START))
    soft = orbits[-1]
    hard = jv.find_orbit(rigid(restitution=1.0), soft.state, periods=1)
    rows = [distances(each, hard) for each in orbits]
    slopes = np.diff(np.log10(rows), axis=0) / np.diff(HARDNESSES)[:, None]
    assert abs(slopes + 0.5).max() < 0.01
    assert distances(soft, jv.find_orbit(rigid(), START))[2] > 0.3  # not that of R = 0.7


def test_a_branch_along_the_hardness():
    soft = jv.find_orbit(jv.soften(rigid(), 1e6), START)
    branch = jv.follow(soft, "hardness", (3.0, 8.0))
    assert branch.values[0] == 3 and branch.values[-1] == 8 and branch.special[-1].kind == "EP"
    for place in (0, len(branch) // 2, -1):
        scene = jv.soften(rigid(), 10.0 ** branch.values[place])
        own = jv.find_orbit(scene, START)
        assert max(distances(branch.orbit(place), own)) < 1e-9
        assert abs(branch.multipliers[place] - own.multipliers).max() < 1e-9
    with pytest.raises(jv.ArgumentError, match=r"^names: must not contain the hardness together"):
        jv.locus(edge(soft), ("hardness", "left.stiffness"), {"hardness": (5, 7), "left.stiffness": (1e5, 1e7)})
