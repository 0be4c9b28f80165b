"""Branches of orbits that rest: through complete chatter both ways, releases within a rest, in two parameters."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.optimize import fsolve

import jaxvibro as jv

from .properties.branches import STUCK, end_names
from .special_points import completion_value, zero_force_value

ONE_WALL = {"frequency": 0.5, "damping": 0.05, "restitution": 0.5, "walls": (None, 0.5)}


def followed(amplitude, bounds, name="amplitude", **numbers):
    scene = jv.make_scene(amplitude, **{**ONE_WALL, **numbers})
    return jv.follow(jv.find_orbit(scene, jv.State(0.0, 0.0)), name, bounds)


@pytest.fixture(scope="module")
def from_rest():
    return followed(1.5, (1.35, 1.6))


def test_a_branch_goes_on_where_a_chatter_just_does_not_complete(from_rest):
    (point,) = from_rest.points("CH")
    assert point.label == "P1-0-inf"
    assert point.value == pytest.approx(completion_value(point), abs=1e-12)
    labels = [part.label for part in from_rest.segments]
    assert labels[0] == "P107"
    assert labels[-1] == "P1-0-inf"
    assert len(set(labels)) == len(labels) > 9
    assert from_rest.stable[from_rest.values > point.value].all()
    assert not from_rest.multipliers[from_rest.values > point.value].any()
    assert [one.label for one in point.meets] == [labels[-2]]
    orbit = from_rest.orbit(-1)
    again = jv.find_orbit(orbit.scene, orbit.state, settle=0)
    assert (again.label, again.rests, orbit.rests) == (orbit.label, True, True)
    assert (again.state.x, again.state.v) == pytest.approx((orbit.state.x, orbit.state.v), abs=1e-11)


def test_an_impact_with_r_0_at_which_the_force_on_the_wall_grows_is_an_ordinary_one():
    branch = followed(2.0, (1.9, 2.1), frequency=0.7, damping=0.1, restitution=0.0)
    assert len(branch) > 5 and {point.kind for point in branch.special} == {"EP"}
    for place, amplitude in ((0, 1.9), (-1, 2.1)):
        (time,) = branch.orbit(place).impacts.time
        assert amplitude * np.cos(0.7 * time) > 0.5 and np.sin(0.7 * time) < 0.0  # presses, and ever more
        again = jv.find_orbit(branch.scene.replace(amplitude=amplitude), jv.State(0.0, 0.0))
        assert time == pytest.approx(float(again.impacts.time[0]), abs=1e-12)


def test_a_branch_that_starts_without_a_rest_has_the_same_completion(from_rest):
    scene = from_rest.scene.replace(amplitude=1.37)
    diagram = jv.explore(scene, "amplitude", (1.35, 1.6), max_period=1)
    (back,) = diagram.branches
    assert back.segments[-1].label == "P1-0-inf" and diagram.complete
    assert back.points("CH")[0].value == pytest.approx(from_rest.points("CH")[0].value, abs=1e-12)
    assert sorted(back.reasons) == sorted(from_rest.reasons)


def test_grazings_approach_the_completion_as_the_scaling_says(from_rest):
    """The ratio mu depends on the restitution alone; its corrections shrink by one factor a hop."""
    (point,), restitution = from_rest.points("CH"), 0.5
    roots = np.roots(np.polyadd(np.polymul([1.0, 1.0], [9.0, -6.0, 1.0]), [-8.0 * restitution, 0.0]))
    (q,) = [root.real for root in roots if abs(root.imag) < 1e-12 and 1.0 / 3.0 < root.real < 1.0]
    mu = (1.0 + q) ** 2 / (2.0 * q**2 * (3.0 * q - 1.0))
    gaps = point.value - np.sort([one.value for one in from_rest.points("GR")])
    ratios = gaps[:-1] / gaps[1:]
    last = np.diff(ratios)
    limit = ratios[2:] - last[1:] ** 2 / np.diff(last)
    assert len(limit) > 7 and limit[-1] == pytest.approx(mu, rel=1e-3)
    assert abs(limit[-1] - mu) < abs(ratios[-1] - mu)


def rests_of(branch):
    """Return how often the mass sticks in the orbit of each point."""
    return (abs(branch.data["side"].values) == STUCK).sum(axis=1)


@pytest.fixture(scope="module")
def letting_go():
    drive = (jv.Motion(-1.0, harmonic=3, phase=0.0),)  # at phase 0 the press is 1.5 + drive.0.amplitude - 0.3
    numbers = {"frequency": 0.15, "damping": 0.1, "restitution": 0.3, "walls": (None, 0.3), "drive": drive}
    return followed(1.5, (-1.4, -0.9), "drive.0.amplitude", **numbers)


def test_a_wall_that_lets_go_within_a_rest_is_a_point_of_its_own(letting_go):
    (point,), branch = letting_go.points("RL"), letting_go
    assert point.value == pytest.approx(-1.2, abs=1e-10)
    assert (rests_of(branch)[branch.values > -1.2] == 1).all()
    assert (rests_of(branch)[branch.values < -1.2 - 1e-6] == 2).all()
    assert branch.values[[0, -1]] == pytest.approx([-1.4, -0.9])


def test_grazings_of_orbits_that_rest_are_followed_in_two_parameters():
    grazing = followed(1.02, (1.0, 1.02), walls=(-0.2, 0.5)).points("GR")[0]
    assert float(jv.sensitivity(grazing, "damping")[0]) == pytest.approx(-1.00346396, abs=1e-7)  # by differences
    found = jv.locus(grazing, ("amplitude", "frequency"), {"amplitude": (0.7, 1.2), "frequency": (0.45, 0.55)})
    assert not [one for one in found.special if one.kind != "EP"]
    assert found.data["residual"].values.max() < 1e-11
    place = int(np.argmin(abs(found.values[:, 1] - 0.53)))
    amplitude, frequency = found.values[place]
    there = followed(amplitude - 1e-3, (amplitude - 2e-3, amplitude + 2e-3), frequency=frequency, walls=(-0.2, 0.5))
    assert min(abs(one.value - amplitude) for one in there.points("GR")) < 1e-10


def test_a_complete_chatter_is_followed_in_two_parameters(from_rest):
    (point,) = from_rest.points("CH")
    found = jv.locus(point, ("amplitude", "restitution"), {"amplitude": (0.5, 2.0), "restitution": (0.05, 0.95)})
    assert [one.kind for one in found.special] == ["EP", "EP"]
    assert found.values[0, 1] == pytest.approx(0.05)  # where other hops are rows than at the start
    assert len(set((found.data["side"].values != 0).sum(axis=1))) > 1
    assert found.data["residual"].values.max() < 1e-11
    for place in np.linspace(1, len(found) - 2, 3).astype(int):
        scene, spot = found.located(int(place))
        just = completion_value(SimpleNamespace(scene=scene, spot=spot, value=spot.value))
        assert spot.value == pytest.approx(just, abs=1e-12)


def test_a_release_within_a_rest_is_followed_in_two_parameters(letting_go):
    (point,) = letting_go.points("RL")
    names = "drive.0.amplitude", "right.position"
    found = jv.locus(point, names, {"drive.0.amplitude": (-1.6, -0.8), "right.position": (0.1, 0.5)})
    assert [one.kind for one in found.special] == ["EP", "EP"]
    assert np.ptp(found.values, axis=0).min() > 0.39
    assert found.values @ [-1.0, 1.0] == pytest.approx(np.full(len(found), 1.5), abs=1e-9)


def test_where_a_grazing_meets_a_complete_chatter_its_locus_ends():
    grazing = followed(0.6, (0.5, 0.7), walls=(-0.2, 0.5)).points("GR")[-1]
    names = "amplitude", "left.position"
    found = jv.locus(grazing, names, {"amplitude": (0.1, 4.0), "left.position": (-0.5, 0.0)})
    (end,) = [one for one in found.special if one.kind == "CH"]
    scene = grazing.scene.replace(**end.values)
    around = jv.follow(jv.find_orbit(scene.replace(amplitude=0.7), jv.State(0.0, 0.0)), "amplitude", (0.5, 0.7))
    assert around.points("CH")[0].value == pytest.approx(end.values["amplitude"], abs=1e-8)


def degenerate(wall, frequency, damping, start):
    """(amplitude, that of a second harmonic, a sine) at which a mass that a right wall lets go comes back to it without
    speed as the press begins: by phasors."""
    turn = np.sqrt(1.0 - damping**2)

    def press(t, one, two):
        return one * np.cos(frequency * t) - two * np.sin(2.0 * frequency * t) - wall

    def steady(t, one, two):
        both = ((one, frequency, 0.0), (two, 2.0 * frequency, 0.5 * np.pi))
        waves = [(a * np.exp(1j * (w * t + p)) / (1.0 - w * w + 2j * damping * w), w) for a, w, p in both]
        return np.array([sum(wave.real for wave, _ in waves), sum((1j * w * wave).real for wave, w in waves)])

    def left(numbers):
        begin, end, *drive = numbers
        x, v = np.array([wall, 0.0]) - steady(begin, *drive)
        late, shrunk = turn * (end - begin), np.exp(-damping * (end - begin))
        x, v = (
            shrunk * (x * np.cos(late) + (v + damping * x) / turn * np.sin(late)),
            shrunk * (v * np.cos(late) - (x + damping * v) / turn * np.sin(late)),
        )
        found = steady(end, *drive) + np.array([x, v])
        return [press(begin, *drive), press(end, *drive), found[0] - wall, found[1]]

    found = fsolve(left, start, xtol=1e-14)
    assert max(abs(np.array(left(found)))) < 1e-13
    return found[2:]


def test_a_locus_of_grazings_ends_where_the_touch_has_no_acceleration():
    amplitude, second = degenerate(0.5, 0.4, 0.03, (3.0, 12.7, 1.36, 0.0))
    drive = (jv.Motion(second - 0.02, harmonic=2, phase=0.5 * np.pi),)
    scene = jv.make_scene(amplitude, 0.4, 0.03, 0.3, (None, 0.5), drive=drive)
    near = (amplitude - 0.3, amplitude + 0.3)
    (grazing,) = jv.follow(jv.find_orbit(scene, jv.State(0.0, 0.0)), "amplitude", near).points("GR")
    names = "amplitude", "drive.0.amplitude"
    found = jv.locus(grazing, names, dict(zip(names, (near, (second - 0.2, second + 0.2)), strict=True)))
    (point,) = found.points("DG")
    assert list(point.values.values()) == pytest.approx([amplitude, second], abs=1e-12)
    assert point.place in (0, len(found) - 1)
    assert point.residual < 1e-12


MOVING = (-0.554009691, jv.Wall(1.230039735, motion=jv.Motion(0.215097563, 1.033105633)))
PLASTIC = {  # kind of the special points: labels, bounds, two starts, numbers of the scene
    "RL": (("P101", "P102", "P101"), (1.22, 3.0), (2.5, 1.95), (0.451214832, 0.160099801, (None, 0.709703876))),
    "CH": (("P111", "P111"), (0.9, 1.9), (1.7, 1.1), (0.677596525, 0.267945675, MOVING)),
}


@pytest.mark.parametrize("kind", PLASTIC)
def test_a_branch_with_r_0_goes_on_where_the_force_at_an_impact_vanishes(kind):
    """Between two RL the mass is drawn off its wall once more before it rests; at a CH a rest comes to no length."""
    labels, bounds, starts, (frequency, damping, walls) = PLASTIC[kind]
    numbers = {"frequency": frequency, "damping": damping, "restitution": 0.0, "walls": walls}
    first, second = (followed(amplitude, bounds, **numbers) for amplitude in starts)
    for branch in (first, second):
        assert end_names(branch) == ["BOUND", "BOUND"]
        assert tuple(part.label for part in branch.segments) == labels
        assert [point.kind for point in branch.special] == ["EP", *[kind] * (len(labels) - 1), "EP"]
        values = [point.value for point in branch.points(kind)]
        assert values == pytest.approx([point.value for point in first.points(kind)], abs=1e-12)
        assert {one.label for point in branch.points("RL") for one in point.meets} <= set(labels)
    for point in first.points(kind):
        assert zero_force_value(point) == pytest.approx(point.value, abs=1e-13)
    if kind == "CH":
        for value in (1.21, 1.23):
            place = int(np.argmin(abs(first.values - value)))
            assert rests_of(first)[place] == (1 if first.values[place] < point.value else 2)
