"""Motions that the reference of soft walls refuses, long presses, and starts on a wall.

`tests/properties/test_maps.py` compares its flights and derivatives with those of the package.
"""

import pytest
from flint import arb, ctx

from tests.reference import soft
from tests.reference.scene import Scene, Soft, Wall
from tests.reference.search import Discard
from tests.reference.spring import Press, way_out


def test_a_ring_at_the_way_out_is_refused():
    scene = Scene(0.0, 1.1, 2.0, None, Soft(-3.0, 1e4, 0.0))
    with ctx.workprec(200):
        presses = []
        for depth in (5e-9, 5e-11):
            back = Press(scene, 1, scene.right, arb(depth), arb(0), arb(0.3))(arb(-0.004))
            presses.append(Press(scene, 1, scene.right, *back, arb(0.3) + arb(1.1) * arb(-0.004)))
        assert way_out(presses[0], arb(0.008))[0] is None
        with pytest.raises(Discard, match="release"):
            way_out(presses[1], arb(0.008))


@pytest.mark.parametrize("share", [0.0, 0.5, 3.0])
def test_a_long_press_costs_little(share):
    """Half a drive period on the wall, 2,500 swings of a ring that, without damping, decides when it ends."""
    scene = Scene(0.05, 2.0, 2.0, None, Soft(0.0, 1e8, share * 1e4))
    with ctx.workprec(200):
        press = Press(scene, 1, scene.right, arb(2.4e-9), arb(0), arb(-1.5))
        time, turns = way_out(press, arb(3))
        force = float((arb(-1.5) + arb(2) * time).cos())
        assert 1.4 < time < 1.6 and len(turns) < 200
        assert 0.02 < force < 0.1 if share == 0 else abs(force) < 1e-2


def test_starts_on_a_soft_wall():
    scene = Scene(0.05, 2.1, 2.0, None, Soft(1.0, 100.0, 1.0))
    into, beyond = soft.strobe(scene, 1.0, 0.5), soft.strobe(scene, 1.0 + 2.0**-20, 0.5)
    assert into.times[0] == 0 and into.sides[0] == 1 and float(into.speeds[0]) == 0.5
    assert beyond.count == into.count - 1 and len(beyond.exits) == len(into.exits)
    assert soft.strobe(scene, 1.0, -0.5).count == 0
    with pytest.raises(Discard):
        soft.strobe(scene, 1.0 + 1e-12, 0.5)
    with pytest.raises(ValueError, match="beyond"):
        soft.strobe(scene._replace(left=Wall(-1.0, 0.5)), -1.5, 0.0)
