"""Isolas: closed branches that no start leads to, against closed forms."""

from dataclasses import replace

import mpmath
import numpy as np
import pytest

import jaxvibro as jv
from jaxvibro.branches.isolas import _wall_orders
from jaxvibro.orbits.impact_equations import ImpactSequence
from jaxvibro.orbits.solve import solve_with_deflation
from tests.reference import closed

GAMMA, R, WALL, AMPLITUDE, BOUNDS = 0.05, 0.7, 1.0, 0.906, (1.0, 5.0)


@pytest.fixture(scope="module")
def diagram():
    """The branch of the motion without impacts, on which no P201 is."""
    scene = jv.make_scene(AMPLITUDE, 2.4, GAMMA, R, (None, WALL))
    branch = jv.follow(jv.find_orbit(scene, jv.State(0.0, 0.0)), "frequency", BOUNDS)
    settings = {"max_period": 2, "seed": 0, "largest_step": 0.1}
    return jv.Diagram("frequency", BOUNDS, scene, (branch,), (), True, "all that was found has been followed", settings)


def test_each_order_of_walls_is_there_once(diagram):
    def told(scene, *given):
        return ["".join("LR"[int(side > 0)] for side in sides) for _, sides in _wall_orders(scene, *given)]

    assert told(diagram.scene, 2, 3) == 2 * ["R", "RR", "RRR"]
    both = jv.make_scene(AMPLITUDE, 2.4, GAMMA, R, (-WALL, WALL))
    assert told(both, 1, 3) == ["L", "R", "LL", "LR", "RR", "LLL", "LLR", "LRR", "RRR"]


def test_from_one_guess_to_both_orbits():
    """P201 at a frequency within the isola are two, of which a guess comes to one, and then to the other."""
    lanes, omega = 4, 2.39
    scene = jv.make_scene(AMPLITUDE, np.full(lanes, omega), GAMMA, R, (None, WALL))
    scene = scene.replace(**{name: np.full(lanes, float(np.ravel(scene.parameter(name))[0])) for name in scene.names})
    true = sorted(float(one.speed) for one in closed.orbits(GAMMA, omega, AMPLITUDE, R, WALL, periods=2))
    blank = np.zeros((lanes, 2))
    times, speeds, sides = blank.copy(), blank.copy(), blank.copy()
    times[:, 0], speeds[:, 0], sides[:, 0] = [1.0, 1.5, 3.5, 4.0], true[1] + 0.1, 1.0
    guesses = ImpactSequence(times, speeds, sides, np.zeros(lanes), np.full(lanes, 2.0))
    _, solved_speeds, is_admissible = solve_with_deflation(scene, guesses, np.full(lanes, 3.0))
    for lane in range(lanes):
        own = solved_speeds[is_admissible[:, lane], lane, 0]
        assert len(own) == len(set(np.round(own, 6)))
    speeds = solved_speeds[..., 0][is_admissible]
    assert all(abs(speeds - each).min() < 1e-12 for each in true)
    assert max(np.sum(is_admissible, axis=0)) == 2


def test_an_isola_is_found_and_closes(diagram):
    (isola,) = jv.find_isolas(diagram, max_period=2, max_impacts=1)
    assert isola.reason["last"].startswith("it closes") and {part.label for part in isola.segments} == {"P201"}
    folds = [one.value for one in isola.points("SN")]
    assert len(folds) == 2
    for value in folds:
        with mpmath.workdps(30):
            assert abs(float(closed.fold(GAMMA, value, R, WALL, periods=2).amplitude) - AMPLITUDE) < 1e-12
    known = replace(diagram, branches=(*diagram.branches, isola))
    assert jv.find_isolas(known, max_period=2, max_impacts=1) == ()
