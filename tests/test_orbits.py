"""Periodic orbits against closed forms, automatic differentiation and an independent search; what is no orbit."""

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest

import jaxvibro as jv
from jaxvibro.contact.kinds import make_flow_coefficients
from jaxvibro.orbits.flight_clearance import _nearer_turning_point
from jaxvibro.orbits.impact_equations import ImpactSequence, residual_and_jacobian, solve_cyclic
from jaxvibro.orbits.orbit_from_impacts import _require_certified, orbit_from_impacts, padded_sequence, solve_guess
from jaxvibro.orbits.shooting import _newton_step

from . import figure_4
from .figure_4 import GAMMA, OMEGA, R
from .kinds import wall_ends
from .reference import closed, grid

PERIOD = 2 * np.pi / OMEGA
OK, _, VIRTUAL, NONE = jv.SolutionStatus


@pytest.fixture(scope="module")
def scene():
    return figure_4.scene(4.65)


def agrees(orbit, state, multipliers):
    assert abs(float(state[0] - orbit.state.x)) < 1e-12
    assert abs(float(state[1] - orbit.state.v)) < 1e-12
    true = sorted((complex(each) for each in multipliers), key=lambda each: (-abs(each), -each.imag))
    assert np.allclose(orbit.multipliers, true, rtol=0, atol=1e-12 * max(1, abs(true[0])))


@pytest.mark.parametrize("right", [1.0, jv.Wall(1.0, 0.6, motion=jv.Motion(0.1, 0.4, 2))])
def test_the_jacobian_of_the_impacts_equations_is_their_derivative(right):
    built = make_flow_coefficients(jv.make_scene(2.0, OMEGA, GAMMA, R, (-1.0, right)))
    unknowns = jnp.array([0.2, 1.1, 1.9, 1.0, 0.4, 2.0])

    def equations(unknowns):
        sides = jnp.array([1.0, -1.0, 1.0])
        return residual_and_jacobian(built, ImpactSequence(unknowns[:3], unknowns[3:], sides, 0.3, 1.0))

    value, change = jax.jit(lambda z: (equations(z)[0], solve_cyclic(*equations(z)[::-1])[0]))(unknowns)
    jacobian = jax.jit(jax.jacfwd(lambda z: equations(z)[0]))(unknowns)
    assert np.allclose(jacobian @ change, value, rtol=0, atol=1e-12)


def test_the_motion_without_impacts(scene):
    for amplitude in (0.5, 3.0, 3.35):
        with mpmath.workdps(40):
            state = closed.forced(GAMMA, OMEGA, amplitude, 0)
        start = jv.State(0.01 + float(state[0]), float(state[1]))
        orbit = jv.find_orbit(scene.replace(amplitude=amplitude), start, settle=0)
        assert orbit.label == "P100" and orbit.unknowns == "state"
        agrees(orbit, state, np.exp(PERIOD * np.roots([1.0, 2 * GAMMA, 1.0])))
        assert abs(orbit.least_clearance - (1 - amplitude / float(closed.grazing(GAMMA, OMEGA, 1)))) < 1e-12


@pytest.mark.parametrize(
    "amplitude, side, periods", [(0.6, 0, 1), (2.0, 0, 1), (5, 1, 1), (5, 1, 2), (5, 1, 3), (5, -1, 1)]
)
def test_orbits_of_closed_forms(amplitude, side, periods):
    """Both symmetric orbits of one impact on each wall (side 0), and those with one impact on one wall in n periods."""
    omega, wall = (2.0 * periods + 0.1, 0.05 * side) if side else (OMEGA, 1.0)
    walls = {1: (None, wall), -1: (wall, None), 0: (-1.0, 1.0)}[side]
    scene, stable = jv.make_scene(amplitude, omega, GAMMA, R, walls), []
    for one in closed.orbits(GAMMA, omega, amplitude, R, wall, side or 1, periods, not side):
        with mpmath.workdps(40):
            state = closed.at_phase(GAMMA, omega, amplitude, one, 0, not side)
            multipliers = closed.multipliers(GAMMA, omega, amplitude, R, one, periods, not side)
        try:
            orbit = jv.find_orbit(scene, jv.State(*map(float, state)), periods=periods, settle=0)
        except jv.OrbitError as error:
            assert side and "not admissible" in error.status
            continue
        assert orbit.label == f"P{periods}{int(side <= 0)}{int(side >= 0)}" and orbit.residual < 1e-12
        agrees(orbit, state, multipliers)
        assert abs(float(one.speed) - orbit.least_speed) < 1e-12
        stable.append(orbit.stable)
    assert stable == [True, False] if side == 0 else stable


