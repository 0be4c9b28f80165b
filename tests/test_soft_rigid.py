"""Soft walls towards rigid ones: R_eff, the hardness, and how fast motions and saddle-nodes tend to the rigid ones."""

import jax
import jax.numpy as jnp
import mpmath as mp
import numpy as np
import pytest
from scipy.linalg import expm

import jaxvibro as jv
from jaxvibro.branches.explore import _resumed_exploration, make_exploration_request
from jaxvibro.flight.flight_coefficients import make_flow_coefficients
from jaxvibro.scene.scene_parameters import mark_parameters

RIGID_SN = 0.508057896812
HARDNESSES = np.linspace(5.0, 8.0, 4)
START = jv.State(x=0.9, v=-1.1)
START_OF_SN = ("0.79", "1.25", "0.003", "0.51")  # time and speed of the impact, time within the wall, A: two digits


def rigid(**changes):
    return jv.make_scene(2.0, 2.1, 0.05, 0.7, walls=(-1.0, 1.0)).replace(**changes)


@pytest.mark.parametrize("stiffness", [0.3, 1e3, 1e8])
@pytest.mark.parametrize("restitution", [1.0, 0.7, 0.2, 1e-6])
def test_effective_restitution_is_what_half_a_swing_leaves(stiffness, restitution):
    damping = jv.contact_damping(stiffness, restitution)
    assert jv.effective_restitution(stiffness, damping) == pytest.approx(restitution, rel=1e-12)
    half = np.pi / np.sqrt(1 + stiffness - damping**2)
    left = expm(half * np.array([[0, 1], [-1 - stiffness, -2 * damping]])) @ [0, 1]
    assert left == pytest.approx([0, -restitution], abs=1e-12)


def test_from_critical_damping_on_nothing_comes_back():
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
def test_numbers_that_cannot_be_are_refused(function, values, message):
    with pytest.raises(jv.ArgumentError, match=message):
        function(*values)


def test_soften_keeps_what_each_wall_gives_back():
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


def test_hardness_moves_all_soft_walls_and_holds_what_they_give_back():
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


def test_a_diagram_along_the_hardness_goes_on_from_any_of_its_values():
    soft = jv.soften(rigid(), 1e3)
    given = "hardness", (2.0, 4.0), 2, 0, None, 0.1
    first = make_exploration_request(soft, *given)
    part = jv.Diagram("hardness", first.bounds, first.scene, (), (), False, "", first.settings)
    assert _resumed_exploration(part, make_exploration_request(soft.replace(hardness=3.7), *given)) == ((), ())
    changes = {"damping": 0.06}, {"left.damping": 1.0}, {"right.position": 1.1}
    for other in (*(soft.replace(**each) for each in changes), jv.soften(rigid(restitution=0.6), 1e3)):
        with pytest.raises(jv.ArgumentError, match=r"^resume: must have the same scene"):
            _resumed_exploration(part, make_exploration_request(other, *given))


def test_a_branch_sees_the_walls_that_replace_gives():
    scene = jv.make_scene(2.0, 2.1, 0.3, 0.7, (jv.Wall(-1.0, stiffness=1e3, damping=5.0), jv.Wall(1.0, stiffness=4e3)))
    flat, which = mark_parameters(scene, "hardness", "damping")
    assert int(which.harder) == 1 and int(which.damping) == 2 and sum(jax.tree.leaves(which)) == 3
    values = {1: 6.0, 2: 0.1}
    there = jax.tree.map(lambda leaf, mark: values.get(int(mark), leaf), flat, which)
    found, meant = (
        make_flow_coefficients(there).walls,
        make_flow_coefficients(scene.replace(damping=0.1, hardness=6.0)).walls,
    )
    for one, other in zip(found, meant, strict=True):
        assert float(one.stiffness) == pytest.approx(float(other.stiffness), rel=1e-14)
        assert float(one.damping) == pytest.approx(float(other.damping), rel=1e-14)


