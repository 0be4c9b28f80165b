"""Soft walls: contacts at the start and the end, long contacts within stiff walls, chaos, and invalid walls."""

from dataclasses import replace

import numpy as np
import pytest

import jaxvibro as jv
from tests.reference.soft_lanes import Lanes, Wall, exponents

FIG10 = {"amplitude": 0.3, "frequency": 1.3, "damping": 0.05, "restitution": 0.7}


def test_a_start_within_a_wall_needs_no_contact():
    walls = tuple(jv.Wall(place, stiffness=50.0, damping=0.3) for place in (-1.0, 1.0))
    x, contact = [1.1, 1.1, 1.0, 1.0], [0.0, 3.0, 0.0, 3.0]
    end, impacts = jv.strobe(jv.make_scene(**FIG10, walls=walls), jv.State(x, 0.4, 0.0, contact))
    assert end.x[0] == end.x[1] and impacts.count[0] == impacts.count[1]
    count = int(impacts.count[3])
    assert impacts.count[2] == count + 1 and impacts.time[2, 0] == 0.0
    assert np.allclose(impacts.time[2, 1 : count + 1], impacts.time[3, :count], rtol=0, atol=1e-14)


@pytest.mark.parametrize(
    ("contact", "wall"), [(2.0, jv.Wall(1.0, stiffness=9.0)), (3.0, 1.0), (4.0, jv.Wall(1.0, stiffness=9.0))]
)
def test_a_contact_that_the_wall_does_not_have_is_invalid(contact, wall):
    scene = jv.make_scene(**FIG10, walls=(None, wall))
    assert jv.strobe(scene, jv.State(1.0, 0.0, 0.0, contact))[1].status == 3  # invalid


def test_a_pressed_mass_stays_within_a_very_stiff_wall():
    # statically: x - x_s = (A cos - x_s) / (1 + k2) at the slow drive's phase 0
    scene = jv.make_scene(3.0, 0.05, 0.3, 0.7, (None, jv.Wall(1.0, stiffness=1e10, damping=1e4)))
    start = jv.State(1.0 + 2.0 / (1.0 + 1e10), 0.0, 0.0, 3.0)
    end, impacts = jv.strobe(scene, start, slots=32)
    assert impacts.status == 0 and float(end.contact) == 3.0
    assert abs((float(end.x) - 1.0) * (1.0 + 1e10) - 2.0) < 1e-2


def test_a_contact_may_last_over_several_periods():
    """A long step may end where a period does: the next period is computed all the same."""
    stiffness, damping, amplitude, frequency = 1e6, 0.1, 0.3, 1.3
    scene = jv.make_scene(amplitude, frequency, 0.05, 0.7, (None, jv.Wall(-1.0, stiffness=stiffness, damping=damping)))
    end, impacts = jv.strobe(scene, jv.State(-1.0 + 1.9e-6, 0.0), periods=3)
    own, rate = 1.0 + stiffness, np.sqrt(1.0 + stiffness - damping**2)
    time, drive = 3 * 2 * np.pi / frequency, amplitude / (own - frequency**2 + 2j * damping * frequency)
    begin = 1.9e-6 - 1.0 / own - drive.real
    swing = begin, (0.0 - (1j * frequency * drive).real + damping * begin) / rate
    fade = np.exp(-damping * time)
    y = fade * (swing[0] * np.cos(rate * time) + swing[1] * np.sin(rate * time)) + 1.0 / own + drive.real
    assert not impacts.status and abs((end.x + 1.0) - y) < 1e-15 and end.contact == 3.0


def test_exponents_of_chaos_are_those_of_tangents_in_numpy():
    scene = jv.make_scene(1.0, 2.285, 0.045, 0.7, (None, jv.Wall(0.28, stiffness=10.0, damping=0.1)))
    found = jv.spectrum(scene, "amplitude", [1.0], jv.State(0.18, 0.3), error=0.05)
    count, periods = 32, 60
    v = 0.3 + 1e-7 * np.random.default_rng(1).normal(size=count)
    lanes = Lanes(1.0, 2.285, 0.045, [Wall(1, 0.28, None, 10.0, 0.1)], np.full(count, 0.18), v)
    rates, hits, within = exponents(lanes, periods, 200)
    errors = np.maximum(rates.std(axis=0, ddof=1) / count**0.5, 1 / periods)
    assert found.exponent[0, 0] > 0.05
    assert (abs(found.exponent[0] - rates.mean(axis=0)) < 4 * np.hypot(found.error[0], errors)).all()
    assert abs(found.within[0, 1] - within[1].mean()) < 0.1 and abs(found.impacts[0] - hits[1].mean()) < 0.15


def test_a_stable_manifold_needs_walls_below_critical_damping():
    walls = tuple(jv.Wall(place, stiffness=10.0, damping=damping) for place, damping in ((-1.0, 0.3), (1.0, 4.0)))
    orbit = jv.find_orbit(jv.make_scene(0.1, 1.6, 0.05, 0.7, walls), jv.State(0.0, 0.0))
    saddle = replace(orbit, multipliers=np.array([2.0, 0.5]))
    with pytest.raises(jv.ArgumentError, match=r"^right.damping: must be less than critical"):
        jv.manifold(saddle, "stable", 1.0, 0.0)


@pytest.mark.parametrize(
    ("wall", "key"),
    [
        (jv.Wall(1.0, restitution=0.5, stiffness=3.0), "right.restitution"),
        (jv.Wall(1.0, damping=0.5), "right.damping"),
        (jv.Wall(1.0, stiffness=0.0), "right.stiffness"),
        (jv.Wall(1.0, stiffness=2.0, damping=-0.1), "right.damping"),
        (jv.Wall(1.0, stiffness=np.inf), "right.stiffness"),
    ],
)
def test_invalid_walls_are_refused(wall, key):
    with pytest.raises(jv.ArgumentError, match=f"^{key}: "):
        jv.make_scene(**FIG10, walls=(-1.0, wall))
