"""Soft walls: contacts at the start and the end, long contacts within stiff walls, and invalid walls."""

import numpy as np
import pytest

import jaxvibro as jv
from jaxvibro.scene.codes import Contact, Status

FIG10 = {"amplitude": 0.3, "frequency": 1.3, "damping": 0.05, "restitution": 0.7}


def soft(stiffness=10.0, damping=0.1, **changes):
    """Return the scene of figure 10 with two equal soft walls."""
    walls = tuple(jv.Wall(place, stiffness=stiffness, damping=damping) for place in (-1.0, 1.0))
    return jv.make_scene(**FIG10 | {"walls": walls} | changes)


def test_a_start_within_a_wall_needs_no_contact():
    scene = soft(50.0, 0.3)
    beyond = jv.strobe(scene, jv.State(1.1, 0.4))
    within = jv.strobe(scene, jv.State(1.1, 0.4, 0.0, Contact.WITHIN))
    assert float(beyond[0].x) == float(within[0].x) and beyond[1].count == within[1].count
    on_wall = jv.strobe(scene, jv.State(1.0, 0.4))[1]
    entered = jv.strobe(scene, jv.State(1.0, 0.4, 0.0, Contact.WITHIN))[1]
    assert on_wall.count == entered.count + 1 and on_wall.time[0] == 0.0
    assert np.allclose(on_wall.time[1 : on_wall.count], entered.time[: entered.count], rtol=0, atol=1e-14)


@pytest.mark.parametrize(
    ("contact", "wall"), [(2.0, jv.Wall(1.0, stiffness=9.0)), (3.0, 1.0), (4.0, jv.Wall(1.0, stiffness=9.0))]
)
def test_a_contact_that_the_wall_does_not_have_is_invalid(contact, wall):
    scene = jv.make_scene(**FIG10, walls=(None, wall))
    assert jv.strobe(scene, jv.State(1.0, 0.0, 0.0, contact))[1].status == Status.INVALID


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
    assert not impacts.status and abs((end.x + 1.0) - y) < 1e-15 and end.contact == Contact.WITHIN


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
