"""The reference of soft walls against other methods: a matrix exponential, Taylor steps, closed forms, differences."""

import math

import numpy as np
import pytest
from flint import arb, arb_mat, ctx

from tests import truths
from tests.kinds import KINDS, LANES
from tests.properties.motions import lane_of
from tests.reference import ball, soft
from tests.reference.scene import Motion, Scene, Soft, Wall
from tests.reference.search import Discard
from tests.reference.spring import Press, way_out


@pytest.mark.parametrize("damping", [0.0, 0.3, math.sqrt(50.0), 21.0])
@pytest.mark.parametrize("side", [-1, 1])
def test_contact_against_a_matrix_exponential(damping, side):
    """Of x as it is, on (x, v, 1, A cos, A sin, B cos, B sin), where the contact's own depth is nowhere used."""
    wall, omega = Soft(0.7, 49.0, damping, Motion(0.3, 0.4, 2)), 1.3
    scene = Scene(0.1, omega, 2.0, wall, wall)
    with ctx.workprec(300):
        k, w, g, theta, t = arb(49), arb(omega), arb(damping), arb(0.9), arb(1.7)
        rows = np.zeros((7, 7), object) + arb(0)
        rows[0, 1], rows[1, :2], rows[1, 2] = arb(1), [-1 - k, -2 * g], k * wall.position
        rows[1, 3], rows[1, 5] = arb(1), k
        rows[3, 4], rows[4, 3], rows[5, 6], rows[6, 5] = -w, w, -2 * w, 2 * w
        sin, cos = theta.sin_cos()
        sin_wall, cos_wall = (2 * theta + arb(0.4)).sin_cos()
        b, x, v = arb(0.3), arb(0.9), arb(-1.1)
        start = arb_mat(7, 1, [x, v, 1, 2 * cos, 2 * sin, b * cos_wall, b * sin_wall])
        expected = (arb_mat(7, 7, list(rows.flatten())) * t).exp() * start
        depth, speed = side * (x - wall.position - b * cos_wall), side * (v + 2 * w * b * sin_wall)
        d, u = Press(scene, side, wall, depth, speed, theta)(t)
        sin_wall, cos_wall = (2 * (theta + w * t) + arb(0.4)).sin_cos()
        got = wall.position + b * cos_wall + side * d, side * u - 2 * w * b * sin_wall
        for k in (0, 1):
            assert abs(got[k] - expected[k, 0]) < 1e-60


@pytest.mark.parametrize("stiffness", [3.0, 1e4, 1e10])
@pytest.mark.parametrize("share", [0.0, 0.11, 0.6])
def test_half_a_swing_is_known(stiffness, share):
    """Without a drive and with the wall at 0 it takes pi / sqrt(K - g^2) and leaves exp(-pi z / sqrt(1 - z^2))."""
    damping = share * math.sqrt(1 + stiffness)
    record = soft.strobe(Scene(0.1, 2.2, 0.0, None, Soft(0.0, stiffness, damping)), -0.3, 1.2)
    assert record.sides == [1] and [side for _, side in record.exits] == [1]
    with ctx.workprec(300):
        k = 1 + arb(stiffness)
        root, z = (k - arb(damping) ** 2).sqrt(), arb(damping) / k.sqrt()
        time, speed = record.exits[0][0], (-arb.pi() * z / (1 - z**2).sqrt()).exp() * record.speeds[0]
        assert abs(time - record.times[0] - arb.pi() / root) < 1e-38
        end = ball.flow(0.1, 2.2, 0.0, 0.0, arb(0), -speed, 2 * arb.pi() / arb(2.2) - time, 300)
        assert abs(end[0] - record.x) < 1e-38 and abs(end[1] - record.v) < 1e-38


def test_jacobian_against_differences():
    stiff, step = 0, arb(2) ** -106
    for number, lane in np.ndindex(2, LANES):
        scene, x, v, phase = lane_of(*KINDS["soft_moving"].draw(number), lane)
        scene = truths.plain(scene)
        try:
            record = soft.strobe(scene, x, v, phase)
        except Discard:
            continue
        with ctx.workprec(400):
            for column, (dx, dv) in enumerate(((step, 0), (0, step))):
                ahead, behind = (soft.strobe(scene, x + s * dx, v + s * dv, phase, precision=400) for s in (1, -1))
                for row, name in enumerate("xv"):
                    slope = (getattr(ahead, name) - getattr(behind, name)) / (2 * step)
                    assert abs(slope - record.jacobian[row][column]) < 1e-28 * (1 + record.norm)
        stiff += len(record.exits) > 0 and scene.left.stiffness > 1e3
    assert stiff > 1


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
