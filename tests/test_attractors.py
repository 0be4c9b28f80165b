"""Attractors from random starts: closed forms and symmetry, chaos and doubt, attractors without a start."""

from math import comb

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxvibro as jv
from jaxvibro.attractors import classify_attractors
from jaxvibro.attractors.basin_fraction_bounds import compute_share_bounds, format_share
from jaxvibro.attractors.recurrence import compute_return_distances, find_recurrence_periods
from jaxvibro.attractors.weak_chaos import assess_weak_chaos
from jaxvibro.maps.initial_conditions import draw_initial_states, forced_amplitude, initial_box
from jaxvibro.maps.iterate import MAX_RECORDED_PERIODS, iterate
from jaxvibro.orbits.orbit_comparison import impacts_as_points, is_same_orbit, mirror_points, samples_fill_same_set
from jaxvibro.scene.symmetry import is_symmetric

PERIOD = 2 * np.pi / 2.1


def scene(amplitude=4.65, frequency=2.1, damping=0.05, restitution=0.7, walls=(-1.0, 1.0), **more):
    return jv.make_scene(amplitude, frequency, damping, restitution, walls, **more)


def moving(position, *motion):
    return jv.Wall(position, motion=jv.Motion(*motion))


def labels(attractors):
    return sorted(attractor.label for attractor in attractors)


def flow(t, damping):
    """Return the homogeneous flow over t, (24)."""
    r = np.sqrt(1 - damping**2)
    s, c = np.sin(r * t), np.cos(r * t)
    return np.exp(-damping * t) / r * np.array([[damping * s + r * c, s], [-s, r * c - damping * s]])


def impact_speeds(amplitude, frequency, damping, r, wall, periods):
    """Return speeds before impact of orbits with one impact on a wall in some periods; half a period: both, in turn."""
    e, sign = flow(periods * 2 * np.pi / frequency, damping), -1.0 if periods == 0.5 else 1.0
    a, b = np.linalg.solve(np.eye(2) - sign * e, np.array([0.0, -1.0]) - sign * e @ np.array([0.0, r]))
    d = (1 - frequency**2) ** 2 + (2 * damping * frequency) ** 2
    roots = np.roots([a**2 + (b / frequency) ** 2, -2 * a * wall, wall**2 - amplitude**2 / d])
    return [root.real for root in roots if abs(root.imag) < 1e-12 and root.real > 0]


@pytest.fixture(scope="module")
def four():
    return jv.find_attractors(scene(4.65), starts=200, seed=0)


def test_two_mirror_pairs_of_period_one(four):
    """A mirror image, strobed at phase pi, comes back as well, with the impacts of the twin half a period later."""
    assert labels(four) == ["P111", "P111", "P112", "P121"]
    assert [one.share for one in four] == sorted((one.share for one in four), reverse=True)
    for place, one in enumerate(four):
        twin = four[one.mirror_of]
        assert one.points.shape == (1, 2) and one.share >= 0.04
        assert twin.mirror_of == place != one.mirror_of and not np.allclose(one.points, twin.points, atol=0.1)
        assert abs(one.least_speed - twin.least_speed) < 1e-10
        back, hits = jv.strobe(scene(), jv.State(-one.state.x, -one.state.v, phase=np.pi), slots=32)
        assert abs(back.x + one.state.x) < 1e-12 and abs(back.v + one.state.v) < 1e-12
        _, expected = jv.strobe(scene(), twin.state, slots=32)
        n = int(hits.count)
        late = np.sort((hits.time[:n] + PERIOD / 2) % PERIOD)
        assert abs(late - np.sort(expected.time[:n])).max() < 1e-11
    assert abs(four[0].exponent - (4 * np.log(0.7) - 2 * 0.05 * PERIOD) / 2) < 1e-12  # half of ln det M


