"""The references and their derivatives, checked against second routes: an ODE solver, Taylor steps, differences."""

import itertools
import math

import numpy as np
import pytest
from flint import arb, ctx
from mpmath import mp, mpf, nstr, odefun

from tests.reference import ball, closed, contacts, draws, flights, orbit, own_force, plain, search, slopes
from tests.reference.scene import Motion, Scene, Wall


def to_mp(number):
    """The midpoint of a ball as an mpf."""
    mantissa, exponent = number.mid().man_exp()
    return mp.ldexp(mpf(int(mantissa)), int(exponent))


def fair_draws(seeds, draw=draws.draw, strobe=orbit.strobe):
    """Seed, draw and record of those seeds that are fair tests."""
    for seed in seeds:
        drawn = draw(seed)
        try:
            yield seed, drawn, strobe(*drawn)
        except search.Discard:
            continue


def off_plain_steps(drawn, record):
    """The largest difference of a record from plain Taylor steps, over its scale (1 + norm); inf on another way."""
    with mp.workdps(34):
        x, v, impacts = plain.strobe(*drawn)
        if [side for _, side, _ in impacts] != record.sides:
            return math.inf
        expected = [x, v] + [value for time, _, speed in impacts for value in (time, speed)]
        got = [record.x, record.v] + [b for pair in zip(record.times, record.speeds, strict=True) for b in pair]
        largest = max(abs(a - to_mp(b)) for a, b in zip(expected, got, strict=True))
        return float(largest) / (record.scale * (1 + record.norm))


@pytest.mark.parametrize("gamma, omega", [(0, 1), (0, 1 + 1e-9), (1, 1), (0.05, 2.1), (1 - 1e-12, 0.3), (1.5, 3.7)])
def test_flow_against_an_ode_solver(gamma, omega):
    with mp.workdps(30):
        g, w = mpf(gamma), mpf(omega)
        solve = odefun(
            lambda t, y: [y[1], mpf(3) * mp.cos(0.7 + w * t) - 2 * g * y[1] - y[0]], 0, [mpf(0.3), mpf(-1.1)]
        )
        expected = solve(mpf(0.9))
        got = [to_mp(value) for value in ball.flow(gamma, omega, 3.0, 0.7, 0.3, -1.1, 0.9)]
        assert max(abs(a - b) for a, b in zip(expected, got, strict=True)) < 1e-26


def test_series_of_whole_numbers_are_the_exact_flow_where_the_force_is_a_spring():
    """Duffing's without its cubic term, one wall or two, some of which move."""
    checked = 0
    for _, (scene, x, v, phase), record in fair_draws(range(12)):
        walls, numbers = [None, None], {"cubic": 0, "damping": scene.gamma}
        bounces = [0, 0]
        for side, wall in scene.walls():
            place = side > 0
            bounces[place] = wall.restitution
            walls[place] = wall.position if wall.motion is None else (wall.position, *wall.motion)
        with mp.workdps(34):
            given = scene.amplitude, scene.omega, walls, tuple(bounces), x, v
            found = own_force.flown(own_force.duffing, numbers, *given, phase=phase)
            assert [side for _, side, _ in found.hits] == record.sides
            true = [record.x, record.v] + [b for pair in zip(record.times, record.speeds, strict=True) for b in pair]
            mine = [*found.end, *(each for time, _, speed in found.hits for each in (time, speed))]
            apart = max(abs(a - to_mp(b)) for a, b in zip(mine, true, strict=True))
            assert apart < 1e-25 * record.scale * (1 + record.norm)
            checked += bool(record.sides)
    assert checked > 5


def test_the_two_exact_flows_agree():
    with ctx.workprec(300):
        for gamma, omega, t in itertools.product((0.0, 0.3, 1.0, 1.4), (0.3, 1.01, 4.0), (0.2, 9.0)):
            oscillator = ball.Oscillator(gamma, omega, 2.5)
            start = arb(0.4), arb(-0.9), arb(1.3), arb(t)
            pairs = zip(oscillator.flow(*start), oscillator.flow_matrix(*start), strict=True)
            assert all(a.overlaps(b) and a.rad() < 1e-60 and abs(a - b) < 1e-60 for a, b in pairs)


def test_strobe_against_plain_taylor_steps():
    seen = 0
    for seed, drawn, record in fair_draws(range(12)):
        assert off_plain_steps(drawn, record) < 1e-28, seed
        seen += record.count
    assert seen > 10


