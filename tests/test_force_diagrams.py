"""User-defined forces in studies: special points in closed form, diagrams, basins and manifolds."""

import mpmath
import numpy as np
import pytest

import jaxvibro as jv

from .force_specials import bounced, duffing
from .plane_curves import bisected, distance
from .reference import own_force

TEETH, DRAG, BOUNCE = 0.5, 0.1, 0.6  # of the gear pair
SADDLE = 0.7563, 2.4633  # of the Duffing oscillator at the amplitude 4.2


@pytest.mark.parametrize(("seed", "place"), [(0, None), (1, None), (2, 1e-6)])
def test_a_bouncing_ball_begins_and_doubles_where_closed_forms_say(seed, place):
    """place: as near to 0 it is no length of the scene, and the table's swing is."""
    orbit, known = bounced(np.random.default_rng(seed), side=(-1, 1)[seed % 2], place=place)
    assert orbit.label == ("P110", "P101")[seed % 2] and orbit.stable
    name = f"{'left' if orbit.impacts.side[0] < 0 else 'right'}.motion.amplitude"
    branch = jv.follow(orbit, name, (0.5 * known["SN"], 1.2 * known["PD"]), stop="PD")
    for kind, expected in known.items():
        values = [point.value for point in branch.points(kind) if point.label == orbit.label]
        assert min(abs(value / expected - 1.0) for value in values) < 1e-10


def gears(amplitude=0.095):
    """Return a gear pair with a drag."""
    force = jv.Force("polynomial", {"c0": DRAG, "damping": 0.0})
    return jv.make_scene(amplitude, 1.0, restitution=BOUNCE, walls=(-TEETH, TEETH), force=force)


def period_later(scene, state):
    """Return a state of the Duffing oscillator a period later, by series in 20 digits."""
    numbers = {name: float(value) for name, value in scene.force.numbers.items()}
    with mpmath.workdps(20):
        given = numbers, float(scene.amplitude), float(scene.frequency), (-1.0, 1.0), 0.7
        return np.array(own_force.flown(own_force.duffing, *given, *state).end, float)


def test_manifolds_and_basins_under_a_force():
    """Another flight maps both manifolds into themselves, and the basins meet at the stable one."""
    scene = duffing(amplitude=4.2)
    saddle = jv.find_orbit(scene, jv.State(*SADDLE), 1, settle=0)
    assert not saddle.stable and abs(np.array([saddle.state.x, saddle.state.v]) - SADDLE).max() < 1e-3
    for kind in ("unstable", "stable"):
        data = jv.manifold(saddle, kind, 4.0, 0.0, 0.005, 0.01)
        early = data["arc"].values < (4.0 if kind == "stable" else 0.5)
        rows = np.flatnonzero(early & (data["arc"].values > 0) & (abs(data["v"].values) < 4.0))
        given = np.stack([data["x"].values, data["v"].values], -1)[rows[:: max(1, len(rows) // 20)]]
        stretch = abs(np.asarray(jv.monodromy(scene, jv.State(*given.T)))).max(axis=(1, 2))
        apart = distance(data, np.array([period_later(scene, each) for each in given]))
        assert len(given) >= 15 and np.max(apart / (1.0 + stretch)) < 1e-9
    attractors = [each for each in jv.find_attractors(scene, 40) if each.share > 0]
    assert len(attractors) == 2
    point = bisected(scene, attractors, (0.0, 0.5), (0.0, 2.0))
    assert distance(data, point[None])[0] < 1e-8


def test_the_diagram_of_a_gear_pair():
    """The closed forms; teeth that lie on each other stay so up to c0, beside the rattling that begins below it."""
    diagram = jv.explore(gears(), "amplitude", (0.02, 0.24), max_period=1)
    begins = np.pi * DRAG * (1 - BOUNCE) / (1 + BOUNCE)
    doubles = np.hypot(begins, 2 * DRAG * (1 + BOUNCE**2) / (1 + BOUNCE) ** 2)
    for kind, expected in (("SN", begins), ("PD", doubles)):
        assert min(abs(point.value - expected) for point in diagram.points(kind) if point.label == "P110") < 1e-10
    attractors = jv.find_attractors(gears(), 40)
    (rest,) = [each for each in attractors if each.rests]
    assert {each.label for each in attractors} == {"P110", "P100"} and rest.orbit.state.x == -TEETH
    hops = jv.find_attractors(gears(0.12), 40)
    assert "P1-inf-0" in {each.label for each in hops if each.rests}
