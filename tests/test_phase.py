"""An attractor and its orbit are read from one point: phase 0 of one drive period, wherever the impacts are."""

import numpy as np
import pytest
from scipy.optimize import bisect

import jaxvibro as jv


def agree(found):
    """How many periodic attractors there are; the state and the itinerary of each are those of its orbit."""
    periodic = [one for one in found if one.periods]
    for one in periodic:
        assert one.orbit.state.phase == one.state.phase == 0.0 and one.orbit.itinerary == one.itinerary
        assert one.orbit.state.contact == one.state.contact and one.orbit.label == one.label
        apart = max(abs(one.orbit.state.x - one.state.x), abs(one.orbit.state.v - one.state.v))
        assert apart < 1e-7 * (1.0 + abs(one.points).max())
    return len(periodic)


def one_wall(frequency):
    return jv.make_scene(1.0, frequency, 0.05, 0.8, (None, 0.5))


def phase(frequency):
    """Of the impact of P101."""
    orbit = jv.find_orbit(one_wall(frequency), jv.State(0.2, 0.0), periods=1)
    return float(np.mod(frequency * orbit.impacts.time[0] + orbit.state.phase + np.pi, 2 * np.pi) - np.pi)


@pytest.fixture(scope="module")
def crossing():
    """The frequency at which the impact crosses phase 0, not to rounding: there its period is not told."""
    return bisect(phase, 0.9, 1.3, xtol=1e-8)


@pytest.mark.parametrize("off", [-1e-3, -1e-6, -3e-8, 3e-8, 1e-6, 1e-3])
def test_an_impact_near_phase_0(crossing, off):
    found = jv.find_attractors(one_wall(crossing + off), starts=4, settle=100)
    assert agree(found) == 1 and found[0].label == "P101"


def test_long_orbits_in_random_scenes():
    seen, rng = [], np.random.default_rng(8)
    for _ in range(6):
        walls = (-rng.uniform(0.8, 1.6), 1.0)
        found = jv.find_attractors(jv.make_scene(rng.uniform(4.0, 7.5), 2.1, 0.05, 0.7, walls), starts=6, settle=100)
        agree(found)
        seen += [one.periods for one in found if one.periods]
    assert max(seen) >= 3
