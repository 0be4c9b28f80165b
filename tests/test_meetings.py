"""Whether two orbits are one, from whichever impact and period they are counted, and how itineraries are written."""

import numpy as np
import pytest

import jaxvibro as jv
from jaxvibro.maps.itinerary import canonical_itinerary
from jaxvibro.orbits.orbit import impacts_as_points, is_same_orbit, mirror_points, repetition_count
from jaxvibro.orbits.orbit_from_impacts import orbit_of_exact_impacts
from jaxvibro.problem.orbit_point import make_orbit_point
from jaxvibro.problem.orbit_problem import make_orbit_problem

from .properties.branches import end_names

NEAR = 1e-6


def drawn_orbit(seed):
    """Return random impacts (times, speeds, sides), periods and frequency of an orbit that is not repeated."""
    rng = np.random.default_rng(seed)
    count, periods, frequency = rng.integers(1, 9), int(rng.integers(1, 5)), rng.uniform(0.3, 5.0)
    times = np.sort(rng.random(count)) * periods * 2.0 * np.pi / frequency
    return (times, rng.uniform(0.01, 2.0, count), rng.choice([-1.0, 1.0], count)), periods, frequency


def points_of(impacts, frequency):
    times, speeds, sides = impacts
    return impacts_as_points(frequency, times, sides, speeds, 1.0)


def turned(impacts, periods, frequency, by):
    """Return the same impacts counted from another period, and from another impact."""
    times, speeds, sides = impacts
    late = np.mod(times - by * 2.0 * np.pi / frequency, periods * 2.0 * np.pi / frequency)
    order = np.argsort(late)
    return late[order], speeds[order], sides[order]


@pytest.mark.parametrize("seed", range(0, 40, 8))
def test_the_same_orbit_is_known_however_it_is_counted(seed):
    for impacts, periods, frequency in map(drawn_orbit, range(seed, seed + 8)):
        rng, (times, speeds, sides) = np.random.default_rng(seed), impacts
        length, points = periods * 2.0 * np.pi / frequency, points_of(impacts, frequency)

        def same(*others, points=points, frequency=frequency):
            return is_same_orbit(points, points_of(others, frequency), NEAR)

        noisy = times + 1e-9 * rng.standard_normal(len(times)), speeds + 1e-9 * rng.standard_normal(len(times)), sides
        assert all(same(*turned(noisy, periods, frequency, by)) for by in range(periods))
        assert is_same_orbit(points, np.roll(points, 1, axis=0), NEAR)
        for again in (2, 3):
            rows = np.tile(speeds, again), np.tile(sides, again)
            late = np.concatenate([times + k * length for k in range(again)])
            repeated = repetition_count(points_of((late, *rows), frequency), again * periods, NEAR)
            assert repeated == again * repetition_count(points, periods, NEAR) and same(late, *rows)
            changed = late, rows[0] + 1e-3 * (np.arange(len(late)) == 0), rows[1]
            assert not same(*changed) and repetition_count(points_of(changed, frequency), again * periods, NEAR) == 1
        assert same(np.append(times, 0.3), np.append(speeds, 1e-9), np.append(sides, 1.0))
        assert not same(times + 1e-3, speeds, sides) and not same(times, speeds, -sides)


@pytest.mark.parametrize("seed", range(20))
def test_mirror_images_are_known(seed):
    impacts, _, frequency = drawn_orbit(seed)
    (times, speeds, sides), half = impacts, np.pi / frequency
    twin, points = points_of((times + half, speeds, -sides), frequency), points_of(impacts, frequency)
    assert is_same_orbit(mirror_points(points), twin, NEAR) and not is_same_orbit(points, twin, NEAR)
    both = np.concatenate([times, times + half]), np.tile(speeds, 2), np.concatenate([sides, -sides])
    assert is_same_orbit(mirror_points(points_of(both, frequency)), points_of(both, frequency), NEAR)


def test_without_impacts_there_is_one_orbit():
    none = points_of(np.zeros((3, 0)), 2.0)
    still = points_of((np.array([0.4]), np.array([0.0]), np.array([1.0])), 2.0)
    assert is_same_orbit(none, still, NEAR) and repetition_count(still, 3, NEAR) == 3
    assert not is_same_orbit(none, points_of((np.array([0.4]), np.array([0.5]), np.array([1.0])), 2.0), NEAR)


def test_an_impact_at_phase_0_belongs_to_the_period_that_ends():
    length = 2.0 * np.pi / 1.7
    problem = make_orbit_problem(jv.make_scene(6.4, 1.7, 0.05, 0.7, (-1.0, 1.0)), "amplitude", periods=1)
    for turn, written in enumerate([("", "L", "LR"), ("L", "L", "R"), ("", "LR", "L"), ("", "L", "LR")]):
        for rounding in (-1e-14, 0.0, 1e-14):
            times = np.array([0.2, 1.0 + turn, 2.5]) * length + rounding
            impacts = list(zip(times, np.ones(3), (-1.0, 1.0, -1.0), strict=True))
            assert make_orbit_point(problem, 6.4, impacts, 3).itinerary == written


@pytest.mark.parametrize("seed", range(0, 40, 8))
def test_an_orbit_is_written_in_one_way_whichever_period_and_impact_come_first(seed):
    for impacts, periods, frequency in map(drawn_orbit, range(seed, seed + 8)):
        rng, scene = np.random.default_rng(seed), jv.make_scene(6.4, frequency, 0.05, 0.7, (-1.0, 1.0))
        orbit, written = orbit_of_exact_impacts(scene, *impacts, periods, 0.0), set()
        problem = make_orbit_problem(scene, "amplitude", periods=1)
        assert orbit.itinerary == canonical_itinerary(orbit.itinerary)
        for by in range(periods):
            times, speeds, sides = turned(impacts, periods, frequency, by)
            for shift in (0, 1, -3):  # impacts are counted from any, of any time round
                late = np.roll(times, shift) + shift * periods * 2.0 * np.pi / frequency
                rows = list(zip(late, np.roll(speeds, shift), np.roll(sides, shift), strict=True))
                written.add(make_orbit_point(problem, 6.4, rows, periods).itinerary)
            noisy = times + 1e-14 * rng.standard_normal(len(times))
            again = orbit_of_exact_impacts(scene, noisy, speeds, sides, periods, 0.0)
            assert again.itinerary == orbit.itinerary
            states = [[each.state.x, each.state.v, each.state.phase] for each in (orbit, again)]
            assert np.allclose(*states, rtol=0, atol=1e-10 * (1.0 + abs(orbit.state.v)))
            assert np.allclose(again.impacts.time, orbit.impacts.time, rtol=0, atol=1e-10)
            assert np.array_equal(again.impacts.side, orbit.impacts.side)
        (only,) = written
        assert only == canonical_itinerary(only)


def test_a_branch_does_not_go_back_along_itself_under_another_itinerary():
    scene = jv.make_scene(2.65936196, 2.49546477, 0.21290041, 0.39377891, (None, 0.48120952))
    orbit = jv.find_orbit(scene, jv.State(-1.584283519492484, 0.5690321935503596))
    branch = jv.follow(orbit, "frequency", (2.4, 4.0))
    assert [part.label for part in branch.segments] == ["P201"] and "HALVED" in end_names(branch)
    values = np.sort([point.value for point in branch.special if point.kind != "EP"])
    assert (np.diff(values) > 1e-6).all()
    (grazing,) = branch.points("GR")
    assert sorted(orbit.label for orbit in grazing.meets).count("P201") == 1
