"""Branches and diagrams under user-defined forces: special points by closed forms and by series in many digits."""

from dataclasses import replace

import numpy as np
import pytest

import jaxvibro as jv

from .force_specials import bounced, duffing, residual

TEETH, DRAG, BOUNCE = 0.5, 0.1, 0.6  # of the gear pair


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


def van_der_pol(amplitude):
    """Return van der Pol's oscillator between two walls, of which no one knows whether areas grow."""
    force = jv.Force("van_der_pol", {"gain": 0.2})
    return jv.make_scene(amplitude, 2.1, restitution=0.8, walls=(-1.0, 1.0), force=force)


def test_multipliers_of_product_1_are_a_neimark_sacker_point_or_a_neutral_saddle():
    """The determinant passes 1 with complex multipliers, or, beyond a symmetry breaking, with real ones."""
    branch = jv.follow(jv.find_orbit(van_der_pol(3.0), jv.State(0.3, 0.2)), "force.gain", (0.0, 1.0))
    (complex_pair,) = branch.points("NS")
    assert abs(abs(complex_pair.multipliers) - 1.0).max() < 1e-10 and abs(complex_pair.multipliers[0].imag) > 0.1
    orbit = jv.find_orbit(van_der_pol(6.0), jv.State(0.92853085, 3.21050462), periods=1, settle=0)
    branch = jv.follow(orbit, "force.gain", (0.2, 0.5), direction="forward", stop="NSA")
    assert [point.kind for point in branch.special] == ["EP", "NSA"]
    (saddle,) = branch.points("NSA")
    assert abs(np.prod(saddle.multipliers) - 1.0) < 1e-12 and saddle.multipliers[0] > 8.0 and saddle.normal_form is None
    for point in (complex_pair, saddle):
        assert point.label == "P111" and residual(point) < 1e-9


def test_the_error_estimate_of_a_special_point():
    force = replace(duffing().force, tolerance=1e-8)
    scene = jv.make_scene(2.0, 2.1, restitution=0.7, walls=(-1.0, 1.0), force=force)
    point = jv.follow(jv.find_orbit(scene, jv.State(0.9, -1.1)), "amplitude", bounds=(0.0, 6.0)).points("SN")[0]
    estimate = jv.located(point).flow_error()
    tight = replace(point.scene, force=replace(point.scene.force, tolerance=1e-14))
    true = abs(float(jv.located(replace(point, scene=tight))(tight)) - point.value)
    assert 1e-11 < true < 1e-7
    assert 0.2 * true < estimate < 5.0 * true


def test_an_orbit_without_impacts_and_its_grazing():
    branch = jv.follow(jv.find_orbit(duffing(amplitude=0.5), jv.State(0.0, 0.0)), "amplitude", (0.0, 6.0))
    points = " ".join(f"{point.kind} {point.label}" for point in branch.special)
    assert points == "EP P100 GR P100 SN P111 SB P111 EP P111"
    assert max(residual(point) for point in branch.special[1:4]) < 1e-10


def test_a_pendulum_without_walls_breaks_its_symmetry_and_doubles_its_period():
    """The pendulum of Baker and Gollub, Chaotic Dynamics, chapter 3: q = 2, driven at 2 / 3."""
    force = jv.Force("pendulum", {"damping": 0.25})
    scene = jv.make_scene(0.95, 2.0 / 3.0, restitution=0.7, walls=(None, None), force=force)
    branch = jv.follow(jv.find_orbit(scene, jv.State(0.1, 0.0)), "amplitude", (0.95, 1.02), direction="forward")
    (breaking,) = branch.points("SB")
    tilted = jv.switch(breaking, bounds=(0.9, 1.08))
    assert [point.label for point in tilted[0].special] == ["P100", "P100", "P100"] and len(tilted) == 2
    (double,) = tilted[0].points("PD")
    assert abs(double.value - tilted[1].points("PD")[0].value) < 1e-11  # of its mirror image
    assert abs(double.value - 1.0663) < 2e-4  # as printed there
    (twice,) = jv.switch(double)
    assert twice.special[1].kind == "PD" and twice.special[1].label == "P200" and twice.stable[1]
    for point in (breaking, double, twice.special[1]):
        assert residual(point) < 1e-9
    assert breaking.normal_form is None and "P200" in twice.table()
    for ask in (lambda: jv.sensitivity(double, ["force.damping"]), lambda: jv.located(breaking)):
        with pytest.raises(jv.ArgumentError, match="special: must belong to an orbit with impacts"):
            ask()


def test_the_resonance_of_duffing_without_walls_folds():
    """The hard spring, driven at 1.6: between two folds two motions are stable."""
    scene = duffing((None, None), 0.1, cubic=1.0, frequency=1.6)
    branch = jv.follow(jv.find_orbit(scene, jv.State(0.0, 0.0)), "amplitude", (0.05, 1.5))
    folds = branch.points("SN")
    assert len(folds) == 2 and branch.data["least_clearance"].values.min() == np.inf
    assert all(fold.normal_form is None and residual(fold) < 1e-9 for fold in folds) and "SN" in branch.table()
    between = abs(branch.values - np.mean([fold.value for fold in folds])) < 0.05
    assert branch.stable[between].any() and not branch.stable[between].all()


def test_a_spring_without_walls_has_a_branch():
    scene = jv.make_scene(1.0, 2.0, 0.05, 0.7, (None, None))
    branch = jv.follow(jv.find_orbit(scene, jv.State(0.0, 0.0)), "frequency", (0.5, 3.0))
    assert [point.kind for point in branch.special] == ["EP", "EP"]
    peak = np.hypot(branch.data["x"].values[:, 0], branch.data["v"].values[:, 0] / branch.values)
    assert np.allclose(peak, 1.0 / np.hypot(1.0 - branch.values**2, 0.1 * branch.values), rtol=1e-9)
    assert np.isinf(branch.data["least_clearance"].values).all()
