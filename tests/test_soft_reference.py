"""The references of soft walls against other routes: Taylor steps, SciPy, closed forms, limits, differences."""

import math
from functools import partial

import numpy as np
import pytest
from flint import arb, arb_mat, ctx
from mpmath import mp, mpf
from scipy.integrate import solve_ivp

from tests.reference import ball, draws, orbit, soft, soft_draws, stored
from tests.reference.scene import Motion, Scene, Soft, Wall
from tests.reference.search import Discard
from tests.reference.spring import Press, way_out
from tests.test_reference import fair_draws, off_plain_steps, to_mp

fair = partial(fair_draws, draw=soft_draws.draw, strobe=soft.strobe)


def softest(scene):
    """The largest rate of a contact."""
    return max(math.sqrt(1 + w.stiffness) + 2 * w.damping for _, w in scene.walls() if isinstance(w, Soft))


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


def test_strobe_against_plain_taylor_steps():
    seen = 0
    for seed, drawn, record in fair(range(150)):
        if softest(drawn.scene) / drawn.scene.omega > 5:
            continue
        assert off_plain_steps(drawn, record) < 1e-29, seed
        seen += record.count
    assert seen > 8


def test_stiff_strobe_against_scipy():
    """Piece by piece between the reference's events: each piece keeps to its side and ends on the wall."""
    seen = 0
    for seed, (scene, x, v, phase), record in fair(range(400, 460)):
        events = [(float(t), side, 1) for t, side in zip(record.times, record.sides, strict=True)]
        events += [(float(t), side, -1) for t, side in record.exits]
        events = [*sorted(events), (2 * math.pi / scene.omega, 0, 0)]
        held = sum(side for side, wall in scene.walls() if side * (x - draws.position(wall, phase)) > 0)
        state, t = np.array([x, v]), 0.0
        if record.norm > 1e5 or softest(scene) * (events[-1][0] - t) > 2e4 or len(events) > 12:
            continue
        for time, side, kind in events:
            state = fly(scene, phase, held, state, t, time, record)
            t = time
            if kind:
                wall = scene.left if side < 0 else scene.right
                place, pace = wall_at(wall, scene.omega, phase + scene.omega * t)
                assert state[0] == pytest.approx(place, abs=1e-9 * record.scale * (1 + record.norm)), seed
                state[0] = place
                if isinstance(wall, Wall):
                    state[1] = pace - wall.restitution * (state[1] - pace)
                else:
                    held = side if kind > 0 else 0
                    seen += 1
        assert held == record.held
        error = max(abs(float(record.x) - state[0]), abs(float(record.v) - state[1]))
        assert error < 1e-9 * record.scale * (1 + record.norm), seed
    assert seen > 30


def wall_at(wall, omega, theta):
    """Position and velocity of a wall at a drive phase, floats."""
    b, own, m = wall.motion or Motion(0.0)
    return draws.position(wall, theta), -b * m * omega * math.sin(m * theta + own)


def fly(scene, phase, held, state, begin, end, record):
    """The state at the end of a piece; it lies beyond the wall `held` all the time, and beyond no other."""
    inside = {0: None, -1: scene.left, 1: scene.right}[held]

    def slope(t, y):
        theta = phase + scene.omega * t
        pull = scene.amplitude * math.cos(theta) - y[0] - 2 * (inside.damping if inside else scene.gamma) * y[1]
        return y[1], pull - inside.stiffness * (y[0] - draws.position(inside, theta)) if inside else pull

    found = solve_ivp(slope, (begin, end), state, "DOP853", rtol=1e-12, atol=1e-14, dense_output=True)
    times = np.linspace(begin, end, 200)[1:-1]
    path, slack = found.sol(times)[0], 1e-9 * record.scale * (1 + record.norm)
    for side, wall in scene.walls():
        gap = side * (np.array([draws.position(wall, phase + scene.omega * t) for t in times]) - path)
        assert np.all((-gap if side == held else gap) > -slack)
    return found.y[:, -1]


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
        assert float(speed) == pytest.approx(record.least_exit, rel=1e-14)
        end = ball.flow(0.1, 2.2, 0.0, 0.0, arb(0), -speed, 2 * arb.pi() / arb(2.2) - time, 300)
        assert abs(end[0] - record.x) < 1e-38 and abs(end[1] - record.v) < 1e-38


@pytest.mark.parametrize("share", [0.0, 0.11, 0.5])
def test_the_stiff_limit_is_the_rigid_wall(share):
    left = math.exp(-math.pi * share / math.sqrt(1 - share**2))
    rigid = Scene(0.05, 2.1, 2.0, Wall(-1.0, left), Wall(1.0, left))
    true, errors = orbit.strobe(rigid, 0.1, 1.3), []
    for stiffness in (1e8, 1e10, 1e12, 1e14):
        wall = Soft(1.0, stiffness, share * math.sqrt(1 + stiffness))
        record = soft.strobe(rigid._replace(left=wall._replace(position=-1.0), right=wall), 0.1, 1.3)
        assert record.sides == true.sides and record.count >= 2
        errors.append(max(abs(float(record.x - true.x)), abs(float(record.v - true.v))))
    assert errors[0] < 1e-2
    assert np.allclose(np.divide(errors[:-1], errors[1:]), 10, rtol=0.05)