def test_all_orbits_of_period_one(scene):
    orbits = jv.find_orbits(scene, max_period=1, starts=40)
    # by an independent search on a grid: tests/reference/grid.py
    found = [(orbit.label, np.round(orbit.multipliers[0], 6), orbit.stable) for orbit in orbits]
    assert found == [
        ("P111", -0.111244 + 0.406986j, True),
        ("P111", -0.111244 + 0.406986j, True),
        ("P111", 2.333002, False),
        ("P112", 4.759687, False),
        ("P112", -0.400941, True),
        ("P121", 4.759687, False),
        ("P121", -0.400941, True),
    ]
    assert [orbit.mirror_of for orbit in orbits] == [1, 0, 2, 5, 6, 3, 4]
    for orbit in orbits:
        twin = orbits[orbit.mirror_of]
        assert np.allclose(sorted(orbit.impacts.speed), sorted(twin.impacts.speed), rtol=0, atol=1e-12)


@pytest.mark.parametrize("max_period", [1, 2])
def test_orbits_against_a_search_on_a_grid(scene, max_period):
    scene = scene.replace(amplitude=5.6)
    found = [(orbit.periods, orbit.multipliers[0]) for orbit in jv.find_orbits(scene, max_period)]
    other = [(len(one.points), one.multipliers[0]) for one in grid.orbits(scene, max_period, columns=60)]
    expected = [1, 1, 1, 2, 2] if max_period == 2 else [1, 1, 1]
    assert sorted(n for n, _ in found) == sorted(n for n, _ in other) == expected
    for n, root in found:
        assert min(abs(root - theirs) for m, theirs in other if m == n) < 1e-9


def test_an_itinerary_leads_to_its_orbit(scene):
    orbit = jv.find_orbit(scene, jv.State(0.9, -1.1), itinerary=("LLR",), settle=0)
    assert orbit.label == "P121" and orbit.itinerary == ("RLL",)
    with pytest.raises(jv.OrbitError, match=r"not admissible|no guess"):
        jv.find_orbit(scene, jv.State(0.9, -1.1), itinerary=("LLLLLL",), settle=0)


def test_the_least_period_is_found(scene):
    orbit = jv.find_orbit(scene.replace(amplitude=2.0), jv.State(0.9, -1.1), periods=4)
    assert (orbit.label, orbit.periods, orbit.impacts.count) == ("P111", 1, 2)


def test_the_section_moves_away_from_an_impact():
    # a stable P111 has an impact at phase 0 near this amplitude
    scene = jv.make_scene(0.893, 0.8, 0.05, 0.7, (-1.0, 1.0))
    orbit = jv.find_orbit(scene, jv.State(0.5, 0.5), settle=400)
    time = orbit.impacts.time / (2 * np.pi / 0.8)
    assert np.all(abs(time - np.round(time)) > 1e-3)
    end = jv.strobe(scene, orbit.state)[0]
    assert abs(end.x - orbit.state.x) < 1e-13 and abs(end.v - orbit.state.v) < 1e-13


def test_a_wall_passed_by_a_hair_is_refused():
    """One wall is near, and one far away; then the far one is as near as the orbit goes, a hair more or less."""
    rng, tried = np.random.default_rng(5), 0
    while tried < 2:
        numbers = zip(("amplitude", "frequency", "damping"), rng.uniform((0.5, 0.5, 0.05), (3, 3, 1.5)), strict=True)
        far = jv.make_scene(**dict(numbers), restitution=rng.uniform(0.3, 0.9), walls=(-50.0, rng.uniform(-0.3, 0.2)))
        try:
            orbit = jv.find_orbit(far, jv.State(-0.5, 0.0))
        except jv.OrbitError:
            continue
        if orbit.unknowns != "impacts":
            continue
        tried += 1
        rows = orbit.impacts.time, orbit.impacts.speed, orbit.impacts.side
        _, diagnostics, _ = solve_guess(far, padded_sequence(far, *rows, orbit.state.phase, orbit.periods))
        reach = -50.0 + diagnostics.closest_approaches[0][:, 0].min()
        kept = jv.find_orbit(far.replace(**{"left.position": reach - 1e-9}), orbit.state, orbit.periods, settle=0)
        assert abs(kept.least_clearance - min(orbit.least_clearance, 1e-9)) < 1e-13
        near = far.replace(**{"left.position": reach + 1e-9})
        with pytest.raises(jv.OrbitError, match=r"passes through the left wall, 1e-09 deep"):
            orbit_from_impacts(near, *rows, orbit.state.phase, orbit.periods)


