"""Soft walls: strobes, derivatives, orbits and branches against ball arithmetic and closed forms."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxvibro as jv
from jaxvibro.flight.flight_coefficients import make_flow_coefficients
from jaxvibro.maps.contact_duration import contact_duration_of
from jaxvibro.orbits.impact_equations import ImpactSequence
from jaxvibro.problem import soft_wall_grazing
from jaxvibro.problem.orbit_equations import OrbitEquations
from jaxvibro.scene.codes import Contact
from tests import soft_proof

FIG10 = {"amplitude": 0.3, "frequency": 1.3, "damping": 0.05, "restitution": 0.7}
STANDING = ((True, 0), (True, 0))  # structures of `soft_proof`: both walls soft, one of them rigid, one moving
MIXED = ((False, 0), (True, 0))
OTHERS = ((None, (True, 2)), ((True, 1), (True, 0)), ((False, 2), (True, 1)))


def soft(stiffness=10.0, damping=0.1, places=(-1.0, 1.0), **changes):
    walls = tuple(jv.Wall(place, stiffness=stiffness, damping=damping) for place in places)
    return jv.make_scene(**FIG10 | {"walls": walls} | changes)


@pytest.fixture(scope="module")
def resonance():
    """P111 of a soft scene and its branch along the frequency."""
    scene = soft()
    state, _ = jv.strobe(scene, jv.State(1.5, 1.0), periods=300)
    orbit = jv.find_orbit(scene, state)
    return orbit, jv.follow(orbit, "frequency", bounds=(0.5, 3.0))


def compared(count, kinds=None):
    members, _ = soft_proof.groups(count, kinds=kinds)
    return [row for group in members for row in soft_proof.strobe_rows(group)]


def test_strobes_against_ball_arithmetic():
    rows = compared(150, {STANDING, MIXED})
    assert len(rows) >= 20 and sum(row.count for row in rows) >= 30
    assert all(row.right for row in rows)
    assert max(row.state for row in rows) < 0.01 and max(row.sharp for row in rows) < 0.2


def test_strobes_of_other_kinds_against_ball_arithmetic():
    rows = compared(150, set(OTHERS))
    assert all(row.right for row in rows)
    assert max(row.state for row in rows) < 0.01 and max(row.sharp for row in rows) < 0.2


@pytest.mark.parametrize("kind", [STANDING, MIXED], ids=["standing", "mixed"])
def test_slopes_against_ball_arithmetic(kind):
    (members,), _ = soft_proof.groups(120, kinds={kind})
    for rows in soft_proof.slope_errors(members).values():
        errors = np.array([each for _, *each in rows])
        assert errors.max() < 1e-11 and np.median(errors[:, 0]) < 1e-15


def test_a_short_stay_has_its_own_digits():
    scene = jv.make_scene(0.0, 0.05, 0.0, 0.7, (None, jv.Wall(0.0, stiffness=1e10 - 1.0, damping=0.0)))
    none, one = jnp.zeros(1), jnp.ones(1)
    given = (
        make_flow_coefficients(scene),
        Contact.ENTERED * one,
        none,
        one,
        one,
        none,
        8.0 * make_flow_coefficients(scene).period * one,
    )
    assert float(jax.jit(contact_duration_of)(*given)[0]) == pytest.approx(np.pi / 1e5, rel=1e-15, abs=0.0)


def test_two_periods_are_one_after_the_other():
    scene, start = soft(1e4, 5.0, amplitude=3.0), jv.State(np.linspace(-1.02, 1.02, 32), 0.5)
    once, first = jv.strobe(scene, start, slots=32)
    twice, second = jv.strobe(scene, once, slots=32)
    both, impacts = jv.strobe(scene, start, periods=2, slots=32)
    assert (impacts.count == first.count + second.count).all() and first.count.sum() > 32
    for one, other in ((both.x, twice.x), (both.v, twice.v)):
        assert abs(one - other).max() < 1e-9


def test_single_precision():
    walls = (jv.Wall(-1.0, stiffness=1e4, damping=5.0, motion=jv.Motion(0.1)), jv.Wall(1.0, stiffness=50.0))
    start = jv.State(np.linspace(-0.8, 0.9, 5), 0.3)
    fine, coarse = (soft(walls=walls, amplitude=3.0, dtype=dtype) for dtype in (jnp.float64, jnp.float32))
    (true, known), (end, impacts) = (jv.strobe(each, start, slots=32, clearance=True) for each in (fine, coarse))
    assert end.x.dtype == end.contact.dtype == impacts.time.dtype == jnp.float32
    assert np.allclose(end.x, true.x, rtol=0, atol=1e-5) and np.allclose(end.v, true.v, rtol=0, atol=1e-5)
    assert (impacts.count == known.count).all()
    assert np.allclose(impacts.least_clearance, known.least_clearance, rtol=0, atol=1e-5)
    product, matrix = jv.monodromy(fine, start), jv.monodromy(coarse, start)
    assert matrix.dtype == jnp.float32 and abs(matrix - product).max() < 1e-3 * abs(product).max()


def test_a_start_within_a_wall_needs_no_contact():
    scene = soft(50.0, 0.3)
    beyond = jv.strobe(scene, jv.State(1.1, 0.4))
    told = jv.strobe(scene, jv.State(1.1, 0.4, 0.0, 3.0))
    assert float(beyond[0].x) == float(told[0].x) and beyond[1].count == told[1].count
    on_it = jv.strobe(scene, jv.State(1.0, 0.4))[1]
    entered = jv.strobe(scene, jv.State(1.0, 0.4, 0.0, 3.0))[1]
    assert on_it.count == entered.count + 1 and on_it.time[0] == 0.0
    assert np.allclose(on_it.time[1 : on_it.count], entered.time[: entered.count], rtol=0, atol=1e-14)


@pytest.mark.parametrize(
    ("contact", "wall"), [(2.0, jv.Wall(1.0, stiffness=9.0)), (3.0, 1.0), (4.0, jv.Wall(1.0, stiffness=9.0))]
)
def test_a_contact_that_the_wall_does_not_know_is_invalid(contact, wall):
    scene = jv.make_scene(**FIG10, walls=(None, wall))
    assert jv.strobe(scene, jv.State(1.0, 0.0, 0.0, contact))[1].status == 3


def test_a_pressed_mass_stays_within_a_very_stiff_wall():
    # statically: x - x_s = (A cos - x_s) / (1 + k2) at the slow drive's phase 0
    scene = jv.make_scene(3.0, 0.05, 0.3, 0.7, (None, jv.Wall(1.0, stiffness=1e10, damping=1e4)))
    start = jv.State(1.0 + 2.0 / (1.0 + 1e10), 0.0, 0.0, 3.0)
    end, impacts = jv.strobe(scene, start, slots=32)
    assert impacts.status == 0 and float(end.contact) == 3.0
    assert abs((float(end.x) - 1.0) * (1.0 + 1e10) - 2.0) < 1e-2


def test_periods_within_a_wall_are_all_flown():
    """A long step may end where a period does: the next is flown all the same."""
    stiffness, damping, amplitude, frequency = 1e6, 0.1, 0.3, 1.3
    scene = jv.make_scene(amplitude, frequency, 0.05, 0.7, (None, jv.Wall(-1.0, stiffness=stiffness, damping=damping)))
    end, impacts = jv.strobe(scene, jv.State(-1.0 + 1.9e-6, 0.0), periods=3)
    own, rate = 1.0 + stiffness, np.sqrt(1.0 + stiffness - damping**2)
    time, drive = 3 * 2 * np.pi / frequency, amplitude / (own - frequency**2 + 2j * damping * frequency)
    begin = 1.9e-6 - 1.0 / own - drive.real
    swing = begin, (0.0 - (1j * frequency * drive).real + damping * begin) / rate
    fade = np.exp(-damping * time)
    y = fade * (swing[0] * np.cos(rate * time) + swing[1] * np.sin(rate * time)) + 1.0 / own + drive.real
    assert not impacts.status and abs((end.x + 1.0) - y) < 1e-15 and end.contact == Contact.WITHIN


def test_multipliers_of_orbits_are_those_of_the_product_and_of_autodiff(resonance):
    orbit, _ = resonance
    product = np.asarray(jv.monodromy(orbit.scene, orbit.state))
    slopes, _ = jax.jacfwd(jv.strobe, argnums=1, has_aux=True)(orbit.scene, jax.tree.map(jnp.asarray, orbit.state))
    forward = np.array([[slopes.x.x, slopes.x.v], [slopes.v.x, slopes.v.v]])
    assert abs(product - forward).max() < 1e-11
    for matrix in (product, forward):
        roots = np.linalg.eigvals(matrix)
        assert min(abs(roots - one).min() for one in orbit.multipliers) < 1e-11


def test_a_branch_goes_through_the_grazings_of_soft_walls(resonance):
    _, branch = resonance
    meets = np.sqrt(np.roots([1.0, 4 * 0.05**2 - 2.0, 1.0 - 0.3**2]))  # A = sqrt(D), (8)
    found = [point.value for point in branch.points("GR")]
    assert np.allclose(np.sort(found), np.sort(meets), rtol=0, atol=1e-11)
    for point in branch.points("SN"):
        assert min(abs(point.multipliers - 1.0)) < 1e-6
    assert all(reason.startswith("the parameter reached its bound") for reason in branch.reasons)
    for point in branch.points("GR"):
        assert abs(np.prod(point.multipliers).real - np.exp(-2 * 0.05 * 2 * np.pi / point.value)) < 1e-9


def test_a_period_doubling_just_before_a_grazing_is_found_and_no_fold_is_made_up():
    scene = soft(50.0, 1.0, amplitude=0.5, frequency=0.8511)
    orbit = jv.find_orbit(scene, jv.strobe(scene, jv.State(0.5, 0.3), periods=2000)[0])
    branch = jv.follow(orbit, "frequency", (0.845, 0.8515))
    kinds = [point.kind for point in branch.special]
    assert orbit.label == "P111" and kinds in (["EP", "PD", "GR", "EP"], ["EP", "GR", "PD", "EP"])
    (point,) = branch.points("PD")
    assert point.value == pytest.approx(0.849936879123, abs=1e-11)  # where the branch of P222 ends
    assert min(abs(point.multipliers + 1.0)) < 1e-7 and point.spot.speeds.min() < 2e-3


def test_a_touch_after_a_long_stay_is_where_the_branch_goes_on():
    # each stay takes a sixth of the period: a touch is counted from the end of the stay before it
    wall = jv.Wall(0.0144, stiffness=7.0, damping=0.05, motion=jv.Motion(0.2, 4.65))
    scene = jv.make_scene(0.9, 0.75, 0.222, 0.7, (None, wall))
    branch = jv.follow(jv.find_orbit(scene, jv.State(-0.1, 0.0)), "frequency", (0.6, 0.9))
    assert [part.label for part in branch.segments] == ["P102", "P101"]
    assert all(reason.startswith("the parameter reached its bound") for reason in branch.reasons)
    assert branch.data["residual"].values.max() < 1e-9
    for place in range(0, len(branch), 9):
        orbit = branch.orbit(place)
        end, impacts = jv.strobe(orbit.scene, orbit.state, slots=32)
        assert abs(end.x - orbit.state.x) < 1e-10 and impacts.count == orbit.impacts.count


def test_branches_from_either_side_of_a_grazing_are_one(resonance):
    _, branch = resonance
    scene = soft(frequency=0.7)
    free = jv.find_orbit(scene, jv.strobe(scene, jv.State(0.1, 0.0), periods=100)[0])
    other = jv.follow(free, "frequency", bounds=(0.5, 3.0))
    for kind in ("GR", "SN"):
        ours, theirs = (np.sort([point.value for point in one.points(kind)]) for one in (branch, other))
        assert np.allclose(ours, theirs, rtol=0, atol=1e-10)


def test_where_a_contact_loses_its_speed_is_known():
    walls = jv.Wall(-1.0, stiffness=30.0), jv.Wall(1.0, stiffness=30.0, damping=2.0, motion=jv.Motion(0.1, 0.3))
    scene = jv.make_scene(2.0, 2.1, 0.05, 0.7, walls=walls)
    cycle = ImpactSequence(np.zeros(3), np.zeros(3), np.array([-1.0, 1.0, 0.0]), np.zeros(()), np.ones(()))
    along = OrbitEquations(scene, scene, cycle)
    zs = np.array([[0.1, 0.2, 0.0, left, right, 0.0, 2.0] for left, right in ((3, 1), (1, -1), (-1, -1), (-2, -1))])
    assert soft_wall_grazing.has_passed_zero_speed(along, zs).tolist() == [False, False, True, False]


def test_folds_and_doublings_close_to_a_grazing_are_told_from_it():
    walls = (jv.Wall(-1.2, stiffness=20.0, damping=0.3), jv.Wall(0.8, stiffness=50.0, damping=0.2))
    scene = jv.make_scene(amplitude=0.4, frequency=1.8, damping=0.1, restitution=0.7, walls=walls)
    free = jv.find_orbit(scene, jv.strobe(scene, jv.State(0.0, 0.0), periods=300)[0])
    fine, coarse = (jv.follow(free, "frequency", (0.4, 2.3), largest_step=step).special for step in (0.1, 0.3))
    fine, coarse = (one if one[0].value < one[-1].value else one[::-1] for one in (fine, coarse))
    kinds = ["EP", "GR", "PD", "PD", "GR", "SN", "GR", "SN", "GR", "EP"]
    assert [point.kind for point in fine] == kinds and [point.kind for point in coarse] == kinds
    assert np.allclose([one.value for one in fine], [one.value for one in coarse], rtol=0, atol=1e-11)
    meets = np.sqrt(np.sort(np.roots([1.0, 4 * 0.1**2 - 2.0, 1.0 - (0.4 / 0.8) ** 2])))  # A = 0.8 sqrt(D), (8)
    assert np.allclose([fine[1].value, fine[8].value], meets, rtol=0, atol=1e-11)
    assert 0 < fine[2].value - fine[1].value < 1e-4 and 0 < fine[8].value - fine[7].value < 2e-5
    for point in (point for point in fine if point.kind in ("PD", "SN")):
        roots = np.linalg.eigvals(jv.monodromy(point.scene, point.orbit.state))
        assert min(abs(roots - (1.0 if point.kind == "SN" else -1.0))) < 1e-6


def test_multipliers_change_like_the_root_of_the_distance_to_a_grazing(resonance):
    _, branch = resonance
    (point,) = [one for one in branch.points("GR") if one.value < 1.0]
    late = branch.values - point.value
    near = (late > 1e-10) & (late < 1e-6) & (branch.data["side"].values[:, 0] != 0)
    assert near.sum() >= 3
    trace = branch.multipliers.sum(axis=1).real
    slope = np.polyfit(np.log(late[near]), np.log(abs(trace[near] - sum(point.multipliers).real)), 1)[0]
    assert abs(slope - 0.5) < 0.01


@pytest.mark.parametrize(
    ("wall", "key"),
    [
        (jv.Wall(1.0, restitution=0.5, stiffness=3.0), "right.restitution"),
        (jv.Wall(1.0, damping=0.5), "right.damping"),
        (jv.Wall(1.0, stiffness=0.0), "right.stiffness"),
        (jv.Wall(1.0, stiffness=2.0, damping=-0.1), "right.damping"),
        (jv.Wall(1.0, stiffness=np.inf), "right.stiffness"),
    ],
)
def test_bad_walls_are_refused(wall, key):
    with pytest.raises(jv.ArgumentError, match=f"^{key}: "):
        jv.make_scene(**FIG10, walls=(-1.0, wall))
