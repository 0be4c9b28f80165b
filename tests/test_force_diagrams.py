"""Forces of one's own: special points in closed form, diagrams, basins and manifolds against other routes."""

import numpy as np
import pytest

import jaxvibro as jv

from .force_attractors import Run
from .force_specials import ball_errors, bounced, duffing
from .plane_curves import bisected, distance
from .test_explore import is_on

TEETH, DRAG, BOUNCE = 0.5, 0.1, 0.6  # of the gear pair
FINE = 4000  # places of a period, at which its play is looked at


@pytest.mark.parametrize(("seed", "place"), [(0, None), pytest.param(1, None, marks=pytest.mark.slow), (2, 1e-6)])
def test_a_bouncing_ball_begins_and_doubles_where_closed_forms_say(seed, place):
    """place: as near to 0 it is no length of the scene, and the table's swing is."""
    orbit, known = bounced(np.random.default_rng(seed), side=(-1, 1)[seed % 2], place=place)
    assert orbit.label == ("P110", "P101")[seed % 2] and orbit.stable
    errors = ball_errors(orbit, known)
    assert errors["SN"] < 1e-10 and errors["PD"] < 1e-10


def gears(amplitude=0.095):
    """A gear pair with a drag."""
    force = jv.Force("polynomial", {"c0": DRAG, "damping": 0.0})
    return jv.make_scene(amplitude, 1.0, restitution=BOUNCE, walls=(-TEETH, TEETH), force=force)


def thrown(amplitude, state):
    """A state of the gear pair a period later: a parabola and a cosine between impacts, found by bisection."""
    (x, v), t, end = state, 0.0, 2.0 * np.pi
    grid = np.linspace(0.0, end, FINE + 1)[1:]
    while True:
        pace = v - amplitude * np.sin(t)

        def at(s, t=t, x=x, pace=pace):
            return x + pace * s - 0.5 * DRAG * s * s + amplitude * (np.cos(t) - np.cos(t + s))

        def leaves(s, t=t, pace=pace):
            return pace - DRAG * s + amplitude * np.sin(t + s)

        met = grid[(abs(at(grid)) > TEETH) & (grid < end - t)]
        if not len(met):
            return at(end - t), leaves(end - t)
        low, high = met[0] - grid[0], met[0]
        for _ in range(60):
            middle = 0.5 * (low + high)
            low, high = (low, middle) if abs(at(middle)) > TEETH else (middle, high)
        t, x, v = t + low, np.sign(at(low)) * TEETH, -BOUNCE * leaves(low)


def swung(amplitude, state):
    """A state of the Duffing oscillator a period later, by heyoka."""
    run = Run(False)
    run.integrator.pars[0] = amplitude
    return run.period(np.array(state))


SADDLES = {  # the scene, where its saddle is, the map by other means, two starts that part at its stable manifold
    "duffing": (duffing(amplitude=4.2), (0.7563, 2.4633), swung, ((0.0, 0.5), (0.0, 2.0))),
    "gears": (gears(), (-0.2023, 0.0973), thrown, ((0.0, -0.1), (0.0, 0.2))),
}


@pytest.mark.parametrize("name", SADDLES)
def test_manifolds_under_a_force_are_led_into_themselves_by_another_flight(name):
    scene, place, later, _ = SADDLES[name]
    saddle = jv.find_orbit(scene, jv.State(*place), 1, settle=0)
    assert not saddle.stable and abs(np.array([saddle.state.x, saddle.state.v]) - place).max() < 1e-3
    for kind in ("stable", "unstable"):
        data = jv.manifold(saddle, kind, 4.0, 0.0, 0.005, 0.01)
        early = data["arc"].values < (4.0 if kind == "stable" else 0.5)
        some = np.flatnonzero(early & (data["arc"].values > 0) & (abs(data["v"].values) < 4.0))
        given = np.stack([data["x"].values, data["v"].values], -1)[some[:: max(1, len(some) // 80)]]
        z = np.array([later(float(scene.amplitude), each) for each in given])
        stretch = abs(np.asarray(jv.monodromy(scene, jv.State(*given.T)))).max(axis=(1, 2))
        apart = distance(data, z)
        assert len(given) >= 60
        assert np.max(apart / (1.0 + stretch)) < 1e-9, (kind, np.sort(apart)[-8:])


@pytest.mark.parametrize("name", SADDLES)
def test_basins_under_a_force_meet_at_a_stable_manifold(name):
    scene, place, _, starts = SADDLES[name]
    data = jv.manifold(jv.find_orbit(scene, jv.State(*place), 1, settle=0), "stable", 4.0, 0.0, 0.01, 0.02)
    found = [one for one in jv.find_attractors(scene, 40) if one.share > 0]
    assert len(found) == 2
    assert distance(data, bisected(scene, found, *starts)[None])[0] < 1e-8


def test_diagrams_under_a_force_have_what_other_flights_settle_on():
    scene = duffing()
    diagram = jv.explore(scene, "amplitude", (0.0, 6.0), max_period=2)
    assert diagram.complete
    alone = jv.follow(jv.find_orbit(scene, jv.State(0.9, -1.1)), "amplitude", (0.0, 6.0))
    for point in alone.special[1:-1]:
        assert min(abs(one.value - point.value) for one in diagram.points(point.kind)) < 1e-10
    rng, run, seen = np.random.default_rng(0), Run(False), 0
    for amplitude in rng.uniform(0.2, 5.9, 16):
        run.integrator.pars[0] = amplitude
        state = np.array([rng.uniform(-0.9, 0.9), rng.normal()])
        for _ in range(600):
            state = run.period(state)
        later = [state := run.period(state) for _ in range(2)]
        here = scene.replace(amplitude=amplitude)
        if abs(run.period(run.period(state)) - state).max() > 1e-9:
            continue
        periods = 1 if abs(later[1] - later[0]).max() < 1e-9 else 2
        orbit = jv.find_orbit(here, jv.State(*state), periods, settle=0)
        found = np.array([orbit.state.x, orbit.state.v])  # a point of the orbit, of two perhaps the other
        assert min(abs(found - one).max() for one in later) < 1e-8
        assert is_on(orbit, diagram), (amplitude, orbit.label)
        seen += 1
    assert seen >= 10


def test_the_diagram_of_a_gear_pair_has_its_closed_forms_and_a_rest_beside_it():
    """Teeth that lie on each other stay so up to c0, beside the rattling that begins below it."""
    diagram = jv.explore(gears(), "amplitude", (0.02, 0.24), max_period=1)
    begins = np.pi * DRAG * (1 - BOUNCE) / (1 + BOUNCE)
    doubles = np.hypot(begins, 2 * DRAG * (1 + BOUNCE**2) / (1 + BOUNCE) ** 2)
    for kind, true in (("SN", begins), ("PD", doubles)):
        assert min(abs(one.value - true) for one in diagram.points(kind) if one.label == "P110") < 1e-10
    found = jv.find_attractors(gears(), 40)
    (rest,) = [one for one in found if one.rests]
    assert {one.label for one in found} == {"P110", "P100"} and rest.orbit.state.x == -TEETH
    hops = jv.find_attractors(gears(0.12), 40)
    assert "P1-inf-0" in {one.label for one in hops if one.rests}