def test_what_is_no_orbit_says_why(scene):
    with pytest.raises(jv.OrbitError, match=r"no orbit: the state does not return within 32 periods .*find_orbits"):
        jv.find_orbit(scene.replace(amplitude=5.24), jv.State(0.1, 0.3))
    with pytest.raises(jv.OrbitError, match=r"no orbit: singular .*the Jacobian is singular: a bifurcation"):
        jv.find_orbit(scene.replace(amplitude=3.543892249375), jv.State(0.9, -1.1))  # symmetry breaks there
    for change, refusal in (
        ({"periods": 2, "itinerary": ("LR",)}, r"^periods: must be the number of words, 1, or None"),
        ({"itinerary": "LR"}, r"^itinerary: must be a list of strings"),
        ({"scene": scene.replace(amplitude=np.ones(3))}, r"^scene: must be a single scene"),
    ):
        with pytest.raises(jv.ArgumentError, match=refusal):
            jv.find_orbit(**({"scene": scene, "state": jv.State(0.0, 0.0)} | change))


@pytest.mark.parametrize("moving", [False, True], ids=["still", "moving"])
def test_a_round_that_begins_on_a_wall_ends_with_the_impact_there(moving):
    """Rounding, or an error of the start, decides whether that impact is before the end: the orbit is the same."""
    right = jv.Wall(1.1, restitution=0.6, motion=jv.Motion(0.1, 0.4)) if moving else 1.1
    scene = jv.make_scene(2.3, 2.05, 0.05, 0.7, (-1.0, right))
    orbit = jv.find_orbit(scene, jv.State(0.9, -1.1))
    assert orbit.label == "P111"
    side, speed = int(orbit.impacts.side[int(moving)]), float(orbit.impacts.speed[int(moving)])
    phase = float(scene.frequency) * float(orbit.impacts.time[int(moving)])
    low, wall, high = (wall_ends(scene, phase + late)[int(side > 0)] for late in (-1e-5, 0.0, 1e-5))
    wall_velocity = float(scene.frequency) * (high - low) / 2e-5
    for error in (0.0, -1e-12, 1e-12, -1e-4, 1e-4):
        v = wall_velocity - side * scene.bounce("right" if side > 0 else "left") * speed * (1.0 + error)
        found = jv.find_orbit(scene, jv.State(float(wall), float(v), phase), periods=orbit.periods, settle=0)
        assert sorted(found.itinerary[0]) == sorted(orbit.itinerary[0])
        np.testing.assert_allclose(np.sort(found.impacts.speed), np.sort(orbit.impacts.speed), rtol=1e-11)


@pytest.mark.parametrize("beyond", (0.02, 0.7))
def test_an_orbit_in_a_thin_tongue_is_found_from_its_closed_form(beyond):
    omega, gamma = 0.21709371246996997, 0.35
    with mpmath.workdps(30):
        fold = closed.fold(gamma, omega, R, 1, symmetric=True)
        amplitude = float(fold.amplitude + beyond * (closed.grazing(gamma, omega, 1) - fold.amplitude))
        orbit = max(closed.orbits(gamma, omega, amplitude, R, 1, symmetric=True), key=lambda one: one.speed)
        state = closed.at_phase(gamma, omega, amplitude, orbit, 0, True)
    scene = jv.make_scene(amplitude, omega, gamma, R, (-1.0, 1.0))
    found = jv.find_orbit(scene, jv.State(*map(float, state)), periods=1, settle=0)
    assert found.label == "P111" and fold.speed < found.least_speed < 3.0 * fold.speed


