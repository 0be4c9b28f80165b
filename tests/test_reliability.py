"""Hard cases: their truth against ball arithmetic, what is judged, the methods in small, and the page."""

import functools
import math
import re

import numpy as np
import pytest
from flint import ctx

from benchmarks import page
from benchmarks.rows import Size
from reliability import cases, counts, curves, exact_flow, failure_maps, flights, methods, near_grazing, periods, run
from reliability.counts import Count
from reliability.exact_flow import Lanes, Wall
from reliability.flights import Flights, Ranges, Shape

from .reference import ball, soft
from .reference.scene import Scene
from .reference.scene import Wall as Rigid
from .sources import ROOT

DOCS = ROOT / "docs"


def digits(arb):
    """A ball's middle as an 80-bit float."""
    return np.longdouble(arb.mid().str(25, radius=False))


def test_the_exact_flow_against_ball_arithmetic_next_to_resonance_and_critical_damping():
    rng, n = np.random.default_rng(0), 90
    gamma = np.concatenate([[0.0] * 15, cases.nearly_none(rng, 25), cases.past_one(rng, 30), rng.uniform(0.0, 1.5, 20)])
    omega = np.where(rng.random(n) < 0.6, cases.near_one(rng, n), rng.uniform(0.01, 50.0, n))
    amplitude, phase, (x, v) = 10.0 ** rng.uniform(-3, 6, n), rng.uniform(0, 6.28, n), rng.normal(size=(2, n))
    time = rng.uniform(0.0, 3.0, n)
    found = exact_flow.fly(Lanes(gamma, omega, amplitude, phase, x, v), time)
    with ctx.workprec(200):
        for k in range(n):
            true = ball.flow(*map(float, (gamma[k], omega[k], amplitude[k], phase[k], x[k], v[k], time[k])))
            size = abs(x[k]) + abs(v[k]) + amplitude[k]
            assert max(abs(found[j][k] - digits(true[j])) for j in (0, 1)) < 2e-18 * size


def clearance_in_balls(part, wall, lane, t):
    """The clearance of a wall at a time, in ball arithmetic."""
    numbers = (float(each[lane]) for each in (part.lanes.gamma, part.lanes.omega, part.lanes.amplitude))
    gamma, omega, amplitude = numbers
    phase, x, v = (float(each[lane]) for each in part.lanes[3:])
    place = ball.flow(gamma, omega, amplitude, phase, x, v, t)[0]
    angle = wall.harmonic * (ball.arb(phase) + ball.arb(omega) * ball.arb(t)) + ball.arb(float(wall.phase[lane]))
    swing = ball.arb(float(wall.swing[lane])) * angle.cos() if wall.harmonic else 0
    return wall.side * (ball.arb(float(wall.position[lane])) + swing - place)


@pytest.mark.parametrize("name", ["grazes, moving walls", "resonance", "past critical damping", "small scenes"])
def test_contacts_and_misses_against_ball_arithmetic(name):
    """Before a contact there is room, behind it there is none; a miss has room at its nearest and around it."""
    part, _ = run.CASES[name].batch(40, 1)
    assert 10 < (part.side != 0).sum() < 30
    with ctx.workprec(160):
        for lane in range(40):
            wall = part.walls[0]
            if part.side[lane]:
                early = [clearance_in_balls(part, wall, lane, s * part.time[lane]) for s in (0.0, 0.3, 0.6, 0.9, 0.99)]
                assert all(each > 0 for each in early)
                one, time = slice(lane, lane + 1), part.time[lane : lane + 1]
                _, slope, bend = exact_flow.clearance(part.lanes.some(one), wall.some(one), time)
                deepest = clearance_in_balls(part, wall, lane, float(time[0] - slope[0] / bend[0]))
                assert deepest < 0 and abs(float(deepest) + part.measure[lane]) < 0.02 * part.measure[lane]
            else:
                grid = np.linspace(0.0, part.until[lane], 60)
                room = min(float(clearance_in_balls(part, wall, lane, s)) for s in grid)
                assert room > 0 and room >= -part.measure[lane] * (1 - 1e-9)


@pytest.mark.parametrize("name", [cases.CASES[0].name, "slow impacts", "the other wall near", "starts into a wall"])
def test_our_method_decides_every_flight_of_a_case(name):
    part, _ = run.CASES[name].batch(4096, 0)
    assert counts.judged(part, methods.ours(part)) == Count(4096, 0, 0, 0)


