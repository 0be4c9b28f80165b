"""Attractors from random starts: mirror images, chaos and doubt, attractors without a start, the draw of the starts."""

from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest

import jaxvibro as jv
from jaxvibro.attractors import classify_attractors
from jaxvibro.attractors.basin_fraction_bounds import format_share
from jaxvibro.attractors.transients import compute_return_distances, find_recurrence_periods
from jaxvibro.attractors.weak_chaos import assess_weak_chaos
from jaxvibro.maps.initial_conditions import draw_initial_states

PERIOD = 2 * np.pi / 2.1


def scene(amplitude=4.65, frequency=2.1, damping=0.05, restitution=0.7, walls=(-1.0, 1.0), **more):
    return jv.make_scene(amplitude, frequency, damping, restitution, walls, **more)


def moving(position, *motion):
    return jv.Wall(position, motion=jv.Motion(*motion))


def labels(attractors):
    return sorted(attractor.label for attractor in attractors)


@pytest.fixture(scope="module")
def four():
    return jv.find_attractors(scene(), starts=200, seed=0)


@pytest.fixture(scope="module")
def chaos():
    return jv.find_attractors(scene(5.0), starts=32)


def test_two_mirror_pairs_of_period_one(four):
    """A mirror image, strobed at phase pi, comes back as well, with the impacts of the twin half a period later."""
    assert labels(four) == ["P111", "P111", "P112", "P121"]
    assert [attractor.share for attractor in four] == sorted((attractor.share for attractor in four), reverse=True)
    for index, attractor in enumerate(four):
        twin = four[attractor.mirror_of]
        assert attractor.points.shape == (1, 2) and attractor.share >= 0.04
        assert twin.mirror_of == index != attractor.mirror_of
        assert not np.allclose(attractor.points, twin.points, atol=0.1)
        back, hits = jv.strobe(scene(), jv.State(-attractor.state.x, -attractor.state.v, phase=np.pi), slots=32)
        assert abs(back.x + attractor.state.x) < 1e-12 and abs(back.v + attractor.state.v) < 1e-12
        _, expected = jv.strobe(scene(), twin.state, slots=32)
        n = int(hits.count)
        late = np.sort((hits.time[:n] + PERIOD / 2) % PERIOD)
        assert abs(late - np.sort(expected.time[:n])).max() < 1e-11
    assert abs(four[0].exponent - (4 * np.log(0.7) - 2 * 0.05 * PERIOD) / 2) < 1e-12  # half of ln det M


def test_two_chaotic_attractors_and_two_orbits(chaos):
    assert labels(chaos) == ["P111", "P111", "chaotic", "chaotic"]
    for index, attractor in enumerate(chaos):
        twin = chaos[attractor.mirror_of]
        assert twin.mirror_of == index != attractor.mirror_of and twin.label == attractor.label
        if attractor.kind == "chaotic":
            assert 0.2 < attractor.exponent < 0.5 and attractor.periods == 0 and attractor.itinerary == ()
            assert len(attractor.points) == 512 and abs(attractor.points[:, 0]).max() <= 1.0


def test_where_the_first_estimate_decides_nothing_the_long_one_does(chaos, monkeypatch):
    """Two chaotic attractors, mirror images, and two orbits: the same starts on each as with the first estimate."""
    first = classify_attractors.largest_exponents

    def unsure(*numbers):
        rates, errors = first(*numbers)
        return rates, np.where(rates > 0, rates, errors)

    monkeypatch.setattr(classify_attractors, "largest_exponents", unsure)
    again = jv.find_attractors(scene(5.0), starts=32)
    shares = [sorted((attractor.label, attractor.share) for attractor in each) for each in (again, chaos)]
    assert shares[0] == shares[1]
    for attractor in again:
        if attractor.kind == "chaotic":
            assert "standard error of its exponent" in attractor.note and abs(attractor.exponent - 0.343) < 0.01
    monkeypatch.setattr(classify_attractors, "MAX_LONG_ESTIMATES", 0)
    (*orbits, rest) = jv.find_attractors(scene(5.0), starts=32)
    assert [orbit.kind for orbit in orbits] == ["periodic"] * 2 and "was not examined for long" in rest.note