def test_what_certified_flights_do_not_confirm_is_refused(scene):
    """An impact at another time, and one on another wall."""
    orbit = jv.find_orbit(scene, jv.State(0.9, -1.1))
    rows = orbit.impacts.time, orbit.impacts.speed, orbit.impacts.side
    guess = padded_sequence(scene, *rows, orbit.state.phase, 1)
    sequence, diagnostics, _ = jax.device_get(solve_guess(scene, guess))
    _require_certified(scene, sequence, diagnostics, 2, 0.0)
    length, sides = 1e-4 * PERIOD * np.array([0.0, 1.0]), sequence.sides * np.array([1.0, -1.0])
    late = diagnostics._replace(flights=diagnostics.flights._replace(time=diagnostics.flights.time + length))
    for wrong in ((sequence, late), (sequence._replace(sides=sides), diagnostics)):
        with pytest.raises(jv.OrbitError, match="does not meet the expected wall at the expected time"):
            _require_certified(scene, *wrong, 2, 0.0)


def test_an_impact_from_behind_its_wall_is_refused():
    """Beyond the grazing one root of (1 - a u)^2 + (b u / omega)^2 = A^2 / D is below zero."""
    with mpmath.workdps(30):
        a, b = closed.coefficients(GAMMA, OMEGA, R, 1, False)
        size, omega = 25 / closed.denominator(GAMMA, OMEGA), mpmath.mpf(OMEGA)
        square = a * a + b * b / omega**2
        u = (a - mpmath.sqrt(a * a - square * (1 - size))) / square
        time = closed.phase_of(GAMMA, omega, 5, 1 - a * u, -b * u) / omega
    scene = jv.make_scene(5.0, OMEGA, GAMMA, R, (None, 1.0))
    rows = np.array([float(time)]) % PERIOD, np.array([float(u)]), np.array([1.0])
    with pytest.raises(jv.OrbitError, match=f"impact 1 of 1 would have the speed {float(u):.3g}"):
        orbit_from_impacts(scene, *rows, 0.0, 1)


def test_a_multiplier_of_1_makes_shooting_singular():
    state, miss = jv.State(0.3, 0.2), np.array([0.1, 0.1])
    with pytest.raises(jv.OrbitError, match=r"no orbit: singular .*the Jacobian is singular"):
        _newton_step(state, state, miss, np.array([[1.0, 0.3], [0.0, 0.5]]))
    step, size = _newton_step(state, state, miss, np.array([[0.75, 0.0], [0.0, 0.5]]))
    assert (float(step.x), float(step.v), size) == pytest.approx((0.7, 0.4, 0.4), abs=1e-15)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_flight_that_turns_twice_between_two_samples_is_looked_at(sign):
    """Its speed towards a wall a parabola over the cell, of one sign at both ends, of the other between, or nowhere."""
    rng, count, span = np.random.default_rng(6), 500, 0.1
    place, bend = rng.uniform(0.2, 0.8, count) * span, 10.0 ** rng.uniform(-3.0, 3.0, count)
    least = 0.5 * bend * np.minimum(place, span - place) ** 2
    none = np.full(count, np.inf), np.zeros(count), np.zeros(count)
    for height, seen in ((0.9 * least, True), (1e-6 * least, True), (-0.5 * bend * span**2, False)):
        ends = [
            (np.ones(count), sign * (height - 0.5 * bend * (time - place) ** 2), -sign * bend * (time - place))
            for time in (0.0, span)
        ]
        crest, _, past = _nearer_turning_point(3.0, 8, span, *ends, none)
        assert (np.isfinite(crest) == seen).all() and ((past >= 0) & (past <= 1)).all()


@pytest.mark.parametrize("rounding", [-1e-16, 0.0, 1e-16])
def test_an_impact_of_speed_zero_at_an_end_of_a_flight_is_not_a_turning_point(rounding):
    none, (slow, fast) = (np.inf, 0.0, 0.0), (np.array([rounding]), np.array([0.05]))
    at_the_start = _nearer_turning_point(0, 8, 0.1, (0.0, slow, -0.5), (0.0025, -fast, -0.5), none)
    at_the_end = _nearer_turning_point(7, 8, 0.1, (0.0025, fast, -0.5), (0.0, slow, -0.5), none)
    inside = _nearer_turning_point(6, 8, 0.1, (0.0025, fast, -0.5), (0.0, -abs(slow), -0.5), none)
    assert np.isinf(at_the_start[0]) and np.isinf(at_the_end[0]) and np.isfinite(inside[0])