def test_missed_invented_and_wrong_contacts_are_counted():
    zeros = np.zeros(6)
    times, sides = np.array([0.5] * 4 + [np.inf] * 2), np.array([1, 1, 1, 1, 0, 0])
    given = Flights(Lanes(*[zeros] * 6), (), np.ones(6), times, sides, zeros, zeros > -1)
    met = methods.Met(np.array([1, 0, -1, 1, 1, 0]), np.array([0.5, np.inf, 0.5, 0.2, 0.4, np.inf]))
    assert counts.judged(given, met) == Count(6, missed=1, invented=1, wrong=2)
    assert Count(1000, 0, 0, 0).bounds[1] == pytest.approx(1.0 - 0.025 ** (1 / 1000), rel=1e-9)
    assert counts.per_million(Count(1000, 0, 0, 0)) == "0 (to 3,682)"
    assert counts.per_million(Count(4, 1, 1, 0)).startswith("**500,000**")


def test_counts_by_speed_add_up_to_those_of_the_case(monkeypatch):
    case, rival = run.CASES["starts into a wall"], methods.RIVALS[-1]
    monkeypatch.setattr(methods, "RIVALS", (rival,))
    found = counts.by_speed(case._replace(shapes=case.shapes[:1]), Size(True))
    assert list(found) == list(range(-1, -11, -1))
    own = [each[methods.OURS] for each in found.values()]
    assert sum(each.flights for each in own) == counts.BATCH // 16 and sum(each.bad for each in own) == 0
    assert sum(each[rival.name].flights for each in found.values()) == rival.lanes // 16
    assert counts.speeds_table({"a": found}).count("\n") == 11


RIVALS = {rival.name: rival for rival in methods.RIVALS}
FINE = ["heyoka, tol 1e-15", "SciPy DOP853, tol 1e-12", "paper's RK4, 800 steps a period", "diffrax Tsit5, tol 1e-10"]


@pytest.mark.parametrize("name", FINE)
def test_the_other_methods_are_right_in_easy_cases(name):
    """A method that misses contacts deeper than 1e-3 at the end of long flights is written badly."""
    part, _ = cases.WHOLE.batch(600, 0)
    easy = part.some((part.side != 0) & (part.measure > 1e-3)).some(slice(40))
    met = RIVALS[name].met(easy)
    rate = np.mean(met.side == easy.side)
    assert rate == 1.0 if "RK4" not in name else rate > 0.9
    good = met.side != 0
    assert np.median(abs(met.time[good] - easy.time[good])) < 1e-6


def test_periods_in_80_bit_floats_and_by_other_methods_against_ball_arithmetic():
    rng, n = np.random.default_rng(1), 12
    ranges = ((0.5, 5), (0.6, 4), (0, 0.3), (0.4, 0.9), (-1.0, -1.0), (1.3, 1.3), (-0.9, 0.9))
    given = periods.Scenes(*(rng.uniform(low, high, n) for low, high in ranges), rng.normal(size=n))
    ways = {
        "80 bit": (periods.true, 1e-15),
        "ours": (failure_maps.by_ours, 1e-13),
        "heyoka": (functools.partial(periods.by_heyoka, tolerance=1e-15), 1e-12),
        "SciPy": (functools.partial(periods.by_flights, RIVALS["SciPy DOP853, tol 1e-12"].met), 1e-9),
        "paper": (functools.partial(periods.by_flights, RIVALS["paper's RK4, 800 steps a period"].met), 1e-4),
    }
    ends = {name: (way(given), bound) for name, (way, bound) in ways.items()}
    for lane in range(n):
        amplitude, omega, gamma, r, low, high, x, v = (float(each[lane]) for each in given)
        true = soft.strobe(Scene(gamma, omega, amplitude, Rigid(low, r), Rigid(high, r)), x, v, 0.0)
        for name, (end, bound) in ends.items():
            assert [int(side) for side in end.sides[lane] if side] == [int(side) for side in true.sides], name
            errors = [abs(float(t - ball.arb(float(c[lane])))) for t, c in ((true.x, end.x), (true.v, end.v))]
            assert max(errors) < max(bound * 30, 1e-15), (name, errors)


