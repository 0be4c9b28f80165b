"""What scenes settle on: against closed forms and symmetry, chaos and the undecided told, the same for a seed."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxvibro as jv
from jaxvibro.attractors.companion_exponent import largest_exponents
from jaxvibro.attractors.recurrence import compute_return_distances, find_recurrence_periods
from jaxvibro.maps import itinerary
from jaxvibro.maps.initial_conditions import draw_initial_states, forced_amplitude, initial_box
from jaxvibro.maps.iterate import MAX_RECORDED_PERIODS, iterate
from jaxvibro.orbits.orbit_comparison import impacts_as_points, is_same_orbit, mirror_points, samples_fill_same_set
from jaxvibro.scene.check import MAX_ORBIT_PERIODS, ArgumentError
from jaxvibro.scene.symmetry import is_symmetric

PERIOD = 2 * np.pi / 2.1


def scene(amplitude=4.65, frequency=2.1, damping=0.05, restitution=0.7, walls=(-1.0, 1.0), **more):
    return jv.make_scene(amplitude, frequency, damping, restitution, walls, **more)


def flow(t, damping):
    """The homogeneous flow over t, (24)."""
    r = np.sqrt(1 - damping**2)
    s, c = np.sin(r * t), np.cos(r * t)
    return np.exp(-damping * t) / r * np.array([[damping * s + r * c, s], [-s, r * c - damping * s]])


def impact_speeds(amplitude, frequency, damping, r, wall, periods):
    """Speeds before impact of orbits with one impact on a wall in that many periods; half a period: both, in turn."""
    e, sign = flow(periods * 2 * np.pi / frequency, damping), -1.0 if periods == 0.5 else 1.0
    a, b = np.linalg.solve(np.eye(2) - sign * e, np.array([0.0, -1.0]) - sign * e @ np.array([0.0, r]))
    d = (1 - frequency**2) ** 2 + (2 * damping * frequency) ** 2
    roots = np.roots([a**2 + (b / frequency) ** 2, -2 * a * wall, wall**2 - amplitude**2 / d])
    return [root.real for root in roots if abs(root.imag) < 1e-12 and root.real > 0]


@pytest.fixture(scope="module")
def four():
    return jv.find_attractors(scene(4.65), starts=200, seed=0)


@pytest.fixture(scope="module")
def chaos():
    return jv.find_attractors(scene(5.0), starts=200, seed=0)


def test_two_mirror_pairs_of_period_one(four):
    assert sorted(one.label for one in four) == ["P111", "P111", "P112", "P121"]
    assert abs(sum(one.share for one in four) - 1.0) < 1e-12
    assert [one.share for one in four] == sorted((one.share for one in four), reverse=True)
    for place, one in enumerate(four):
        twin = four[one.mirror_of]
        assert one.kind == "periodic" and one.periods == 1 and one.points.shape == (1, 2) and one.share >= 0.04
        assert one.mirror_of != place and twin.mirror_of == place
        assert itinerary.is_same_itinerary(twin.itinerary, itinerary.mirror_itinerary(one.itinerary))
        assert abs(one.least_speed - twin.least_speed) < 1e-10
        assert not np.allclose(one.points, twin.points, atol=0.1)


def test_they_are_orbits_and_mirror_images(four):
    """The mirror image, strobed at phase pi, comes back as well, with the twin's impacts half a period later."""
    for one in four:
        end, impacts = jv.strobe(scene(4.65), one.state, slots=32)
        assert abs(end.x - one.state.x) < 1e-12 and abs(end.v - one.state.v) < 1e-12
        assert itinerary.itinerary_of_rows(impacts.side[None]) == one.itinerary
        back, hits = jv.strobe(scene(4.65), jv.State(-one.state.x, -one.state.v, phase=np.pi), slots=32)
        assert abs(back.x + one.state.x) < 1e-12 and abs(back.v + one.state.v) < 1e-12
        twin = four[one.mirror_of]
        _, expected = jv.strobe(scene(4.65), twin.state, slots=32)
        n = int(impacts.count)
        late = np.sort((hits.time[:n] + PERIOD / 2) % PERIOD)
        assert abs(late - np.sort(expected.time[:n])).max() < 1e-11