def test_jacobian_against_differences():
    step, checked = 1e-30, 0
    for seed, drawn, record in fair_draws(range(100, 130)):
        scene, x, v, phase = drawn
        with ctx.workprec(400):
            moved = [
                orbit.strobe(scene, arb(x) + step, v, phase, precision=400),
                orbit.strobe(scene, x, arb(v) + step, phase, precision=400),
            ]
            for column, other in enumerate(moved):
                for row, name in enumerate("xv"):
                    slope = float((getattr(other, name) - getattr(record, name)) / step)
                    assert slope == pytest.approx(record.jacobian[row][column], abs=1e-9 * (1 + record.norm)), seed
        checked += record.count > 0
    assert checked > 8


def test_turning_points_and_contacts_against_a_dense_look():
    for seed, (scene, x, v, phase), record in fair_draws(range(200, 230)):
        period = 2 * math.pi / scene.omega
        first = float(record.times[0]) if record.times else period
        t = np.linspace(0, first, 400)[1:-1]
        path = [ball.flow(*scene[:3], phase, x, v, float(time)) for time in t[::1]]
        for side, wall in scene.walls():
            place = np.array([draws.position(wall, phase + scene.omega * time) for time in t])
            gap = side * (place - np.array([float(state[0]) for state in path]))
            assert gap.min() > 0, seed
            slope = np.diff(gap)
            turns = [turn for turn in record.turns if turn.side == side and turn.time < first]
            assert np.sum(slope[1:] * slope[:-1] < 0) <= len(turns), seed
            for turn in turns:
                k = np.searchsorted(t, float(turn.time))
                near = gap[max(0, k - 3) : k + 3]
                extreme = near.min() if turn.minimum else near.max()
                assert float(turn.clearance) == pytest.approx(extreme, abs=2e-3 * record.scale), seed


def test_start_on_a_wall():
    scene = Scene(0.05, 2.1, 2.0, None, Wall(1.0, 0.7))
    into = orbit.strobe(scene, 1.0, 0.5)
    assert into.times[0] == 0 and into.sides[0] == 1 and float(into.speeds[0]) == 0.5
    landed = orbit.strobe(scene, 1.0, arb(-0.5) * arb(0.7), contact=1.0)
    assert landed.count == into.count - 1 and landed.x.overlaps(into.x)
    with pytest.raises(ValueError, match="beyond"):
        orbit.strobe(scene, 1.5, 0.0)


def test_unfair_draws_are_refused():
    amplitude = float(closed.grazing(0.05, 2.1, 1.0))
    start = [float(value) for value in closed.forced(0.05, 2.1, amplitude, 0)]
    with pytest.raises(search.Discard):
        orbit.strobe(Scene(0.05, 2.1, amplitude, Wall(-1.0, 0.7), Wall(1.0, 0.7)), *start)


def test_draws_are_what_they_say():
    for seed in range(2000):
        scene, x, _, phase = draws.draw(seed)
        assert all(side * (draws.position(wall, phase) - x) > 0 for side, wall in scene.walls())
        if scene.left and scene.right:
            reach = sum((wall.motion or Motion(0.0)).amplitude for _, wall in scene.walls())
            assert scene.right.position - scene.left.position > reach


@pytest.mark.parametrize("left, right, periods", [(None, 0, 1), (0, 0, 2), (2, None, 1), (1, 3, 3)])
def test_flights_against_ball_arithmetic(left, right, periods):
    assert np.finfo(np.longdouble).eps < 2e-19
    drawn = flights.make_flights(1, 60, left=left, right=right, periods=periods, sample=2000)
    lanes = drawn.lanes
    assert np.all(np.abs(drawn.depth) >= 8 * drawn.ulp) and 0.2 < np.mean(drawn.depth > 0) < 0.8
    with ctx.workprec(200):
        for k in range(60):
            scene = flights.scene_of(drawn, k, 0.5)
            oscillator = ball.Oscillator(*scene[:3])
            start = [arb(float(value[k])) for value in (lanes.x, lanes.v, lanes.phase)]
            length = 2 * arb.pi() * periods / arb(scene.omega)
            hit, _ = search.first_contact(search.Course(scene, oscillator, *start), length)
            assert (hit is not None) == drawn.contact[k] and (hit[1] if hit else 0) == drawn.side[k]
            if hit:
                error = abs(float(hit[0] - arb(str(drawn.time[k]))))
                assert error * drawn.speed[k] < 0.05 * drawn.ulp[k]