def test_two_chaotic_attractors_and_two_orbits():
    chaos = jv.find_attractors(scene(5.0), starts=200, seed=0)
    assert labels(chaos) == ["P111", "P111", "chaotic", "chaotic"]
    for place, one in enumerate(chaos):
        assert chaos[one.mirror_of].mirror_of == place != one.mirror_of
        assert chaos[one.mirror_of].label == one.label and one.share > 0.05
        if one.kind == "chaotic":
            assert 0.2 < one.exponent < 0.5 and one.periods == 0 and one.itinerary == ()
            assert len(one.points) == 512 and abs(one.points[:, 0]).max() <= 1.0


def test_the_same_for_a_seed(four):
    again = jv.find_attractors(scene(4.65), starts=200, seed=0)
    for one, other in zip(four, again, strict=True):
        assert (one.state.x, one.state.v) == (other.state.x, other.state.v)
        assert np.array_equal(one.orbit.impacts.time, other.orbit.impacts.time)
        for key in vars(one).keys() - {"state", "orbit"}:
            np.testing.assert_array_equal(getattr(one, key), getattr(other, key))
    few = jv.find_attractors(scene(4.65), starts=64, seed=1)
    assert {one.share for one in few} != {one.share for one in four}
    for one in few:
        assert min(abs(one.points - other.points).max() for other in four) < 1e-9


@pytest.mark.parametrize(
    ("numbers", "label", "wall", "periods"),
    [
        ((3.2, 2.1, 0.05, 0.7, (-1.0, 1.0)), "P111", 1.0, 0.5),
        ((2.0, 2.1, 0.05, 0.4, (-1.0, 1.0)), "P111", 1.0, 0.5),
        ((1.0, 1.7, 0.05, 0.8, (None, 0.5)), "P101", 0.5, 1),
    ],
)
def test_impact_speeds_of_closed_forms(numbers, label, wall, periods):
    """(12) to (18): (s - a u)^2 + b^2 u^2 / omega^2 = A^2 / D of walls at s, and at -s if there are two."""
    (one,) = [one for one in jv.find_attractors(scene(*numbers), starts=64) if one.label == label]
    assert min(abs(one.least_speed - root) for root in impact_speeds(*numbers[:4], wall, periods)) < 1e-11
    assert one.mirror_of is None if periods == 1 else one.itinerary in [("LR",), ("RL",)]


def test_no_walls():
    (one,) = jv.find_attractors(scene(2.0, 1.3, 0.1, 0.7, (None, None)), starts=10)
    d = (1 - 1.3**2) ** 2 + (2 * 0.1 * 1.3) ** 2
    assert (one.label, one.share, one.mirror_of, one.least_speed) == ("P100", 1.0, 0, np.inf)
    assert abs(one.points[0] - [2.0 * (1 - 1.3**2) / d, 2.0 * 2 * 0.1 * 1.3**2 / d]).max() < 1e-12
    assert abs(one.exponent + 0.1 * 2 * np.pi / 1.3) < 1e-3


@pytest.mark.parametrize(
    ("numbers", "starts", "settle", "note"),
    [
        (
            (2.0, 2.0, 0.0, 0.7, (None, None)),
            10,
            300,
            "10 starts: recurs but does not attract",
        ),  # driven at twice its own
        ((1.0, 2.1, 0.0, 1.0), 32, 300, "loses no energy"),
        ((0.0, 2.1, 0.0, 1.0, (-1e-3, 1e-3)), 8, 10, "status cap"),
    ],
)
def test_motions_that_do_not_attract_are_unresolved(numbers, starts, settle, note):
    (one,) = jv.find_attractors(scene(*numbers), starts, settle=settle)
    assert (one.label, one.kind, one.share, one.mirror_of) == ("unresolved", "unresolved", 1.0, None)
    assert note in one.note and np.isfinite(one.state.x)