def test_exponent_of_an_orbit_whose_multipliers_are_complex(four):
    """Both have the modulus sqrt(det M), det M = R^4 exp(-2 gamma T) for two impacts."""
    expected = (4 * np.log(0.7) - 2 * 0.05 * PERIOD) / 2
    assert abs(four[0].exponent - expected) < 1e-12
    assert all(one.exponent < -0.5 for one in four)


def test_a_periodic_attractor_has_its_orbit(four, chaos):
    for one in four:
        assert (one.orbit.label, one.orbit.stable) == (one.label, True)
        assert abs(one.orbit.state.x - one.state.x) < 1e-9
        assert abs(np.log(abs(one.orbit.multipliers[0])) - one.exponent) < 1e-12
    assert [one.orbit is None for one in chaos] == [one.kind == "chaotic" for one in chaos]


def test_two_chaotic_attractors_and_two_orbits(chaos):
    assert sorted(one.label for one in chaos) == ["P111", "P111", "chaotic", "chaotic"]
    assert abs(sum(one.share for one in chaos) - 1.0) < 1e-12
    for place, one in enumerate(chaos):
        assert chaos[one.mirror_of].mirror_of == place != one.mirror_of
        assert chaos[one.mirror_of].label == one.label and one.share > 0.05
    for one in chaos:
        if one.kind == "chaotic":
            assert 0.2 < one.exponent < 0.5 and one.periods == 0 and one.itinerary == ()
            assert len(one.points) == 512 and abs(one.points[:, 0]).max() <= 1.0


def test_the_same_for_a_seed(four):
    again = jv.find_attractors(scene(4.65), starts=200, seed=0)
    for one, other in zip(four, again, strict=True):
        for field in dataclasses.fields(one):
            if field.name == "state":
                assert (one.state.x, one.state.v) == (other.state.x, other.state.v)
            elif field.name == "orbit":
                assert np.array_equal(one.orbit.impacts.time, other.orbit.impacts.time)
            else:
                assert np.array_equal(getattr(one, field.name), getattr(other, field.name))
    few = jv.find_attractors(scene(4.65), starts=64, seed=1)
    assert {one.share for one in few} != {one.share for one in four}
    for one in few:
        assert min(abs(one.points - other.points).max() for other in four) < 1e-9


@pytest.mark.parametrize("amplitude, restitution", [(3.2, 0.7), (2.0, 0.4)])
def test_symmetric_orbit_against_its_closed_form(amplitude, restitution):
    """(12) to (18): u solves (1 - a u)^2 + b^2 u^2 / omega^2 = A^2 / D."""
    (one,) = [
        one for one in jv.find_attractors(scene(amplitude, restitution=restitution), starts=64) if one.label == "P111"
    ]
    roots = impact_speeds(amplitude, 2.1, 0.05, restitution, 1.0, 0.5)
    assert min(abs(one.least_speed - root) for root in roots) < 1e-11
    assert one.mirror_of is not None and one.itinerary in [("LR",), ("RL",)]


def test_longer_orbits_and_their_period():
    pair = jv.find_attractors(scene(5.6), starts=64)
    assert sorted(one.label for one in pair) == ["P223", "P232"]
    for one in pair:
        assert one.points.shape == (2, 2) and len(one.itinerary) == 2
        end, impacts = jv.strobe(scene(5.6), one.state, slots=32)
        assert abs(np.array([end.x, end.v]) - one.points[1]).max() < 1e-11
        assert itinerary.itinerary_of_rows(impacts.side[None]) == one.itinerary[:1]
        assert itinerary.minimal_period(one.itinerary) == 2