def test_a_wall_without_force_is_none():
    bare = Scene(0.05, 2.1, 2.0)
    true = soft.strobe(bare, 0.1, 3.3)
    errors = []
    for stiffness in (0.0, 1e-20, 1e-22):
        record = soft.strobe(bare._replace(right=Soft(0.5, stiffness, 0.05, Motion(0.2, 1.0, 2))), 0.1, 3.3)
        assert record.sides == [1] and record.held == 0 and len(record.exits) == 1
        errors.append(abs(record.x - true.x))
    assert errors[0] < 1e-40
    assert float(errors[1] / errors[2]) == pytest.approx(100, rel=1e-6)


@pytest.mark.parametrize("stiffness", [1.0, 1e3, 1e7])
def test_energy_stays(stiffness):
    scene = Scene(0.0, 0.31, 0.0, Soft(-0.4, stiffness, 0.0), Soft(0.2, 2 * stiffness, 0.0))

    def energy(x, v):
        sprung = [w.stiffness * (x - w.position) ** 2 for side, w in scene.walls() if side * (x - w.position) > 0]
        return sum(sprung, x**2 + v**2)

    with ctx.workprec(200):
        for x in (0.1, 0.2 + 1 / math.sqrt(stiffness)):
            record = soft.strobe(scene, x, 0.7)
            assert record.count > 3 and abs(energy(record.x, record.v) - energy(arb(x), arb(0.7))) < 1e-30


def test_jacobian_against_differences():
    held, stiff = set(), 0
    for seed, (scene, x, v, phase), record in fair(range(900, 960)):
        with ctx.workprec(400):
            step = arb(10) ** -32
            for j, (dx, dv) in enumerate(((step, 0), (0, step))):
                ahead, behind = (
                    soft.strobe(scene, arb(x) + way * dx, arb(v) + way * dv, phase, precision=400) for way in (1, -1)
                )
                for i, name in enumerate("xv"):
                    slope = (getattr(ahead, name) - getattr(behind, name)) / (2 * step)
                    assert abs(slope - record.jacobian[i][j]) < 1e-28 * (1 + record.norm), seed
        held.add((record.counts[0] > 1, record.counts[1] > 1))
        stiff += len(record.exits) > 0 and softest(scene) > 1e3
    assert len(held) > 2 and stiff > 5


def test_a_ring_at_the_way_out_is_refused():
    scene = Scene(0.0, 1.1, 2.0, None, Soft(-3.0, 1e4, 0.0))
    with ctx.workprec(200):
        for depth, refused in ((5e-11, True), (5e-9, False)):
            back = Press(scene, 1, scene.right, arb(depth), arb(0), arb(0.3))(arb(-0.004))
            press = Press(scene, 1, scene.right, *back, arb(0.3) + arb(1.1) * arb(-0.004))
            if refused:
                with pytest.raises(Discard, match="release"):
                    way_out(press, arb(0.008))
            else:
                assert way_out(press, arb(0.008))[0] is None


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


def test_draws_are_what_they_say():
    starts, kinds = set(), set()
    for seed in range(1000):
        scene, x, _, phase = soft_draws.draw(seed)
        gaps = [side * (draws.position(wall, phase) - x) for side, wall in scene.walls()]
        kinds |= {type(wall) for _, wall in scene.walls()}
        inside = [wall for gap, (_, wall) in zip(gaps, scene.walls(), strict=True) if gap < 0]
        assert all(isinstance(wall, Soft) for wall in inside)
        starts.add(len(inside))
        if scene.left and scene.right:
            swings = sum((wall.motion or Motion(0.0)).amplitude for _, wall in scene.walls())
            assert scene.right.position - scene.left.position > swings
    assert starts == {0, 1} and kinds == {Wall, Soft}


def test_what_is_stored_comes_back(tmp_path):
    first, refused = stored.fair(20, tmp_path)
    lines = (tmp_path / stored.FILE).read_text()
    again = stored.fair(20, tmp_path)
    assert again == (first, refused) and (tmp_path / stored.FILE).read_text() == lines
    record = soft.strobe(*first[0].draw)
    assert float(first[0].x) == float(record.x) and stored.less(first[0].x, float(first[0].x)) != 0
    with mp.workdps(50):
        assert abs(mpf(str(first[0].x)) - to_mp(record.x)) < mpf(10) ** -38
    stale = lines.replace(repr(first[0].draw.x), "0.125", 1)
    (tmp_path / stored.FILE).write_text(stale)
    assert stored.fair(20, tmp_path) == (first, refused)