def test_the_true_derivative_next_to_a_grazing_is_that_of_differences_in_80_bit_floats():
    _, top = near_grazing.grazing()
    wall = float(top[0] - 1e-3)
    numbers = near_grazing.A, near_grazing.OMEGA, near_grazing.GAMMA, near_grazing.RESTITUTION, -50.0, wall
    given = periods.Scenes(*(np.array([number]) for number in (*numbers, *near_grazing.START)))
    columns, step = [], np.longdouble(1e-8)
    for name in ("x", "v"):
        upper, lower = (periods.true(given._replace(**{name: getattr(given, name) + s * step})) for s in (1, -1))
        columns.append(np.concatenate([upper.x - lower.x, upper.v - lower.v]) / (2 * step))
    expected = near_grazing.true_derivative(wall).astype(float)
    np.testing.assert_allclose(np.stack(columns, -1).astype(float), expected, rtol=1e-7)


def test_a_map_judges_scenes_that_are_not_chaotic_and_finds_ours_right(monkeypatch):
    def all_wrong(scenes):
        return failure_maps.by_ours(scenes)._replace(sides=np.ones((len(scenes.x), periods.ROOM)))

    ways = {methods.OURS: failure_maps.by_ours, "all wrong": all_wrong}
    monkeypatch.setattr(failure_maps, "whole_methods", lambda: ways)
    measured = failure_maps.measure(("amplitude", "omega"), ((0.5, 4.0), (0.7, 3.5)), Size(True))
    assert measured.judged.sum() >= 12 and set(np.unique(measured.first[methods.OURS])) == {10}
    assert np.all(measured.first["all wrong"][measured.judged] == 0)


def test_curves_are_by_decade_and_drawn(tmp_path):
    x = np.repeat([0.5, 5.0, 50.0], [10, 10, 2])
    middles, medians = curves.by_decade(x, x * 2, -1, 2)
    np.testing.assert_allclose(middles, 10.0 ** np.array([-0.5, 0.5, 1.5]))
    assert medians[0] == 1.0 and medians[1] == 10.0 and np.isnan(medians[2])
    names = methods.OURS, "heyoka, tol 1e-9", "heyoka, tol 1e-15"
    lines = dict.fromkeys(names, (middles, medians))
    curves.save(tmp_path / "a.png", curves.Curves("what", "x", "y", lines, endless="none"))
    assert (tmp_path / "a.png").stat().st_size > 10_000
    assert [curves.styled(name, lines)["linestyle"] for name in names[1:]] == ["--", "-"]


def test_the_page_has_its_parts_and_pictures():
    text = (DOCS / run.PAGE).read_text()
    assert {text.count(mark) for part in run.PARTS for mark in page.marks(part, run.COMMAND)} == {1}
    drawn = re.findall(r"^!\[[^\]]+\]\((.+)\)$", text, re.M)
    assert set(drawn) == {*run.CURVES, *run.MAPS} and all((DOCS / file).is_file() for file in drawn)
    rows = re.findall(r"^\| ([^|]+) \| [^|]+ \| [\d,]+ \| [\d,]+ \| (\d+), (\d+), (\d+) \|$", text, re.M)
    assert {row[0] for row in rows} == set(run.CASES)
    assert all(row[1:] == ("0", "0", "0") for row in rows if row[0] != cases.DOUBT.name)


def test_a_case_draws_flights_of_its_kind():
    rng = np.random.default_rng(0)
    assert np.all(cases.near_one(rng, 1000) != 0) and (cases.near_one(rng, 1000) == 1.0).any()
    part, doubtful = run.CASES["in doubt"].batch(500, 0)
    unit = flights.ulp(part.lanes, part.walls)
    assert np.all(abs(part.measure) >= 0.999 * unit) and np.all(abs(part.measure) < 10.0 * unit) and doubtful >= 0
    part = flights.hops(rng, 100, Shape(-1), Ranges())
    assert np.all(part.side == -1) and np.all(part.lanes.v > 0) and np.all(part.lanes.x == part.walls[0].position)
    wall = Wall(1, 2, np.ones(3), np.full(3, 0.1), np.zeros(3))
    assert wall.some(slice(2)).swing.shape == (2,) and math.isinf(methods.none_met(part).time[0])