def test_walls_that_are_not_opposite_have_no_mirror_images():
    found = jv.find_attractors(scene(4.65, walls=(-1.5, 1.0)), starts=64)
    assert [(one.kind, one.mirror_of) for one in found] == [("periodic", None)] * len(found)
    for one in found:
        end, _ = jv.strobe(scene(4.65, walls=(-1.5, 1.0)), one.state, periods=one.periods)
        assert abs(end.x - one.state.x) < 1e-11


def test_one_wall_against_the_closed_form():
    """(s - a u)^2 + b^2 u^2 / omega^2 = A^2 / D for one impact in a period."""
    (one,) = jv.find_attractors(scene(1.0, 1.7, 0.05, 0.8, (None, 0.5)), starts=64)
    assert (one.label, one.share, one.mirror_of) == ("P101", 1.0, None)
    assert min(abs(one.least_speed - root) for root in impact_speeds(1.0, 1.7, 0.05, 0.8, 0.5, 1)) < 1e-11


def test_no_walls():
    calm = scene(2.0, 1.3, 0.1, 0.7, (None, None))
    (one,) = jv.find_attractors(calm, starts=10)
    d = (1 - 1.3**2) ** 2 + (2 * 0.1 * 1.3) ** 2
    assert (one.label, one.share, one.mirror_of, one.least_speed) == ("P100", 1.0, 0, np.inf)
    assert abs(one.points[0] - [2.0 * (1 - 1.3**2) / d, 2.0 * 2 * 0.1 * 1.3**2 / d]).max() < 1e-12
    assert abs(one.exponent + 0.1 * 2 * np.pi / 1.3) < 1e-3


def test_motion_that_comes_back_without_attracting_is_unresolved():
    """Undamped and driven at twice its frequency, each free motion comes back after two periods."""
    (one,) = jv.find_attractors(scene(2.0, 2.0, 0.0, 0.7, (None, None)), starts=10)
    assert (one.label, one.kind, one.share, one.mirror_of) == ("unresolved", "unresolved", 1.0, None)
    assert "10 starts: recurs but does not attract" in one.note


def test_chaos_that_loses_no_energy_is_no_attractor():
    (one,) = jv.find_attractors(scene(1.0, damping=0.0, restitution=1.0), starts=32)
    assert one.kind == "unresolved" and one.share == 1.0 and "loses no energy" in one.note


def test_too_many_impacts_are_told():
    (one,) = jv.find_attractors(scene(0.0, damping=0.0, restitution=1.0, walls=(-1e-3, 1e-3)), starts=8, settle=10)
    assert one.kind == "unresolved" and "status cap" in one.note
    assert np.isfinite(one.state.x) and abs(one.state.x) <= 1e-3


def test_a_mass_that_sticks():
    """No rebound: what lands leaves with the wall's speed; at phase 0 it still rests on the right wall, pressed on."""
    sticky = scene(2.0, 0.4, 0.05, 0.0)
    found = jv.find_attractors(sticky, starts=64)
    (one,) = found
    assert (one.label, one.share, one.mirror_of) == ("P111", 1.0, 0)
    assert (one.state.contact, one.state.x, one.state.v) == (2.0, 1.0, 0.0)
    assert one.exponent == -np.inf


def test_many_impacts_in_a_period_are_all_counted():
    found = jv.find_attractors(scene(8.0, 0.25, 0.05, 0.8, (-0.2, 0.2)), starts=16)
    for one in found:
        if one.kind == "periodic":
            _, impacts = jv.strobe(scene(8.0, 0.25, 0.05, 0.8, (-0.2, 0.2)), one.state, periods=one.periods, slots=0)
            assert len("".join(one.itinerary)) == int(impacts.count) > 16
    assert any(one.kind == "periodic" for one in found)


