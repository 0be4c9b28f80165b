"""An attractor and its orbit are read from one point: phase 0 of one drive period, wherever the impacts are."""

import numpy as np
import pytest
from scipy.optimize import brentq

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


def one_wall(position):
    return jv.make_scene(1.0, 1.7, 0.05, 0.8, (None, position))


def phase(position):
    """Of that impact of P102 which is nearest to phase 0."""
    orbit = jv.find_orbit(one_wall(position), jv.State(position - 0.3, 0.0), periods=1)
    phases = np.mod(1.7 * orbit.impacts.time + orbit.state.phase + np.pi, 2 * np.pi) - np.pi
    return phases[np.argmin(abs(phases))]


@pytest.fixture(scope="module")
def crossing():
    """Where along the wall's position an impact crosses phase 0."""
    return brentq(phase, -0.62, -0.58, xtol=1e-15)


@pytest.mark.parametrize("off", [-3e-4, -1e-7, -1e-12, 0.0, 1e-12, 1e-7, 3e-4])
def test_an_impact_near_phase_0(crossing, off):
    found = jv.find_attractors(one_wall(crossing + off), starts=4, settle=100)
    assert agree(found) == 1 and found[0].label == "P102"


def test_long_orbits_in_random_scenes():
    seen, rng = [], np.random.default_rng(8)
    for _ in range(6):
        walls = (-rng.uniform(0.8, 1.6), 1.0)
        found = jv.find_attractors(jv.make_scene(rng.uniform(4.0, 7.5), 2.1, 0.05, 0.7, walls), starts=6, settle=100)
        agree(found)
        seen += [one.periods for one in found if one.periods]
    assert max(seen) >= 3