@pytest.mark.parametrize(
    ("exponent", "certain", "reason"),
    [(0.3, False, None), (np.nan, True, None), (np.nan, False, "evidence"), (-np.inf, True, "evidence")],
)
def test_the_long_estimate_decides_unless_it_cannot(exponent, certain, reason, monkeypatch):
    monkeypatch.setattr(classify_attractors, "assess_weak_chaos", lambda *arguments: (exponent, "evidence"))
    candidate, examined = SimpleNamespace(impact_points=np.zeros((4, 3)), attractor_fields={}), []
    assert classify_attractors._rejection_reason(None, None, candidate, examined, certain) == reason
    assert candidate.attractor_fields == ({"exponent": 0.3, "note": "evidence"} if exponent == 0.3 else {})
    assert [known for _, known in examined] == [reason]


def test_the_same_for_a_seed(four):
    for attractor, other in zip(jv.find_attractors(scene(), starts=200, seed=0), four, strict=True):
        assert (attractor.state.x, attractor.state.v) == (other.state.x, other.state.v)
        for key in vars(attractor).keys() - {"state", "orbit"}:
            np.testing.assert_array_equal(getattr(attractor, key), getattr(other, key))
    few = jv.find_attractors(scene(), starts=64, seed=1)
    assert {attractor.share for attractor in few} != {attractor.share for attractor in four}
    for attractor in few:
        assert min(abs(attractor.points - other.points).max() for other in four) < 1e-9


@pytest.mark.parametrize(
    ("given", "starts", "expected", "mirror_of"),
    [
        (scene(2.0, 1.3, 0.1, walls=(None, None)), 10, ["P100"], [0]),
        (scene(1.0, walls=(moving(-1.0, 0.2), moving(1.0, 0.2))), 64, ["P100", "P111"], [0, 1]),
        (scene(1.0, walls=(moving(-1.0, 0.0), moving(1.0, 0.0, 1.0))), 64, ["P100", "P111"], [0, 1]),
        (scene(dtype=jnp.float32), 64, ["P111", "P111", "P112", "P121"], [0, 1, 2, 3]),
        (scene(2.0, 0.4, 0.05, 0.0), 24, ["P111"], [0]),  # the mass sticks to the walls for some time
        (scene(6.75, walls=(-1.5, 1.0)), 24, ["P232", "chaotic"], [None, None]),
    ],
    ids=["no walls", "opposite walls", "no motion", "single precision", "sticking", "weak chaos"],
)
def test_labels_and_mirror_images(given, starts, expected, mirror_of):
    attractors = jv.find_attractors(given, starts)
    assert labels(attractors) == expected
    assert sorted([attractor.mirror_of for attractor in attractors], key=str) == mirror_of
    for attractor in attractors:
        if attractor.rests:  # it leaves with the speed of the wall; at phase 0 it still sticks to the right one
            assert (attractor.state.contact, attractor.state.x, attractor.state.v) == (2.0, 1.0, 0.0)
            assert attractor.exponent == -np.inf
        if attractor.kind == "chaotic":  # .0633 +- .0019 by `spectrum`
            assert abs(attractor.exponent - 0.0633) < 0.01 and attractor.share > 0.3


@pytest.mark.parametrize(
    ("numbers", "starts", "settle", "note"),
    [
        ((2.0, 2.0, 0.0, 0.7, (None, None)), 10, 300, "10 starts: recurs but does not attract"),
        ((1.0, 2.1, 0.0, 1.0), 32, 300, "loses no energy"),
        ((0.0, 2.1, 0.0, 1.0, (-1e-3, 1e-3)), 8, 10, "status cap"),
    ],
)
def test_motions_that_do_not_attract_are_unresolved(numbers, starts, settle, note):
    (attractor,) = jv.find_attractors(scene(*numbers), starts, settle=settle)
    assert (attractor.label, attractor.kind, attractor.share, attractor.mirror_of) == (*["unresolved"] * 2, 1.0, None)
    assert note in attractor.note and np.isfinite(attractor.state.x)


def test_many_impacts_in_a_period_are_all_counted():
    many = scene(8.0, 0.25, 0.05, 0.8, (-0.2, 0.2))
    orbits = [attractor for attractor in jv.find_attractors(many, starts=16) if attractor.kind == "periodic"]
    for orbit in orbits:
        _, impacts = jv.strobe(many, orbit.state, periods=orbit.periods, slots=0)
        assert len("".join(orbit.itinerary)) == int(impacts.count) > 16
    assert orbits