def test_solutions_without_impacts_are_the_linear_response():
    scene = jv.make_scene(np.linspace(1.0, 5.0, 8), 2.1, 0.05, 0.7, (-1.0, 1.0))
    found = jv.solve_orbits(scene, jv.State(0.0, 0.0), ("",))
    response = np.asarray(scene.amplitude) / (1.0 - 2.1**2 + 2j * 0.05 * 2.1)
    assert np.asarray(found.state.x) == pytest.approx(np.real(response), abs=1e-13)
    assert (np.asarray(found.status) == np.where(abs(response) < 1.0, OK, VIRTUAL)).all()
    slope = jax.grad(lambda a: jv.solve_orbits(scene.replace(amplitude=a), jv.State(0.0, 0.0), ("",)).state.x.sum())
    assert np.asarray(slope(scene.amplitude)) == pytest.approx(np.full(8, response.real[0]))


@pytest.mark.parametrize("periods", [1, 3])
def test_a_mass_that_would_rest_behind_a_wall_is_no_orbit(periods):
    walls = np.array([-1.0, -1e-3, 0.3, -2.0]), np.array([0.7, 1e-3, 0.9, -0.3])
    found = jv.solve_orbits(jv.make_scene(0.0, 2.1, 0.05, 0.7, walls), jv.State(0.0, 0.0), periods * ("",))
    assert np.asarray(found.status).tolist() == [OK, OK, VIRTUAL, VIRTUAL]


@pytest.mark.parametrize(
    "damping, frequency, walls",
    [(0.05, 2.1, (-0.7, 1.3)), (0.3, 0.7, (-0.4, None)), (1.5, 1.3, (None, jv.Wall(0.05, 0.9))), (0.0, 1.7, (-2, 3))],
)
def test_a_branch_from_rest_begins_with_the_distance_from_the_walls(damping, frequency, walls):
    """At rest the mass turns nowhere, or rounding decides where."""
    rest = jv.find_orbit(jv.make_scene(0.0, frequency, damping, 0.6, walls), jv.State(0.0, 0.0))
    branch = jv.follow(rest, "amplitude", (0.0, 0.03))
    nearest = min(abs(getattr(wall, "position", wall)) for wall in walls if wall is not None)
    assert branch.data.least_clearance.values[0] == pytest.approx(nearest, abs=1e-12)


def test_statuses_of_solutions():
    """Between unlike walls, one of which moves; the section is at a phase of its own."""
    right = jv.Wall(0.8, 0.6, motion=jv.Motion(0.1, 0.4, 2))
    scene = jv.make_scene(3.5, 1.9, 0.1, 0.75, (-1.2, right))
    orbit = jv.find_orbit(scene, jv.State(0.3, -1.1, 0.7))
    times, speeds = orbit.impacts.time, orbit.impacts.speed
    behind = jv.solve_orbits(scene.replace(**{"right.position": np.array([0.8, 3.0])}), orbit.state, orbit.itinerary)
    assert behind.status[0] == OK and behind.status[1] == NONE
    assert np.isnan(behind.state.x[1]) and np.isnan(behind.multipliers[1]).all()
    other = jv.solve_orbits(scene, jv.State(0.0, 0.0), ("",))
    assert other.status == VIRTUAL and np.isfinite(other.state.x)
    vmapped = jax.vmap(lambda a: jv.solve_orbits(scene.replace(amplitude=a), orbit.state, orbit.itinerary).status)
    assert list(vmapped(jnp.array([3.4, 3.5]))) == [OK, OK]
    assert jv.solve_orbits(scene, (times + orbit.state.phase / 1.9, speeds), orbit.itinerary).status == OK


def test_impacts_of_solutions_may_be_counted_from_any_of_them():
    scene, state = figure_4.scene(), figure_4.orbit().state
    one, other = (jv.solve_orbits(scene, state, (word,)) for word in ("LR", "RL"))
    assert one.status == other.status == OK and abs(one.state.x - other.state.x) < 1e-13
    assert np.sort(one.times % PERIOD) == pytest.approx(np.sort(other.times % PERIOD), abs=1e-12)
    assert abs(one.times[0] - other.times[1]) > 1e-3 or abs(one.times[1] - other.times[0]) > 1e-3
    assert jv.solve_orbits(scene, state, ("LL",)).status == NONE
