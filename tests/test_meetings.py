"""Whether two orbits are one, from whichever impact and period they are counted; and the one way in which their
itineraries are written."""

import numpy as np
import pytest

import jaxvibro as jv
from jaxvibro.branches.branch_tree import is_same_point
from jaxvibro.maps import itinerary
from jaxvibro.orbits.orbit_comparison import impacts_as_points, is_same_orbit, mirror_points, repetition_count
from jaxvibro.orbits.orbit_from_impacts import orbit_of_exact_impacts
from jaxvibro.problem.end import End
from jaxvibro.problem.orbit_point import OrbitPoint
from jaxvibro.problem.orbit_point import itinerary_of_point as walls
from tests.test_extend import drawn

NEAR = 1e-6


def drawn_orbit(seed):
    """(random impacts (times, speeds, sides), periods, frequency) of no repeated orbit."""
    rng = np.random.default_rng(seed)
    count, periods, frequency = rng.integers(1, 9), int(rng.integers(1, 5)), rng.uniform(0.3, 5.0)
    times = np.sort(rng.random(count)) * periods * 2.0 * np.pi / frequency
    return (times, rng.uniform(0.01, 2.0, count), rng.choice([-1.0, 1.0], count)), periods, frequency


def seen(impacts, frequency):
    times, speeds, sides = impacts
    return impacts_as_points(frequency, times, sides, speeds, 1.0)


def turned(impacts, periods, frequency, by):
    """The same impacts counted from another period on, and from another impact."""
    times, speeds, sides = impacts
    late = np.mod(times - by * 2.0 * np.pi / frequency, periods * 2.0 * np.pi / frequency)
    order = np.argsort(late)
    return late[order], speeds[order], sides[order]


@pytest.mark.parametrize("seed", range(40))
def test_the_same_orbit_is_known_however_it_is_counted(seed):
    impacts, periods, frequency = drawn_orbit(seed)
    rng, length = np.random.default_rng(seed), periods * 2.0 * np.pi / frequency
    points = seen(impacts, frequency)
    noisy = [each + 1e-9 * rng.standard_normal(len(each)) * (k < 2) for k, each in enumerate(impacts)]
    for by in range(periods):
        assert is_same_orbit(points, seen(turned(noisy, periods, frequency, by), frequency), NEAR)
    assert is_same_orbit(points, np.roll(points, 1, axis=0), NEAR)
    times, speeds, sides = impacts
    for again in (2, 3):
        more = np.concatenate([times + k * length for k in range(again)]), np.tile(speeds, again), np.tile(sides, again)
        assert repetition_count(seen(more, frequency), again * periods, NEAR) == again * repetition_count(
            points, periods, NEAR
        )
        assert is_same_orbit(points, seen(more, frequency), NEAR)
        changed = more[0], more[1] + 1e-3 * (np.arange(len(more[1])) == 0), more[2]
        assert not is_same_orbit(points, seen(changed, frequency), NEAR)
        assert repetition_count(seen(changed, frequency), again * periods, NEAR) == 1
    touch = np.append(times, 0.3), np.append(speeds, 1e-9), np.append(sides, 1.0)
    assert is_same_orbit(points, seen(touch, frequency), NEAR)
    later = times + 1e-3, speeds, sides
    assert not is_same_orbit(points, seen(later, frequency), NEAR)
    assert not is_same_orbit(points, seen((times, speeds, -sides), frequency), NEAR)


@pytest.mark.parametrize("seed", range(20))
def test_mirror_images_are_told(seed):
    impacts, _, frequency = drawn_orbit(seed)
    times, speeds, sides = impacts
    half = np.pi / frequency
    twin = seen((times + half, speeds, -sides), frequency)
    points = seen(impacts, frequency)
    assert is_same_orbit(mirror_points(points), twin, NEAR) and not is_same_orbit(points, twin, NEAR)
    both = np.concatenate([times, times + half]), np.tile(speeds, 2), np.concatenate([sides, -sides])
    own = seen(both, frequency)
    assert is_same_orbit(mirror_points(own), own, NEAR)


def test_without_impacts_there_is_one_orbit():
    none = seen(np.zeros((3, 0)), 2.0)
    still = seen((np.array([0.4]), np.array([0.0]), np.array([1.0])), 2.0)
    assert (
        is_same_orbit(none, still, NEAR)
        and repetition_count(still, 3, NEAR) == 3
        and repetition_count(none, 1, NEAR) == 1
    )
    assert not is_same_orbit(none, seen((np.array([0.4]), np.array([0.5]), np.array([1.0])), 2.0), NEAR)


@pytest.mark.parametrize("seed", range(40))
def test_an_itinerary_is_written_in_one_way(seed):
    impacts, periods, frequency = drawn_orbit(seed)
    written = set()
    for by in range(periods):
        times, speeds, sides = turned(impacts, periods, frequency, by)
        for shift in (0, 1, -3):  # impacts are counted from any, of any time round
            late = np.roll(times, shift) + shift * periods * 2.0 * np.pi / frequency
            spot = OrbitPoint(0.0, late, np.roll(speeds, shift), np.roll(sides, shift), periods, 0.0, 0.0, 0.0)
            written.add(walls(spot, frequency))
    (one,) = written
    assert one == itinerary.canonical_itinerary(one)


def test_an_impact_at_phase_0_belongs_to_the_period_that_ends():
    length = 2.0 * np.pi / 1.7
    for turn, written in enumerate([("", "L", "LR"), ("L", "L", "R"), ("", "LR", "L"), ("", "L", "LR")]):
        for rounding in (-1e-14, 0.0, 1e-14):
            times = np.array([0.2, 1.0 + turn, 2.5]) * length + rounding
            spot = OrbitPoint(0.0, times, np.ones(3), np.array([-1.0, 1.0, -1.0]), 3, 0.0, 0.0, 0.0)
            assert walls(spot, 1.7) == written


@pytest.mark.parametrize("seed", range(40))
def test_an_orbit_is_written_in_one_way_whichever_of_its_periods_came_first(seed):
    impacts, periods, frequency = drawn_orbit(seed)
    scene, rng = jv.make_scene(6.4, frequency, 0.05, 0.7, (-1.0, 1.0)), np.random.default_rng(seed)
    orbit = orbit_of_exact_impacts(scene, *impacts, periods, 0.0)
    assert orbit.itinerary == itinerary.canonical_itinerary(orbit.itinerary)
    for by in range(periods):
        times, speeds, sides = turned(impacts, periods, frequency, by)
        again = orbit_of_exact_impacts(
            scene, times + 1e-14 * rng.standard_normal(len(times)), speeds, sides, periods, 0.0
        )
        assert again.itinerary == orbit.itinerary
        one, other = ([each.state.x, each.state.v, each.state.phase] for each in (orbit, again))
        assert np.allclose(one, other, rtol=0, atol=1e-10 * (1.0 + abs(orbit.state.v)))
        assert np.allclose(again.impacts.time, orbit.impacts.time, rtol=0, atol=1e-10)
        assert np.array_equal(again.impacts.side, orbit.impacts.side)


def test_a_branch_does_not_go_back_along_itself_under_another_itinerary():
    orbit, parameter, _, _ = drawn("one wall", 1)
    branch = jv.follow(orbit, parameter, (2.4, 4.0))
    assert [one.label for one in branch.segments] == ["P201"] and End.HALVED in branch.ends
    kinds = [one for one in branch.special if one.kind != "EP"]
    assert not any(is_same_point(one, other) for k, one in enumerate(kinds) for other in kinds[:k])
    (touch,) = branch.points("GR")
    assert sorted(one.label for one in touch.meets).count("P201") == 1