def test_walls_that_move_oppositely_keep_the_symmetry():
    left, right = (jv.Wall(place, motion=jv.Motion(0.2)) for place in (-1.0, 1.0))
    found = jv.find_attractors(scene(1.0, walls=(left, right)), starts=64)
    assert {one.label: one.mirror_of for one in found} == {one.label: k for k, one in enumerate(found)}
    assert {one.label for one in found} == {"P100", "P111"}


def test_single_precision():
    found = jv.find_attractors(scene(4.65, dtype=jnp.float32), starts=64)
    assert sorted(one.label for one in found) == ["P111", "P111", "P112", "P121"]
    assert all(one.mirror_of is not None for one in found)


def test_symmetry_of_scenes():
    def moving(place, *motion):
        return jv.Wall(place, motion=jv.Motion(*motion))

    assert is_symmetric(scene()) and is_symmetric(scene(walls=(None, None)))
    assert not is_symmetric(scene(walls=(None, 1.0))) and not is_symmetric(scene(walls=(-1.0, 1.5)))
    assert not is_symmetric(scene(walls=(jv.Wall(-1.0, restitution=0.5), 1.0)))
    assert is_symmetric(scene(walls=(moving(-1.0, 0.1, 0.3), moving(1.0, 0.1, 0.3))))
    assert is_symmetric(scene(walls=(moving(-1.0, 0.1, 0.3, 2), moving(1.0, -0.1, 0.3, 2))))
    assert not is_symmetric(scene(walls=(moving(-1.0, 0.1, 0.3, 2), moving(1.0, 0.1, 0.3, 2))))
    assert not is_symmetric(scene(walls=(moving(-1.0, 0.1), 1.0)))
    assert is_symmetric(scene(walls=(moving(-1.0, 0.0), 1.0)))


def test_the_box_of_starts():
    left, right, fast = initial_box(scene(4.65))
    assert (left, right) == (-1.0, 1.0)
    forced = 4.65 / np.hypot(1 - 2.1**2, 2 * 0.05 * 2.1)
    assert abs(forced_amplitude(scene(4.65)) - forced) < 1e-14 and abs(fast - 3 * 2.1 * forced) < 1e-13
    assert initial_box(scene(0.0, walls=(None, 0.5))) == (-2.0, 0.5, 3.0)
    assert initial_box(scene(0.0, walls=(3.0, None)))[:2] == (3.0, 5.0)
    assert initial_box(scene(0.0, walls=(None, None)))[:2] == (-2.0, 2.0)
    moving = jv.Wall(1.0, motion=jv.Motion(0.5, phase=np.pi / 3))
    assert abs(initial_box(scene(walls=(-1.0, moving)))[1] - 1.25) < 1e-15
    assert forced_amplitude(scene(2.0, 1.0, 0.0)) == 2000.0
    some, more = draw_initial_states(scene(), 5, 3), draw_initial_states(scene(), 9, 3)
    assert (some.x == more.x[:5]).all() and (some.v == more.v[:5]).all()
    many = draw_initial_states(scene(walls=(-0.3, 0.8)), 4000, 0)
    assert abs(many.x.mean() - 0.25) < 0.02 and abs(many.v.mean()) < 0.2
    assert many.x.min() >= -0.3 and many.x.max() <= 0.8 and abs(many.v).max() <= fast


def converging(multiplier, periods, start=1.0, limit=0.3):
    x = limit + start * multiplier ** np.arange(periods)
    return np.stack([x, np.zeros_like(x)], -1)[:, None]


@pytest.mark.parametrize("multiplier", [0.9, -0.9, 0.999, -0.999])
def test_slow_convergence_is_not_taken_for_a_longer_period(multiplier):
    whole = converging(multiplier, 60_000)
    found = [
        find_recurrence_periods(
            compute_return_distances(whole[: k + 64]), compute_return_distances(whole[:k]), 64, 1.0, np.float64
        )[0]
        for k in range(64, 50_000, 512)
    ]
    first = next(k for k, n in enumerate(found) if n)
    assert set(found[first:]) == {1}
    assert abs(whole[64 + 512 * first + 63, 0, 0] - 0.3) < 1e-7


