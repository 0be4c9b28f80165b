"""Motions that rest: labels without a count of hops, the field that says so, and the growth between rests."""

import numpy as np
import pytest
from scipy.optimize import brentq

import jaxvibro as jv
from jaxvibro.maps import itinerary
from jaxvibro.maps.sticking_phase_intervals import find_sticking_phases

# amplitude, frequency, damping, restitution, wall, side: the mass rests on it once a period
BY_HAND = [
    (1.5, 0.5, 0.1, 0.6, -1.0, 1),
    (1.5, 0.5, 0.1, 0.0, -1.0, 1),
    (1.3, 0.4, 0.05, 0.3, 1.0, -1),
    (2.0, 0.7, 0.2, 0.5, -0.8, 1),
    (2.2, 0.3, 0.3, 0.8, 0.5, -1),
]
NEAR = 0.03  # of the growth: hops after those that are flown count with the press as it is


def scene(amplitude, frequency, damping, restitution, wall, side):
    return jv.make_scene(amplitude, frequency, damping, restitution, (None, wall) if side > 0 else (wall, None))


def settled(given, start):
    state = start
    for _ in range(60):
        state, _ = jv.strobe(given, state)
    return state


def next_rest(amplitude, frequency, damping, restitution, wall, side):
    """(growth of a small change from the release to the next rest, the time between), from closed forms of the flight.

    Hops are followed until their speed is 1e-6; the growth is the press there times how the rest's beginning moves, by
    differences.
    """
    force = amplitude / (1.0 - frequency**2 + 2j * damping * frequency)
    root = np.sqrt(1.0 - damping**2)

    def flight(begin, x, v):
        turn = force * np.exp(1j * frequency * begin)
        a, b = x - turn.real, v - (1j * frequency * turn).real

        def at(time):
            s, c, fade = np.sin(root * time), np.cos(root * time), np.exp(-damping * time)
            turn = force * np.exp(1j * frequency * (begin + time))
            x = turn.real + fade * (a * c + (b + damping * a) / root * s)
            return x, (1j * frequency * turn).real + fade * (b * c - (a + damping * b) / root * s)

        return at

    def press(time):
        return side * (amplitude * np.cos(frequency * time) - wall)

    angle = np.arccos(wall / amplitude)
    released = (angle if side * np.sin(angle) > 0 else -angle) / frequency

    def begins(dx, dv):
        time, x, v, step = released, wall + dx, dv, 1e-3
        while True:
            at = flight(time, x, v)

            def gap(late, at=at):
                return side * (wall - at(late)[0])

            late = step
            while time == released and gap(late) <= 1e-12:  # it leaves without speed
                late += step
            while gap(late) > 0:
                late += step
            late = brentq(gap, late - step, late, xtol=1e-15)
            speed = side * at(late)[1]
            time, x, v = time + late, wall, -restitution * at(late)[1]
            if speed < 1e-6 or restitution == 0:
                return time + 2 * restitution * speed / ((1 - restitution) * press(time))
            step = min(1e-2, 0.2 * restitution * speed / press(time))

    rest, shift = begins(0.0, 0.0), -side * 1e-6
    slopes = [(begins(2 * dx, 2 * dv) - begins(dx, dv)) / shift for dx, dv in ((shift, 0.0), (0.0, shift))]
    return press(rest) * np.hypot(*slopes), rest - released


@pytest.mark.parametrize("numbers", BY_HAND)
def test_growth_between_rests_against_the_moments_of_rest(numbers):
    given = scene(*numbers)
    found = find_sticking_phases(given, settled(given, jv.State(numbers[4] - 0.2 * numbers[5], 0.0)), 1)
    growth, span = next_rest(*numbers)
    assert (found.has_sticking, found.count) == (True, 1)
    assert found.chatter_walls == ("" if numbers[3] == 0 else "R" if numbers[5] > 0 else "L")
    assert abs(found.growth_rate * span * numbers[1] / (2 * np.pi) - np.log(growth)) < NEAR


@pytest.mark.parametrize("numbers", BY_HAND[2:4])
def test_growth_between_rests_under_a_force_of_ones_own_is_that_of_the_spring(numbers):
    given = scene(*numbers)
    force = jv.Force("polynomial", {"c1": 1.0, "damping": numbers[2]})
    walls = given.left, given.right
    own = jv.make_scene(*numbers[:2], restitution=numbers[3], walls=walls, force=force)
    start = settled(given, jv.State(numbers[4] - 0.2 * numbers[5], 0.0))
    exact, found = find_sticking_phases(given, start, 1), find_sticking_phases(own, start, 1)
    assert found[:3] == exact[:3] and exact.has_sticking
    assert abs(found.growth_rate - exact.growth_rate) < 1e-6


def test_no_count_of_hops_is_in_a_label():
    """Whatever R is, and so however many hops are flown until they are sure to end."""
    for side in (-1, 1):
        for restitution in (0.2, 0.4, 0.6, 0.8):
            given = scene(1.5, 0.5, 0.1, restitution, -side, side)
            found = jv.find_attractors(given, starts=4)
            (one,) = [one for one in found if one.share > 0]
            assert one.label == one.orbit.label == ("P1-0-inf" if side > 0 else "P1-inf-0")
            assert one.rests and one.orbit.rests and one.mirror_of is None


def test_on_both_walls_and_on_one_that_takes_all_speed():
    both = jv.find_attractors(jv.make_scene(2.0, 0.2, 0.1, 0.4, (-1.0, 1.0)), starts=4)
    assert [(one.label, one.rests, one.share) for one in both] == [("P1-inf-inf", True, 1.0)]
    plastic = jv.find_attractors(jv.make_scene(2.0, 0.4, 0.05, 0.0, (-1.0, 1.0)), starts=4)
    assert [(one.label, one.rests) for one in plastic] == [("P111", True)]
    hit = jv.find_attractors(jv.make_scene(2.0, 2.1, 0.05, 0.7, (-1.0, 1.0)), starts=4)
    assert not any(one.rests or one.orbit.rests for one in hit)


def test_labels():
    assert (
        itinerary.format_label(("RRR",), "R") == "P1-0-inf" and itinerary.format_label(("LR", "L"), "R") == "P2-2-inf"
    )
    assert itinerary.format_label(("L", "RR"), "LR") == "P2-inf-inf" and itinerary.format_label(("LR",)) == "P111"