def test_a_mass_that_sticks():
    """Without rebound the mass leaves with the speed of the wall; at phase 0 it still rests on the right wall."""
    (one,) = jv.find_attractors(scene(2.0, 0.4, 0.05, 0.0), starts=24)
    assert (one.label, one.share, one.mirror_of) == ("P111", 1.0, 0)
    assert (one.state.contact, one.state.x, one.state.v, one.exponent) == (2.0, 1.0, 0.0, -np.inf)


def test_many_impacts_in_a_period_are_all_counted():
    many = scene(8.0, 0.25, 0.05, 0.8, (-0.2, 0.2))
    orbits = [one for one in jv.find_attractors(many, starts=16) if one.kind == "periodic"]
    for one in orbits:
        _, impacts = jv.strobe(many, one.state, periods=one.periods, slots=0)
        assert len("".join(one.itinerary)) == int(impacts.count) > 16
    assert orbits


def test_walls_that_move_oppositely_keep_the_symmetry():
    attractors = jv.find_attractors(scene(1.0, walls=(moving(-1.0, 0.2), moving(1.0, 0.2))), starts=64)
    assert labels(attractors) == ["P100", "P111"] and [one.mirror_of for one in attractors] == [0, 1]


def test_single_precision():
    attractors = jv.find_attractors(scene(4.65, dtype=jnp.float32), starts=64)
    assert labels(attractors) == ["P111", "P111", "P112", "P121"]
    assert all(one.mirror_of is not None for one in attractors)


def test_weak_chaos_is_an_attractor():
    """Half of all starts; .0633 +- .0019 by `spectrum`."""
    attractors = jv.find_attractors(scene(6.75, walls=(-1.5, 1.0)), starts=24)
    assert labels(attractors) == ["P232", "chaotic"] and all(one.mirror_of is None for one in attractors)
    weak = next(one for one in attractors if one.label == "chaotic")
    assert abs(weak.exponent - 0.0633) < 0.01 and weak.share > 0.3


def test_where_the_first_estimate_decides_nothing_the_long_one_does(monkeypatch):
    """Two chaotic attractors, mirror images, and two orbits: the same starts on each as with the first estimate."""
    attractors = jv.find_attractors(scene(5.0), starts=32)
    first = classify_attractors.largest_exponents

    def unsure(*numbers):
        rates, errors = first(*numbers)
        return rates, np.where(rates > 0, rates, errors)

    monkeypatch.setattr(classify_attractors, "largest_exponents", unsure)
    again = jv.find_attractors(scene(5.0), starts=32)
    assert labels(again) == ["P111", "P111", "chaotic", "chaotic"]
    assert sorted((one.label, one.share) for one in again) == sorted((one.label, one.share) for one in attractors)
    wild = [one for one in again if one.kind == "chaotic"]
    assert all("standard error of its exponent" in one.note and abs(one.exponent - 0.343) < 0.01 for one in wild)
    monkeypatch.setattr(classify_attractors, "MAX_LONG_ESTIMATES", 0)
    (*orbits, rest) = jv.find_attractors(scene(5.0), starts=32)
    assert [one.kind for one in orbits] == ["periodic"] * 2 and "was not examined for long" in rest.note


def test_regular_motions_are_not_taken_for_chaos():
    lane = jv.State(np.array([0.9]), np.array([-1.1]), np.zeros(1), np.zeros(1))
    rate, why = assess_weak_chaos(scene(4.65), lane)
    assert rate == -np.inf and "recurs" in why
    rate, why = assess_weak_chaos(scene(0.8, damping=0.0, restitution=1.0), lane)  # a shear alone
    assert rate == -np.inf and "not positive beyond doubt" in why


