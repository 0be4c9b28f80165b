"""What follows a grazing: closed forms, digits of another route, the map's own matrices, the orbits that are found."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

import jaxvibro as jv
from jaxvibro.branches.scenario import _classify_outcome
from jaxvibro.contact import force_law, linear
from jaxvibro.problem.added_impact_orbits import SquareRootMap
from tests.special_points import grazing_reference

GAMMA, OMEGA, R = 1.2, 2.1, 0.7
PLACES = {3: 6.19296529259567, 4: 6.08974889299819}  # by mpmath, of P301 and P401
FOLLOWS = jv.Follows


def first_grazing(scene, name="amplitude", bounds=(0.0, 20.0), start=(0.0, 0.0)):
    return jv.follow(jv.find_orbit(scene, jv.State(*start)), name, bounds, stop="GR").points("GR")[0]


@pytest.fixture(scope="module")
def grazing():
    return first_grazing(jv.make_scene(6.0, OMEGA, GAMMA, R, (None, 1.0)), bounds=(6.0, 6.2))


@pytest.fixture(scope="module")
def found(grazing):
    return jv.period_adding(grazing)


def test_the_motion_without_impacts(grazing):
    """All that is told of one wall, in closed form."""
    told, turn, root = jv.scenario(grazing), 2 * np.pi / OMEGA, np.sqrt(GAMMA**2 - 1)
    size = np.sqrt((1 - OMEGA**2) ** 2 + 4 * GAMMA**2 * OMEGA**2)
    assert grazing.value == pytest.approx(6.0852033655417, abs=1e-12)
    assert told.root == pytest.approx(1.7 * OMEGA * np.sqrt(2.0), rel=1e-12)
    assert told.acceleration == pytest.approx(OMEGA**2, rel=1e-12) and told.exponent == 0.5
    assert told.rate == pytest.approx(1 / size, rel=1e-9) and (told.wall, told.side) == ("right", 1)
    assert told.multipliers == pytest.approx(np.exp([-(GAMMA - root) * turn, -(GAMMA + root) * turn]), rel=1e-12)
    assert told.multipliers[0] == pytest.approx(0.2007433664, abs=1e-10)
    assert told.ratio == pytest.approx(0.2007433664**-2, rel=1e-9)
    assert told.follows is FOLLOWS.OVERLAPPING and not told.half and told.deeper == 0
    times = np.arange(1, 7) * turn
    responses = -told.root * np.exp(-GAMMA * times) * np.sinh(root * times) / root
    assert [one.response for one in told.orbits] == pytest.approx(responses, rel=1e-10)
    assert [one.label for one in told.orbits] == [f"P{n}01" for n in range(1, 7)]
    assert "period adding, overlapping" in told.table() and "P601" in told.table()


def test_places_are_found_to_rounding(grazing, found):
    """And their ratio tends to that which is told."""
    windows = {one.returns: one for one in found.windows}
    for n, place in PLACES.items():
        assert windows[n].found == pytest.approx(place, abs=1e-12)
    assert windows[6].ratio == pytest.approx(found.scenario.ratio, rel=0.01)
    assert abs(windows[6].ratio / found.scenario.ratio - 1) < abs(windows[5].ratio / found.scenario.ratio - 1)
    away = [(one.found - one.predicted) / (one.found - grazing.value) for one in found.windows]
    assert (abs(np.diff(np.log(np.abs(away[1:])))) > 1.0).all() and abs(away[-1]) < 1e-3
    assert all(one.orbit.stable and one.orbit.label == f"P{one.returns}01" for one in found.windows)
    assert all(one.wall == "right" for one in found.windows) and "24.8152" in found.table()


def test_an_orbit_gone_through_several_times(grazing, found):
    """The branch of P401 ends at the grazing, as P100 four times: there it is that of P100."""
    one = found.windows[2]
    branch = jv.follow(one.orbit, "amplitude", (6.085, one.found))
    last = min(branch.points("GR"), key=lambda point: abs(point.value - grazing.value))
    assert last.label != "P100" and last.value == pytest.approx(grazing.value, abs=1e-10)
    told = jv.scenario(last)
    assert told.follows is FOLLOWS.OVERLAPPING
    assert told.matrix == pytest.approx(jv.scenario(grazing).matrix, rel=1e-7)


def test_windows_of_many_returns(grazing):
    """Passes that differ by 1e-9 are told apart: the last is the first to touch."""
    found = jv.period_adding(grazing, 8).windows[-1]
    assert found.found - grazing.value == pytest.approx(1.21557e-08, rel=1e-4)


MATRICES = [
    np.array([[0.5, 0.3], [-0.1, 0.1]]),
    np.array([[0.1, 0.7], [-0.6, -0.1]]),
    np.array([[-0.5, 0.2], [0.1, -0.4]]),
]


@pytest.mark.parametrize("matrix", MATRICES, ids=["real", "complex", "negative"])
@pytest.mark.parametrize("n", [1, 2, 3, 5])
def test_windows_are_those_of_the_map(matrix, n):
    """Its orbits with one impact in n returns and their multipliers, by M, C and E themselves."""
    near = SquareRootMap(2.0, matrix)
    one, kick, across = near.added_impact_window(n), np.array([0.0, -2.0]), np.array([1.0, 0.0])
    power = np.linalg.matrix_power(matrix, n)
    for s in (0.01, 0.3, one.fold_root, one.doubling_root, one.next_grazing_root):
        if not (np.isfinite(s) and s > 0):
            continue
        mu, y = one.depth(s), np.linalg.solve(np.eye(2) - power, power @ kick) * s
        assert across @ y + mu == pytest.approx(s * s, abs=1e-12)
        later = [across @ np.linalg.matrix_power(matrix, k) @ (y + kick * s) + mu for k in range(1, n)]
        assert (max(later, default=-1.0) < 0) == (s < one.next_grazing_root) or s == one.next_grazing_root
        roots = np.linalg.eigvals(power @ (np.eye(2) + np.outer(kick, across) / (2 * s)))
        if s == one.next_grazing_root:
            assert max(later) == pytest.approx(0.0, abs=1e-12)
        elif s in (one.fold_root, one.doubling_root):
            assert min(abs(roots - (1.0 if s == one.fold_root else -1.0))) < 1e-9
        elif s < one.next_grazing_root:
            assert (abs(roots).max() < 1.0) == (
                s > (one.min_stable_root if np.isfinite(one.min_stable_root) else np.inf)
            )


def triangular(first, other, corner=1.0):
    return SquareRootMap(2.0, np.array([[first, corner], [0.0, other]]))


@pytest.mark.parametrize(
    "near,follows,deeper",
    [
        (triangular(0.249, 0.1), FOLLOWS.OVERLAPPING, 0),
        (triangular(0.251, 0.1), FOLLOWS.ADDING, 0),
        (triangular(0.666, 0.1), FOLLOWS.ADDING, 0),
        (triangular(0.667, 0.1), FOLLOWS.CHAOS, 0),
        (triangular(1.1, 0.1), FOLLOWS.UNSTABLE, 0),
        (triangular(0.3, 0.1, -1.0), FOLLOWS.JUMP, 1),
        (triangular(-0.3, -0.1), FOLLOWS.JUMP, 2),
        (triangular(0.3, 0.1, 0.0), FOLLOWS.OPEN, 0),
        (SquareRootMap(2.0, np.array([[0.0, 1.0], [0.0, 0.0]])), FOLLOWS.OPEN, 0),
    ],
)
def test_what_signs_decide(near, follows, deeper):
    assert _classify_outcome(near, True) == (follows, deeper)
    assert _classify_outcome(near, False)[0] is (FOLLOWS.UNSTABLE if follows is FOLLOWS.UNSTABLE else FOLLOWS.OPEN)


@pytest.mark.parametrize("angle", [0.3, 1.0, 2.0, 3.0])
def test_a_turning_map_deepens_after_half_a_turn(angle):
    turned = 0.9 * np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    assert SquareRootMap(1.0, turned).first_positive_response() == int(np.pi / angle) + 1
    assert SquareRootMap(1.0, turned.T).first_positive_response() == 1


@pytest.mark.parametrize("gamma,amplitude", [(0.05, 1.0), (1.2, 4.5)])
def test_half_of_a_symmetric_orbit(gamma, amplitude):
    """A return is half a period and the mirror image: its multipliers are -exp(-gamma T / 2) and so on."""
    scene = jv.make_scene(amplitude, OMEGA, gamma, R, (-1.0, 1.0))
    told = jv.scenario(first_grazing(scene, bounds=(amplitude, amplitude + 2.5)))
    roots = -np.exp(
        np.array([-gamma + np.emath.sqrt(gamma**2 - 1), -gamma - np.emath.sqrt(gamma**2 - 1)]) * np.pi / OMEGA
    )
    assert sorted(told.multipliers, key=np.imag) == pytest.approx(sorted(roots, key=np.imag), rel=1e-9)
    assert told.half and told.follows is FOLLOWS.JUMP and told.deeper == 1
    assert [one.label for one in told.orbits[:4]] == ["P111", "P101", "P311", "P201"]
    with pytest.raises(jv.ArgumentError, match="period adding or chaos follows; got 'jump'"):
        jv.period_adding(told.special)


def test_windows_of_half_of_a_symmetric_orbit():
    """After two returns the orbit is one of two mirror images, after three it is its own mirror image."""
    scene = jv.make_scene(1.06, 0.45, 0.2, 0.3, (-1.0, 1.0))
    (orbit,) = (one for one in jv.find_orbits(scene, 1, 16) if one.label == "P111")
    (grazing,) = jv.follow(orbit, "amplitude", (1.0, 1.1), stop="GR").points("GR")
    found = jv.period_adding(grazing, 3)
    assert found.scenario.half and found.scenario.follows is FOLLOWS.OVERLAPPING
    assert [one.orbit.label for one in found.windows] == ["P121", "P344"]
    for one, close in zip(found.windows, (0.2, 1e-3), strict=True):
        assert one.found == pytest.approx(one.predicted, abs=close * (one.found - grazing.value))
        again = jv.find_orbit(one.orbit.scene, one.orbit.state, settle=0)
        assert again.stable and again.label == one.orbit.label
        assert (again.state.x, again.state.v) == pytest.approx((one.orbit.state.x, one.orbit.state.v), abs=1e-11)


def test_walls_that_are_unlike_are_open():
    scene = jv.make_scene(4.5, OMEGA, GAMMA, R, (jv.Wall(-1.0, 0.5), jv.Wall(1.0, 0.8)))
    told = jv.scenario(first_grazing(scene, bounds=(4.5, 6.2)))
    assert told.follows is FOLLOWS.OPEN and told.wall == "right" and told.orbits == ()


def test_an_orbit_with_impacts():
    """M through the impacts of the orbit without the touch, in 40 digits."""
    scene = jv.make_scene(0.7, 0.7, 0.05, 0.7, (jv.Wall(-1.0, 0.5), jv.Wall(1.0, 0.8)))
    point = first_grazing(scene, bounds=(0.6, 0.8))
    told, bare = jv.scenario(point), min(point.meets, key=lambda one: one.impacts.count)
    _, _, expected = grazing_reference(point, told.half)
    assert bare.label == "P101" and told.matrix == pytest.approx(expected, rel=1e-10)
    assert told.multipliers == pytest.approx(bare.multipliers, abs=1e-3)  # a little beside the point
    assert told.root == pytest.approx(1.5 * np.sqrt(2.0 * told.acceleration), rel=1e-12)
    assert told.wall == "left" and told.orbits[1].label == "P212" and told.follows is FOLLOWS.JUMP


def swing(t, x, v, p):
    return -jnp.sin(x) - 2.0 * p["damping"] * v


def test_period_adding_under_a_force_of_ones_own():
    force = jv.Force(swing, {"damping": 1.3})
    point = first_grazing(jv.make_scene(1.0, 2.1, restitution=R, walls=(None, 1.0), force=force))
    found = jv.period_adding(point, 5)
    assert found.scenario.follows is FOLLOWS.ADDING
    assert [one.returns for one in found.windows if np.isfinite(one.found)] == [3, 4, 5]
    last = found.windows[-1]
    assert last.found - point.value == pytest.approx(last.predicted - point.value, rel=0.05)


def test_powers_of_soft_walls():
    """n + 1/2, and one for a damping."""

    def law(function, **numbers):
        return jv.Wall(1.0, law=jv.Push(function, numbers))

    soft = jv.make_scene(1.0, 2.0, 0.1, 0.7, (None, jv.Wall(1.0, stiffness=9.0))).right
    assert linear.grazing_exponent(soft) == 1.5
    assert force_law.grazing_exponent(law(lambda d, r, p: p["k"] * d**1.5, k=5.0)) == 2.0
    assert force_law.grazing_exponent(law(lambda d, r, p: p["k"] * d**1.5 * (1 + 0.2 * r), k=5.0)) == 2.0
    assert force_law.grazing_exponent(law(lambda d, r, p: p["k"] * d + 0.3 * r, k=5.0)) == 1.5
    assert force_law.grazing_exponent(law(lambda d, r, p: p["k"] * d**2 + 0.3 * r, k=5.0)) == 1.5
    assert force_law.grazing_exponent(law(lambda d, r, p: p["k"] * d**2, k=5.0)) == 2.5
    assert np.isnan(force_law.grazing_exponent(law(lambda d, r, p: p["k"] * np.exp(-1 / d), k=5.0)))


def test_multipliers_bend_like_a_root_at_a_soft_wall():
    """The map's correction goes as depth^1.5, so its derivative as depth^0.5."""
    scene = jv.make_scene(0.1, 0.7, 0.05, 0.7, (None, jv.Wall(1.0, stiffness=10.0, damping=0.1)))
    point = first_grazing(scene, bounds=(0.0, 2.0))
    told = jv.scenario(point)
    assert told.follows is FOLLOWS.C1 and told.exponent == 1.5 and told.root == 0 and told.orbits == ()

    def trace(change):
        there = point.scene.replace(amplitude=point.value + change)
        return sum(jv.find_orbit(there, point.orbit.state, 1, settle=400).multipliers).real

    inside, change = trace(-1e-3), np.array([1e-4, 1e-6])
    bent = np.array([trace(told.side * each) for each in change]) - inside
    assert abs(np.log(bent[0] / bent[1]) / np.log(change[0] / change[1]) - (told.exponent - 1.0)) < 0.05


def test_what_is_no_grazing_is_refused(grazing):
    for wrong in (None, replace(grazing, kind="SN")):
        with pytest.raises(jv.ArgumentError, match=r"must be a (grazing, GR, of a branch|Special)"):
            jv.scenario(wrong)
    for longest in (0, 65, 2.5):
        with pytest.raises(jv.ArgumentError, match="longest"):
            jv.scenario(grazing, longest)