def test_recurrence_of_longer_periods_and_of_none():
    three = np.tile([[0.1, 0.0], [0.5, 0.2], [-0.4, 0.1]], (50, 1))[:, None]
    golden = np.stack([np.cos(2 * np.pi * 0.6180339887 * np.arange(150)), np.zeros(150)], -1)[:, None]
    both = np.concatenate([three, golden], axis=1)
    apart = compute_return_distances(both)
    assert apart.shape == (MAX_ORBIT_PERIODS, 2) and apart[2, 0] == 0.0 and apart[0, 0] == 0.9
    assert find_recurrence_periods(apart, apart, 64, 1.0, np.float64).tolist() == [3, 0]


def test_points_at_the_walls():
    time = np.array([[0.1, 1.7, np.inf]])
    side, speed = np.array([[-1, 1, 0]]), np.array([[2.0, 3.0, 0.0]])
    points = impacts_as_points(2.1, time, side, speed, 2.0)
    assert points.shape == (2, 4)
    later = impacts_as_points(2.1, time + PERIOD / 2, -side, speed, 2.0)
    assert is_same_orbit(mirror_points(points), later[::-1]) and not is_same_orbit(points, later)
    draws = np.random.default_rng(0).random((3, 2000, 2))
    sets = [np.concatenate([np.full((2000, 1), 10.0), draw, np.zeros((2000, 1))], axis=1) for draw in draws]
    assert samples_fill_same_set(sets[0], sets[1]) and not samples_fill_same_set(
        sets[0], sets[2] + [0.0, 1.5, 0.0, 0.0]
    )
    part = sets[2][sets[2][:, 1] < 0.4]
    assert samples_fill_same_set(part, sets[0]) and samples_fill_same_set(sets[0], part)


def test_states_run_one_by_one_are_those_of_a_block_but_for_a_rounding():
    rng = np.random.default_rng(4)
    start = jv.State(rng.uniform(-1, 1, 9), rng.uniform(-3, 3, 9), np.full(9, 0.4), np.zeros(9))
    for each in (scene(4.65), scene(3.0, walls=(jv.Wall(-1.5, stiffness=90.0, damping=1.0), jv.Wall(1.0)))):
        block = iterate(each, start, 3)
        few = iterate(each, jax.tree.map(lambda leaf: leaf[1:9], start), 3)
        for one, other in zip(jax.tree.leaves(few), jax.tree.leaves(block.select_lanes(slice(1, 9))), strict=True):
            np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-12)


def test_exponent_of_a_free_oscillator_and_what_a_trail_keeps():
    free = scene(1.0, 1.0, 0.02, 0.7, (None, None))
    start = draw_initial_states(free, 3, 0)
    rates, errors = largest_exponents(free, start, 2.0)
    assert abs(rates + 0.02 * 2 * np.pi).max() < 1e-3 and errors.max() < 1e-3
    long, short = iterate(free, start, MAX_RECORDED_PERIODS + 7), iterate(free, start, 3)
    assert long.x.shape == (MAX_RECORDED_PERIODS, 3) and short.x.shape == (3, 3)
    again = iterate(free, iterate(free, start, 7).state, MAX_RECORDED_PERIODS)
    assert (again.x == long.x).all() and (long.state.x == long.x[-1]).all()


@pytest.mark.parametrize(
    "more, key",
    [({"starts": 0}, "starts"), ({"starts": 2.5}, "starts"), ({"seed": -1}, "seed"), ({"settle": -1}, "settle")],
)
def test_counts_that_cannot_be(more, key):
    with pytest.raises(ArgumentError, match=f"^{key}: must be a whole number"):
        jv.find_attractors(scene(), **more)


def test_a_batch_is_refused():
    with pytest.raises(ArgumentError, match=r"^scene: must be a single scene, not a batch; got .*\(2,\)"):
        jv.find_attractors(scene(amplitude=np.array([1.0, 2.0])))