@pytest.mark.parametrize(
    ("numbers", "left", "right", "starts", "seed", "label"),
    [
        # sticks, and comes back exactly after 89 periods; motions beside it stick at other times, and so part
        (
            (4.011518526195045, 3.9798907138615696, 0.021852194891909874),
            jv.Wall(-0.030015241392137855, 0.8227955558704908),
            jv.Wall(0.09577837014114894, 0.481651704997135),
            *(24, 129, "unresolved"),
        ),
        # stretches rounding: each start comes back to within 2e-9 after 21 periods, not nearer
        (
            (9.232569297251565, 2.8247691932145624, 0.03705145883993185),
            jv.Wall(-1.0973329960525258, 0.39300363184360376),
            jv.Wall(-0.1361742873814457, 0.28976850346942545),
            *(24, 152, "P21-21-inf"),
        ),
        # chaos that ends: half of what is not on P100 by 300 periods comes to it in each 2,000 that follow
        (
            (3.674210358882993, 3.8795776672993036, 0.024321744886768443),
            None,
            jv.Wall(0.3044851848205665, 0.5574303349940936),
            *(64, 35, "P100"),
        ),
    ],
)
def test_difficult_motions_that_are_not_chaotic(numbers, left, right, starts, seed, label):
    (one,) = jv.find_attractors(scene(*numbers, 0.5, (left, right)), starts=starts, seed=seed)
    assert (one.label, one.share, one.rests) == (label, 1.0, label == "P21-21-inf")
    assert label != "unresolved" or "sticks to a wall" in one.note


@pytest.mark.parametrize("frequency", [2.1, 1.0, 0.5])
def test_without_damping_the_free_response_does_not_attract(frequency):
    """No start has the time to settle on it."""
    for damping, expected in ((0.0, ["unresolved"]), (0.1, ["P100", "unresolved"])):
        given = scene(1.0, frequency, damping, 0.7, (-1e4, 1e4))
        assert labels(jv.find_attractors(given, 1, settle=1, max_seconds=1e-9)) == expected


def test_the_free_response_is_listed_without_a_start_on_it():
    """Of 4,000 starts 0.8 % settle on it."""
    attractors = jv.find_attractors(scene(3.0), starts=64)
    place, one = next((place, one) for place, one in enumerate(attractors) if one.label == "P100")
    assert one.share == 0.0 and one.share_bounds == compute_share_bounds(0, 64) and one.mirror_of == place
    assert one.orbit.stable and "no start settled on it" in one.note


@pytest.mark.parametrize("amplitude", [4.65, 5.0, 5.6])
def test_mirror_images_are_listed_with_one_start(amplitude):
    for seed in range(3):
        attractors = jv.find_attractors(scene(amplitude), starts=1, seed=seed)
        first, twin = attractors[0], attractors[attractors[0].mirror_of]
        assert [one.share for one in attractors] == [1.0, 0.0][: 1 + (first is not twin)]
        assert twin.mirror_of == 0 and len(twin.label) == len(first.label) and twin.kind == first.kind
        mirrored = "".join(first.itinerary).translate(str.maketrans("LR", "RL"))
        assert "".join(twin.itinerary) in mirrored + mirrored  # from another impact on
        if twin.periods:
            back, _ = jv.strobe(scene(amplitude), jv.State(-twin.state.x, -twin.state.v, np.pi), periods=twin.periods)
            assert abs(back.x + twin.state.x) < 1e-11 and abs(back.v + twin.state.v) < 1e-11


@pytest.mark.parametrize("count, starts", [(1, 200), (7, 200), (100, 200), (199, 200), (3, 4)])
def test_bounds_are_where_the_binomial_tails_are_small(count, starts):
    def at_least(k, p):
        return sum(comb(starts, i) * p**i * (1 - p) ** (starts - i) for i in range(k, starts + 1))

    low, high = compute_share_bounds(count, starts)
    assert abs(at_least(count, low) - 0.025) < 1e-12 and abs(1 - at_least(count + 1, high) - 0.025) < 1e-12


