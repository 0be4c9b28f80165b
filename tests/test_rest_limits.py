"""Time limits, and the number of flights, where a branch approaches a complete chatter."""

import numpy as np
import pytest

import jaxvibro as jv
from continuation import augmented_systems, branch_segment
from jaxvibro.branches import itinerary_segment
from jaxvibro.problem import curve_ends
from jaxvibro.problem.orbit_point import problem_of_orbit


@pytest.fixture(scope="module")
def resting_orbit():
    """(`OrbitProblem`, z) of an orbit of one period with one rest."""
    scene = jv.make_scene(1.5, 0.5, 0.05, 0.5, (None, 0.5))
    orbit = jv.find_orbit(scene, jv.State(0.0, 0.0))
    assert orbit.rests
    return problem_of_orbit(orbit, "amplitude")


def test_a_measure_of_a_rest_is_looked_for_by_what_it_depends_on(resting_orbit, monkeypatch):
    """A measure of a row depends on a few unknowns: its derivative by these is that by all, and each evaluation flies a
    whole chatter."""
    along, z = resting_orbit
    count, given = [], curve_ends.excess_speeds
    row = int(np.flatnonzero(np.isfinite(given(along, z)))[0])
    whole = augmented_systems.two_point_derivative(lambda z: given(along, z)[row], z)
    assert np.count_nonzero(whole) > 2 and len(z) >= 17

    def counted(along, z):
        count.append(z)
        return given(along, z)

    seen = []
    none = augmented_systems.RootAndResidual(None, np.nan)
    monkeypatch.setattr(
        augmented_systems, "solve_newton", lambda system, start: seen.append(system(start)[1][-1]) or none
    )
    curve_ends.locate_sticking_limit(along, z, row, counted)
    np.testing.assert_array_equal(seen[0], whole)
    assert len(count) <= 11 < 2 * len(z)


def test_the_search_beyond_a_rest_is_given_up_when_the_time_is_over(resting_orbit, monkeypatch):
    """Neither looks for another orbit then: that would fly for dozens of periods."""
    along, z = resting_orbit
    over = branch_segment.Limits(deadline=0.0)
    monkeypatch.setattr(itinerary_segment, "_settled_orbit", lambda *given: pytest.fail("it is looked for"))
    monkeypatch.setattr(curve_ends, "toggle_early_lift_off", lambda *given: None)
    assert itinerary_segment.find_sticking_exits(along, z, 1.0, over) is None
    assert itinerary_segment.locate_nearby_chatter(along, z, 1.0, over) is None