def test_regular_motions_are_not_taken_for_chaos():
    lane = jv.State(np.array([0.9]), np.array([-1.1]), np.zeros(1), np.zeros(1))
    elastic = scene(0.8, damping=0.0, restitution=1.0)  # a shear alone
    for given, reason in ((scene(), "recurs"), (elastic, "not positive beyond doubt")):
        rate, why = assess_weak_chaos(given, lane)
        assert rate == -np.inf and reason in why


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
    (attractor,) = jv.find_attractors(scene(*numbers, 0.5, (left, right)), starts=starts, seed=seed)
    assert (attractor.label, attractor.share, attractor.rests) == (label, 1.0, label == "P21-21-inf")
    assert label != "unresolved" or "sticks to a wall" in attractor.note


@pytest.mark.parametrize("frequency", [2.1, 1.0, 0.5])
def test_without_damping_the_free_response_does_not_attract(frequency):
    """No start has the time to settle on it."""
    for damping, expected in ((0.0, ["unresolved"]), (0.1, ["P100", "unresolved"])):
        given = scene(1.0, frequency, damping, 0.7, (-1e4, 1e4))
        assert labels(jv.find_attractors(given, 1, settle=1, max_seconds=1e-9)) == expected


def test_the_free_response_is_listed_without_a_start_on_it():
    """Of 4,000 starts 0.8 % settle on it."""
    attractors = jv.find_attractors(scene(3.0), starts=64)
    (free,) = [attractor for attractor in attractors if attractor.label == "P100"]
    assert free.share == 0.0 and free.share_bounds == (0.0, pytest.approx(1.0 - 0.05 ** (1.0 / 64.0), abs=1e-15))
    assert attractors[free.mirror_of] is free and free.orbit.stable and "no start settled on it" in free.note


@pytest.mark.parametrize("amplitude", [4.65, 5.0, 5.6])
def test_mirror_images_are_listed_with_one_start(amplitude):
    for seed in range(3):
        attractors = jv.find_attractors(scene(amplitude), starts=1, seed=seed)
        first, twin = attractors[0], attractors[attractors[0].mirror_of]
        assert [attractor.share for attractor in attractors] == [1.0, 0.0][: 1 + (first is not twin)]
        assert twin.mirror_of == 0 and len(twin.label) == len(first.label) and twin.kind == first.kind
        mirrored = "".join(first.itinerary).translate(str.maketrans("LR", "RL"))
        assert "".join(twin.itinerary) in mirrored + mirrored  # from another impact on
        if twin.periods:
            back, _ = jv.strobe(scene(amplitude), jv.State(-twin.state.x, -twin.state.v, np.pi), periods=twin.periods)
            assert abs(back.x + twin.state.x) < 1e-11 and abs(back.v + twin.state.v) < 1e-11


@pytest.mark.parametrize(
    ("share", "bounds", "text"),
    [
        (0.0, (0.0, 0.01487), "0 of 200 starts: below 1.5 %"),
        (0.46, (0.3894, 0.5317), "46.0 % of starts (38.9 to 53.2 %)"),
        (1.0, (0.98513, 1.0), "200 of 200 starts: above 98.5 %"),
    ],
)
def test_shares_are_written_with_their_bounds(share, bounds, text):
    assert format_share(SimpleNamespace(share=share, starts=200, share_bounds=bounds)) == text


@pytest.mark.parametrize(
    ("given", "left", "right", "fast"),
    [
        (scene(), -1.0, 1.0, 3.0 * 2.1 * 4.65 / np.hypot(1.0 - 2.1**2, 2.0 * 0.05 * 2.1)),
        (scene(0.0, walls=(None, 0.5)), -2.0, 0.5, 3.0),
        (scene(0.0, walls=(3.0, None)), 3.0, 5.0, 3.0),
        (scene(2.0, 1.0, 0.0, walls=(None, None)), -4000.0, 4000.0, 6000.0),
        (scene(0.0, walls=(-1.0, moving(1.0, 0.5, np.pi / 3))), -1.0, 1.25, 3.0),
    ],
)
def test_starts_fill_their_box(given, left, right, fast):
    few, many = draw_initial_states(given, 5, 3), draw_initial_states(given, 4000, 3)
    assert (few.x == many.x[:5]).all() and (few.v == many.v[:5]).all()
    for values, low, high in ((many.x, left, right), (many.v, -fast, fast)):
        assert low <= values.min() < low + 0.01 * (high - low) and high - 0.01 * (high - low) < values.max() <= high
        assert abs(values.mean() - 0.5 * (low + high)) < 0.02 * (high - low)


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
