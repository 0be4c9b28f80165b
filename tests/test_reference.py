"""The reference implementations against each other: closed forms, matrix exponentials, Taylor series by hand."""

import numpy as np
import pytest
from flint import arb, ctx
from mpmath import mp, mpf, nstr

import jaxvibro as jv
from tests import truths, wild
from tests.kinds import KINDS, LANES
from tests.properties.motions import lane_of, take
from tests.reference import ball, closed, contacts, flights, own_force, search, soft
from tests.reference.scene import Scene, Wall


def to_mp(number):
    """Return the midpoint of a ball as an mpf."""
    mantissa, exponent = number.mid().man_exp()
    return mp.ldexp(mpf(int(mantissa)), int(exponent))


@pytest.mark.parametrize("gamma, omega", [(0, 1), (0, 1 + 1e-9), (0.3, 0.3), (1, 1), (1 - 1e-12, 0.3), (1.5, 3.7)])
def test_the_exact_flow_is_that_of_a_matrix_exponential_and_of_taylor_series(gamma, omega):
    with mp.workdps(34):
        numbers, walls = {"cubic": 0, "damping": gamma}, (None, None)
        series = own_force.flown(own_force.duffing, numbers, 3.0, omega, walls, 0, 0.3, -1.1, phase=0.7)
        with ctx.workprec(300):
            start = arb(0.3), arb(-1.1), arb(0.7), 2 * arb.pi() / arb(omega)
            oscillator = ball.Oscillator(gamma, omega, 3.0)
            for exact, other, by_hand in zip(
                oscillator.flow(*start), oscillator.flow_matrix(*start), series.end, strict=True
            ):
                assert exact.overlaps(other) and other.rad() < 1e-40 and abs(exact - other) < 1e-40
                assert abs(to_mp(exact) - by_hand) < 1e-24


def test_strobes_are_those_of_taylor_series():
    """The end, the impacts and the monodromy matrix of a spring, against those of a force that is one."""
    impacts = 0
    for number in range(2):
        scene, state = KINDS["moving_walls"].draw(number)
        force = jv.Force("duffing", {"cubic": np.zeros(LANES), "damping": scene.damping}, 1e-12)
        walls = scene.left, scene.right
        spring = jv.make_scene(scene.amplitude, scene.frequency, walls=walls, force=force)
        for lane in range(LANES):
            try:
                exact = truths.closed_form(*lane_of(scene, state, lane))
                series = truths.series(*lane_of(spring, state, lane))
            except search.Discard:
                continue
            assert exact.sides == series.sides
            with mp.workdps(34):
                one, other = ([each.x, each.v, *each.times, *each.speeds] for each in (exact, series))
                assert max(abs(to_mp(a) - b) for a, b in zip(one, other, strict=True)) < 1e-25 * exact.allowed
            assert np.allclose(exact.matrix, series.matrix, rtol=1e-8, atol=1e-8 * abs(exact.matrix).max())
            impacts += len(exact.sides)
    assert impacts > 5


def test_a_start_on_a_wall_or_beyond_it():
    scene = Scene(0.05, 2.1, 2.0, None, Wall(1.0, 0.7))
    into = soft.strobe(scene, 1.0, 0.5)
    assert into.times[0] == 0 and into.sides[0] == 1 and float(into.speeds[0]) == 0.5
    with pytest.raises(ValueError, match="beyond"):
        soft.strobe(scene, 1.5, 0.0)


@pytest.mark.parametrize("left, right, periods", [(None, 0, 1), (0, 0, 2), (2, None, 1), (1, 3, 3)])
def test_flights_against_ball_arithmetic(left, right, periods):
    assert np.finfo(np.longdouble).eps < 2e-19
    drawn = flights.make_flights(1, 60, left=left, right=right, periods=periods, sample=2000)
    scene, state = wild.scene_of_flights(drawn.lanes)
    assert np.all(np.abs(drawn.depth) >= 8 * drawn.ulp) and 0.2 < np.mean(drawn.depth > 0) < 0.8
    with ctx.workprec(200):
        for k in range(60):
            plain = truths.plain(take(scene, k))
            start = [arb(float(value[k])) for value in (state.x, state.v, state.phase)]
            length = 2 * arb.pi() * periods / arb(plain.omega)
            course = search.Course(plain, ball.Oscillator(*plain[:3]), *start)
            hit, _ = search.first_contact(course, length)
            assert (hit is not None) == drawn.contact[k] and (hit[1] if hit else 0) == drawn.side[k]
            if hit:
                error = abs(float(hit[0] - arb(str(drawn.time[k]))))
                assert error * drawn.speed[k] < 0.05 * drawn.ulp[k]


def test_a_zero_keeps_its_bracket_and_stops_where_it_is_exact():
    low, high, guess = np.zeros(3), np.full(3, 4.0), np.array([0.5, 1, 3])
    assert np.all(contacts.zero(lambda index, t: (1 - t, -np.ones_like(t)), low, high, guess) == 1)


def test_a_fold_and_a_grazing_in_closed_form():
    with mp.workdps(40):
        gamma, omega, r = mpf("0.05"), mpf("2.1"), mpf("0.7")
        fold = closed.fold(gamma, omega, r, 1, symmetric=True)
        assert nstr(fold.amplitude, 12) == "0.508057896812"
        assert nstr(closed.grazing(gamma, omega, 1), 13) == "3.416460156361"
        roots = closed.orbits(gamma, omega, fold.amplitude * (1 + mpf(10) ** -20), r, 1, symmetric=True)
        assert len(roots) == 2 and abs(roots[0].speed - fold.speed) < 1e-8
        start = [float(value) for value in closed.forced(gamma, omega, closed.grazing(gamma, omega, 1), 0)]
    with pytest.raises(search.Discard):  # rounding decides whether it touches
        soft.strobe(Scene(0.05, 2.1, float(closed.grazing(0.05, 2.1, 1.0)), Wall(-1.0, 0.7), Wall(1.0, 0.7)), *start)


CASES = [
    ("P111", {"wall": 1.0, "symmetric": True}, Scene(0.05, 2.1, 2.0, Wall(-1.0, 0.7), Wall(1.0, 0.7))),
    ("P101", {"wall": 0.4}, Scene(0.1, 2.4, 2.0, None, Wall(0.4, 0.8))),
    ("P110", {"wall": -0.4, "side": -1}, Scene(0.1, 2.4, 2.0, Wall(-0.4, 0.8))),
]


@pytest.mark.parametrize("name, form, scene", CASES)
def test_closed_orbits_are_fixed_points_of_the_strobe(name, form, scene):
    numbers = scene[:3]
    restitution = (scene.right or scene.left).restitution
    with mp.workdps(50), ctx.workprec(300):
        roots = closed.orbits(*numbers, restitution, **form)
        assert len(roots) == (2 if name == "P111" else 1)
        states = [closed.at_phase(*numbers, root, symmetric=name == "P111") for root in roots]
        free = scene._replace(left=None, right=None)
        for given, state in (*((scene, state) for state in states), (free, closed.forced(*numbers, 0))):
            start = [arb(nstr(value, 48)) for value in state]
            record = soft.strobe(given, *start, precision=300)
            assert abs(record.x - start[0]) < 1e-40 and abs(record.v - start[1]) < 1e-40
            assert record.count == (0 if given is free else int(name[2]) + int(name[3]))
            if given is not free:
                root = roots[states.index(state)]
                assert abs(record.speeds[0] - arb(nstr(root.speed, 48))) < 1e-40