def flown(damping, stiffness, push, force, begin, state, time):
    """(x, x') of x'' + 2 damping x' + stiffness x = force cos(2.1 t) + push, some time after a state at t = begin."""
    rate, root = mp.mpf("2.1"), mp.sqrt(mp.mpc(damping**2 - stiffness))
    swing = force / (stiffness - rate**2 + 2j * damping * rate)

    def forced(t):
        turned = swing * mp.expj(rate * t)
        return turned.real + push / stiffness, (1j * rate * turned).real

    (x, v), fast, slow = (a - b for a, b in zip(state, forced(begin), strict=True)), root - damping, -root - damping
    first, second = (v - slow * x) / (2 * root), (fast * x - v) / (2 * root)
    first, second = first * mp.exp(fast * time), second * mp.exp(slow * time)
    x, v = forced(begin + time)
    return (first + second).real + x, (fast * first + slow * second).real + v


def half_orbit(time, speed, stay, force, stiffness):
    """What a mass that enters the right wall, stays and flies to the left one leaves to be half of a symmetric P111."""
    loss, gamma = -mp.log(mp.mpf("0.7")), mp.mpf("0.05")
    damping = loss / mp.sqrt(mp.pi**2 + loss**2) * mp.sqrt(1 + stiffness)
    y, v = flown(damping, 1 + stiffness, mp.mpf(-1), force, time, (mp.mpf(0), speed), stay)
    x, end = flown(gamma, mp.mpf(1), mp.mpf(0), force, time + stay, (1 + y, v), mp.pi / mp.mpf("2.1") - stay)
    return y * mp.sqrt(1 + stiffness), x + 1, end + speed


def slopes(function, z, step):
    """Its Jacobian by central differences."""
    found = mp.matrix(len(function(z)), len(z))
    for k in range(len(z)):
        ahead, back = ([one + (by if k == j else 0) for j, one in enumerate(z)] for by in (step, -step))
        change = zip(function(ahead), function(back), strict=True)
        for j, (one, other) in enumerate(change):
            found[j, k] = (one - other) / (2 * step)
    return found


def saddle_node(stiffness):
    """A at which these equations are singular, by Newton's method on differences: no derivative, no code of ours."""

    def singular(z):
        def orbit(some):
            return half_orbit(*some, z[3], stiffness)

        return [*orbit(z[:3]), mp.det(slopes(orbit, z[:3], mp.mpf(10) ** -18))]

    z = [mp.mpf(each) for each in START_OF_SN]
    for _ in range(12):
        step = mp.lu_solve(slopes(singular, z, mp.mpf(10) ** -12), mp.matrix(singular(z)))
        z = [one - each for one, each in zip(z, step, strict=True)]
    assert max(map(abs, step)) < 1e-30
    return z[3]


def edge(orbit):
    """The saddle-node in which P111 ends towards small amplitudes."""
    (found,) = jv.follow(orbit, "amplitude", (0.0, 2.0), direction="backward", stop="SN").points("SN")
    return found


def distances(orbit, other):
    """Of impact times, speeds and multipliers, the largest each."""
    pairs = [(np.sort(one.impacts.time), one.impacts.speed, one.multipliers) for one in (orbit, other)]
    return [abs(a - b).max() for a, b in zip(*pairs, strict=True)]


def test_everything_tends_to_the_rigid_like_one_over_the_root_of_the_stiffness():
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


def test_a_saddle_node_against_60_digits():
    soft = jv.find_orbit(jv.soften(rigid(), 1e6), START)
    with mp.workdps(60):
        true = saddle_node(mp.mpf(10) ** 6)
    assert abs(edge(soft).value - true) < 1e-11


def test_at_a_fixed_damping_the_limit_bounces_without_loss():
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


def test_a_strobe_has_derivatives_by_the_hardness():
    scene = jv.soften(rigid(), 1e3)

    def end(value):
        return jv.strobe(scene.replace(hardness=value), START)[0].x

    step = 1e-5
    change = float(end(3 + step) - end(3 - step)) / (2 * step)
    assert float(jax.grad(end)(jnp.asarray(3.0))) == pytest.approx(change, rel=1e-7)