def test_zero_keeps_its_bracket_and_stops_on_an_exact_zero():
    root = contacts.zero(
        lambda index, t: (1 - t, -np.ones_like(t)), np.zeros(3), np.full(3, 4.0), np.array([0.5, 1, 3])
    )
    assert np.all(root == 1)


def test_closed_forms_known_numbers():
    with mp.workdps(40):
        gamma, omega, r = mpf("0.05"), mpf("2.1"), mpf("0.7")
        assert nstr(closed.fold(gamma, omega, r, 1, symmetric=True).amplitude, 12) == "0.508057896812"
        assert nstr(closed.grazing(gamma, omega, 1), 13) == "3.416460156361"
        fold = closed.fold(gamma, omega, r, 1, symmetric=True)
        roots = closed.orbits(gamma, omega, fold.amplitude * (1 + mpf(10) ** -20), r, 1, symmetric=True)
        assert len(roots) == 2 and abs(roots[0].speed - fold.speed) < 1e-8


CASES = [
    ("P111", {"wall": 1.0, "symmetric": True}, Scene(0.05, 2.1, 2.0, Wall(-1.0, 0.7), Wall(1.0, 0.7)), 2),
    ("P101", {"wall": 0.4}, Scene(0.1, 2.4, 2.0, None, Wall(0.4, 0.8)), 1),
    ("P110", {"wall": -0.4, "side": -1}, Scene(0.1, 2.4, 2.0, Wall(-0.4, 0.8)), 1),
]


@pytest.mark.parametrize("name, how, scene, impacts", CASES)
def test_closed_orbits_are_fixed_points_of_the_strobe(name, how, scene, impacts):
    gamma, omega, amplitude = scene[:3]
    r = (scene.right or scene.left).restitution
    with mp.workdps(50), ctx.workprec(300):
        found = closed.orbits(gamma, omega, amplitude, r, **how)
        assert len(found) == (2 if name == "P111" else 1)
        for root in found:
            x, v = closed.at_phase(gamma, omega, amplitude, root, symmetric=how.get("symmetric", False))
            start = [arb(nstr(value, 48)) for value in (x, v)]
            record = orbit.strobe(scene, *start, precision=300)
            assert record.count == impacts
            assert abs(record.x - start[0]) < 1e-40 and abs(record.v - start[1]) < 1e-40
            assert abs(record.speeds[0] - arb(nstr(root.speed, 48))) < 1e-40
        x, v = closed.forced(gamma, omega, amplitude, 0)
        start = [arb(nstr(value, 48)) for value in (x, v)]
        free = orbit.strobe(scene._replace(left=None, right=None), *start, precision=300)
        assert free.count == 0 and abs(free.x - start[0]) < 1e-40 and abs(free.v - start[1]) < 1e-40


@pytest.fixture(scope="module")
def fair():
    """(draw, record) of some seeds that are fair tests."""
    return [(drawn, record) for _, drawn, record in fair_draws(range(40))]


def test_the_replay_is_the_record(fair):
    for drawn, record in fair:
        with ctx.workprec(slopes.PRECISION):
            again = slopes.replay(slopes.with_numbers(drawn, [arb(each) for each in slopes.numbers(drawn)]), record)
            known = [record.x, record.v, *record.times, *record.speeds]
            assert max(abs(a - b) for a, b in zip(again, known, strict=True)) < 1e-29 * record.scale


def test_by_the_state_it_is_the_product_of_saltation_matrices(fair):
    for drawn, record in fair:
        assert np.abs(slopes.jacobian(drawn, record)[:2, :2] - record.jacobian).max() < 1e-14 * record.norm


def test_half_the_step_changes_nothing(fair):
    for drawn, record in fair[:8]:
        direction = np.ones(len(slopes.names(drawn[0])))
        for order in (1, 2, 3):
            whole, half = (slopes.derivative(drawn, record, direction, order, step=slopes.STEP / k)[:2] for k in (1, 2))
            assert all(abs(a - b) < 1e-40 * (1 + abs(a)) for a, b in zip(whole, half, strict=True))
