"""Properties of single periodic orbits that hold for every kind of scene."""

from dataclasses import replace

import jax
import mpmath
import numpy as np

import jaxvibro as jv
from tests import truths
from tests.kinds import LANES
from tests.reference.search import Discard
from tests.tiers import generator, of_numbers

from .motions import move, rebuild, take
from .orbits import Simulation, assert_is_orbit, assert_roots_agree, settled_orbit, size_of, sorted_roots, stack


@of_numbers
def test_orbit(kind, number):
    """An orbit is what a simulation gives, repeats in no shorter time, and is found again from its state."""
    orbit = settled_orbit(kind, number)
    simulation = Simulation(kind, [orbit], differentiate=True)
    assert assert_is_orbit(orbit, simulation, 0, kind.tolerance)
    assert orbit.residual < 1e3 * kind.tolerance * size_of(orbit)
    if not orbit.rests:
        growth = simulation.growth(0)
        bound = 1e5 * kind.tolerance * size_of(orbit) * growth**2 / min(1.0, orbit.least_speed)
        assert_roots_agree(orbit.multipliers, simulation.derivatives[0], bound)
    for periods in range(1, orbit.periods):
        if orbit.periods % periods == 0:
            shorter = Simulation(kind, [replace(orbit, periods=periods)])
            assert shorter.miss(0) > 1e-7 * size_of(orbit)
    again = jv.find_orbit(orbit.scene, orbit.state, settle=0)
    assert (again.label, again.itinerary) == (orbit.label, orbit.itinerary)
    assert abs(again.state.x - orbit.state.x) + abs(again.state.v - orbit.state.v) < 1e-9 * size_of(orbit)


def _with_truth(kind, number):
    """Return an orbit and its motion by the reference implementation; None if rounding decides its impacts."""
    orbit = settled_orbit(kind, number)
    if kind.truth is truths.contact_series and orbit.periods > 1:
        return None
    start = (float(part) for part in (orbit.state.x, orbit.state.v, orbit.state.phase))
    try:
        return orbit, kind.truth(orbit.scene, *start, periods=orbit.periods)
    except Discard:
        return None


@of_numbers
def test_reference(kind, number):
    """The reference implementation comes back to the state of an orbit, with its multipliers."""
    orbit, truth = next(filter(None, (_with_truth(kind, number + k) for k in (0, 1000, 2000, 3000))))
    bound = 1e2 * kind.tolerance * truth.allowed * (1.0 + abs(orbit.multipliers[0]))
    assert abs(float(truth.x - orbit.state.x)) + abs(float(truth.v - orbit.state.v)) < bound
    if truth.matrix is not None:
        assert [int(side) for side in orbit.impacts.side] == list(truth.sides)
        slack = max(bound, 1e-7 * (not kind.exact)) * (1.0 + abs(truth.matrix).max())
        assert_roots_agree(orbit.multipliers, truth.matrix, slack / min(1.0, orbit.least_speed))
        if kind.exact:
            for time, speed, own_time, own_speed in zip(
                truth.times, truth.speeds, orbit.impacts.time, orbit.impacts.speed, strict=True
            ):
                with mpmath.workdps(30):
                    assert abs(float(time - own_time)) * orbit.least_speed < bound
                    assert abs(float(speed - own_speed)) < bound


@of_numbers
def test_mirror(kind, number):
    """The mirror image of an orbit is an orbit of the mirrored scene, with the same multipliers."""
    orbit = settled_orbit(kind, number)

    def flip(wall):
        return move(wall, -wall.position, lambda b, *rest: (-b, *rest))

    scene = rebuild(orbit.scene, flip, (1, 0), -1.0)
    state = jv.State(*(-orbit.state.x, -orbit.state.v), orbit.state.phase, -1.0 * orbit.state.contact)
    image = jv.find_orbit(scene, state, settle=0)
    size = size_of(orbit)
    turned = tuple(word.translate(str.maketrans("LR", "RL")) for word in orbit.itinerary)
    assert sorted(turned) == sorted(image.itinerary) and image.rests == orbit.rests
    np.testing.assert_allclose(np.sort(image.impacts.speed), np.sort(orbit.impacts.speed), rtol=0, atol=1e-9 * size)
    difference = abs(sorted_roots(image.multipliers) - sorted_roots(orbit.multipliers)).max()
    assert difference < 1e-4 * (1.0 + abs(orbit.multipliers[0]))  # a double multiplier changes by the root of an error
    assert abs(image.multipliers.prod() - orbit.multipliers.prod()) < 1e-7 * (1.0 + abs(orbit.multipliers.prod()))


def _near(kind, number):
    """Return an orbit, and a batch of scenes near its own, the first of them its own; None of orbits that rest."""
    orbit = settled_orbit(kind, number)
    if orbit.rests:
        return None
    scene, state = stack(kind, [orbit])
    rng = generator(kind, number)
    factors = 1.0 + 1e-5 * min(1.0, orbit.least_speed) ** 2 * np.append(0.0, rng.uniform(-1.0, 1.0, LANES - 1))
    return orbit, scene.replace(amplitude=scene.amplitude * factors), state


@of_numbers
def test_solve_orbits(kind, number):
    """The orbits of a batch are those that `find_orbit` finds one by one."""
    given = _near(kind, number)
    if given is None:
        return
    orbit, scenes, state = given
    size = size_of(orbit)
    solutions = jax.device_get(jv.solve_orbits(scenes, state, orbit.itinerary))
    assert solutions.times.shape == (LANES, orbit.impacts.count)
    assert (solutions.status == jv.SolutionStatus.OK).all()
    first = take(solutions, 0)
    assert abs(first.state.x - orbit.state.x) + abs(first.state.v - orbit.state.v) < 1e-9 * size
    np.testing.assert_allclose(np.sort(first.speeds), np.sort(orbit.impacts.speed), rtol=0, atol=1e-9 * size)
    lane = LANES - 1
    alone = jv.find_orbit(take(scenes, lane), orbit.state, orbit.periods, settle=0)
    difference = alone.state.x - solutions.state.x[lane], alone.state.v - solutions.state.v[lane]
    assert max(map(abs, difference)) < 1e-9 * size
    product = np.prod(np.asarray(solutions.multipliers[lane]))
    assert abs(product - alone.multipliers.prod()) < 1e-7 * (1.0 + abs(alone.multipliers[0]) ** 2)


@of_numbers
def test_gradient(kind, number):
    """The derivative of a solved orbit is that of differences of orbits."""
    given = _near(kind, number)
    if given is None:
        return
    orbit, scenes, _ = given
    scene = take(scenes, 0)

    def measure(amplitude):
        solution = jv.solve_orbits(scene.replace(amplitude=amplitude), orbit.state, orbit.itinerary)
        return solution.state.x + solution.speeds.sum() + abs(solution.multipliers).sum()

    value, step = float(scene.amplitude), 1e-4 * min(1.0, orbit.least_speed) ** 2
    gradient = float(jax.jit(jax.grad(measure))(value))
    near, far = (float(measure(value + k * step) - measure(value - k * step)) for k in (1, 2))
    expected = (8.0 * near - far) / (12.0 * step)
    assert abs(gradient - expected) < 1e-5 * (1.0 + abs(expected)) / min(1.0, orbit.least_speed) ** 2