def test_bounds_of_none_and_of_all_and_how_they_are_written():
    assert compute_share_bounds(0, 200) == (0.0, pytest.approx(1 - 0.05 ** (1 / 200), abs=1e-15))
    assert compute_share_bounds(200, 200) == (pytest.approx(0.05 ** (1 / 200), abs=1e-15), 1.0)
    assert compute_share_bounds(0, 1) == (0.0, pytest.approx(0.95, abs=1e-15))

    class Found:
        starts = 200

    texts = []
    for count in (0, 92, 200):
        Found.share, Found.share_bounds = count / 200, compute_share_bounds(count, 200)
        texts.append(format_share(Found))
    both = "46.0 % of starts (38.9 to 53.2 %)"
    assert texts == ["0 of 200 starts: below 1.5 %", both, "200 of 200 starts: above 98.5 %"]


@pytest.mark.parametrize(
    ("walls", "symmetric"),
    [
        ((-1.0, 1.0), True),
        ((None, None), True),
        ((None, 1.0), False),
        ((-1.0, 1.5), False),
        ((jv.Wall(-1.0, restitution=0.5), 1.0), False),
        ((moving(-1.0, 0.1, 0.3), moving(1.0, 0.1, 0.3)), True),
        ((moving(-1.0, 0.1, 0.3, 2), moving(1.0, -0.1, 0.3, 2)), True),
        ((moving(-1.0, 0.1, 0.3, 2), moving(1.0, 0.1, 0.3, 2)), False),
        ((moving(-1.0, 0.1), 1.0), False),
        ((moving(-1.0, 0.0), 1.0), True),
    ],
)
def test_symmetry_of_scenes(walls, symmetric):
    assert is_symmetric(scene(walls=walls)) == symmetric


def test_the_box_of_starts():
    left, right, fast = initial_box(scene(4.65))
    assert (left, right) == (-1.0, 1.0)
    forced = 4.65 / np.hypot(1 - 2.1**2, 2 * 0.05 * 2.1)
    assert abs(forced_amplitude(scene(4.65)) - forced) < 1e-14 and abs(fast - 3 * 2.1 * forced) < 1e-13
    assert initial_box(scene(0.0, walls=(None, 0.5))) == (-2.0, 0.5, 3.0)
    assert initial_box(scene(0.0, walls=(3.0, None)))[:2] == (3.0, 5.0)
    assert initial_box(scene(0.0, walls=(None, None)))[:2] == (-2.0, 2.0)
    assert abs(initial_box(scene(walls=(-1.0, moving(1.0, 0.5, np.pi / 3))))[1] - 1.25) < 1e-15
    assert forced_amplitude(scene(2.0, 1.0, 0.0)) == 2000.0
    some, more = draw_initial_states(scene(), 5, 3), draw_initial_states(scene(), 9, 3)
    assert (some.x == more.x[:5]).all() and (some.v == more.v[:5]).all()
    many = draw_initial_states(scene(walls=(-0.3, 0.8)), 4000, 0)
    assert abs(many.x.mean() - 0.25) < 0.02 and abs(many.v.mean()) < 0.2
    assert many.x.min() >= -0.3 and many.x.max() <= 0.8 and abs(many.v).max() <= fast


def recurrence(points, before):
    """Return the periods after which lanes recur: of points (periods, lanes, 2), and of those 64 periods earlier."""
    later, earlier = compute_return_distances(points), compute_return_distances(before)
    return find_recurrence_periods(later, earlier, 64, 1.0, np.float64)


@pytest.mark.parametrize("multiplier", [0.9, -0.9, 0.999, -0.999])
def test_slow_convergence_is_not_taken_for_a_longer_period(multiplier):
    x = 0.3 + multiplier ** np.arange(60_000)
    whole = np.stack([x, np.zeros_like(x)], -1)[:, None]
    periods = [recurrence(whole[: k + 64], whole[:k])[0] for k in range(64, 50_000, 512)]
    first = next(k for k, n in enumerate(periods) if n)
    assert set(periods[first:]) == {1}
    assert abs(whole[64 + 512 * first + 63, 0, 0] - 0.3) < 1e-7


def test_recurrence_of_longer_periods_and_of_none():
    three = np.tile([[0.1, 0.0], [0.5, 0.2], [-0.4, 0.1]], (50, 1))[:, None]
    golden = np.stack([np.cos(2 * np.pi * 0.6180339887 * np.arange(150)), np.zeros(150)], -1)[:, None]
    both = np.concatenate([three, golden], axis=1)
    apart = compute_return_distances(both)
    assert apart.shape == (32, 2) and apart[2, 0] == 0.0 and apart[0, 0] == 0.9
    assert recurrence(both, both).tolist() == [3, 0]


def test_points_at_the_walls():
    time = np.array([[0.1, 1.7, np.inf]])
    side, speed = np.array([[-1, 1, 0]]), np.array([[2.0, 3.0, 0.0]])
    points = impacts_as_points(2.1, time, side, speed, 2.0)
    assert points.shape == (2, 4)
    later = impacts_as_points(2.1, time + PERIOD / 2, -side, speed, 2.0)
    assert is_same_orbit(mirror_points(points), later[::-1]) and not is_same_orbit(points, later)
    draws = np.random.default_rng(0).random((3, 2000, 2))
    sets = [np.concatenate([np.full((2000, 1), 10.0), draw, np.zeros((2000, 1))], axis=1) for draw in draws]
    assert samples_fill_same_set(sets[0], sets[1])
    assert not samples_fill_same_set(sets[0], sets[2] + [0.0, 1.5, 0.0, 0.0])
    part = sets[2][sets[2][:, 1] < 0.4]
    assert samples_fill_same_set(part, sets[0]) and samples_fill_same_set(sets[0], part)


@pytest.mark.parametrize("left", [-1.0, jv.Wall(-1.5, stiffness=90.0, damping=1.0)])
def test_states_run_one_by_one_are_those_of_a_block_but_for_a_rounding(left):
    rng, given = np.random.default_rng(4), scene(3.0, walls=(left, 1.0))
    start = jv.State(rng.uniform(-1, 1, 9), rng.uniform(-3, 3, 9), np.full(9, 0.4), np.zeros(9))
    block = iterate(given, start, 3)
    few = iterate(given, jax.tree.map(lambda leaf: leaf[1:9], start), 3)
    for one, other in zip(jax.tree.leaves(few), jax.tree.leaves(block.select_lanes(slice(1, 9))), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-12)


def test_exponent_of_a_free_oscillator_and_the_periods_that_are_recorded():
    free = scene(1.0, 1.0, 0.02, 0.7, (None, None))
    start = draw_initial_states(free, 3, 0)
    rates, errors = classify_attractors.largest_exponents(free, start, 2.0)
    assert abs(rates + 0.02 * 2 * np.pi).max() < 1e-3 and errors.max() < 1e-3
    long, short = iterate(free, start, MAX_RECORDED_PERIODS + 7), iterate(free, start, 3)
    assert long.x.shape == (MAX_RECORDED_PERIODS, 3) and short.x.shape == (3, 3)
    again = iterate(free, iterate(free, start, 7).state, MAX_RECORDED_PERIODS)
    assert (again.x == long.x).all() and (long.state.x == long.x[-1]).all()


@pytest.mark.parametrize(
    ("key", "value", "rule"),
    [
        ("starts", 0, "must be a whole number"),
        ("starts", 2.5, "must be a whole number"),
        ("seed", -1, "must be a whole number"),
        ("settle", -1, "must be a whole number"),
        ("scene", scene(np.array([1.0, 2.0])), r"must be a single scene, not a batch; got .*\(2,\)"),
    ],
)
def test_invalid_arguments_are_refused(key, value, rule):
    with pytest.raises(jv.ArgumentError, match=f"^{key}: {rule}"):
        jv.find_attractors(**{"scene": scene()} | {key: value})
