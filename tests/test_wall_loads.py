"""What walls bear, against SciPy's flights with the energies integrated along, and against the balance of energies."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import minimize_scalar

import jaxvibro as jv
from jaxvibro.output.units import to_physical

TIGHT = {"rtol": 1e-12, "atol": 1e-13, "method": "DOP853"}
START = jv.State(0.3, 0.6)


def flown(scene, periods):
    """({side: (largest speed, largest force, energy to the wall)}, span) by SciPy, between still walls."""
    A, w, damping = (float(scene.parameter(name)) for name in ("amplitude", "frequency", "damping"))
    span, walls = 2 * np.pi * periods / w, scene.walls
    borne = {side: [0.0, 0.0, 0.0] for side in walls}
    signs = {"left": -1.0, "right": 1.0}

    def push(side, x, v):
        wall = walls[side]
        if not wall.soft:
            return 0.0
        extra = 2.0 * (float(wall.damping) - damping) * signs[side] * v
        return float(wall.stiffness) * signs[side] * (x - float(wall.position)) + extra

    def field(t, y, within):
        x, v, *_ = y
        own = {side: push(side, x, v) if side == within else 0.0 for side in walls}
        pull = A * np.cos(w * t) - x - 2 * damping * v - sum(signs[side] * one for side, one in own.items())
        return [v, pull, *(one * signs[side] * v for side, one in own.items())]

    t, y, within = 0.0, np.array([float(START.x), float(START.v), *[0.0] * len(walls)]), None
    while t < span:
        events = [lambda t, y, within, side=side: signs[side] * (y[0] - float(walls[side].position)) for side in walls]
        for event in events:
            event.terminal, event.direction = True, -1 if within else 1
        if within is not None:  # from the wall itself: the event begins at zero
            events = [events[list(walls).index(within)]]
        run = solve_ivp(field, (t, span), y, events=events, args=(within,), dense_output=True, max_step=0.05, **TIGHT)
        if within is not None:

            def less(t, side=within, sol=run.sol):
                return -push(side, *sol(t)[:2])

            grid = np.linspace(t, run.t[-1], 400)
            near = grid[np.argmin([less(each) for each in grid])]
            step = grid[1] - grid[0]
            best = minimize_scalar(
                less,
                bounds=(max(t, near - step), min(run.t[-1], near + step)),
                method="bounded",
                options={"xatol": 1e-12},
            )
            borne[within][1] = max(borne[within][1], -best.fun, -less(t))
        t, y = run.t[-1], run.y[:, -1].copy()
        if run.status != 1:
            break
        if within is not None:
            within = None
            continue
        side = list(walls)[next(k for k, found in enumerate(run.t_events) if len(found))]
        borne[side][0] = max(borne[side][0], abs(y[1]))
        if walls[side].soft:
            within = side
        else:
            R = float(scene.bounce(side))
            borne[side][2] += 0.5 * (1 - R**2) * y[1] ** 2
            y[1] *= -R
    for k, side in enumerate(walls):
        borne[side][2] += y[2 + k]
    return borne, span


SCENES = {
    "rigid": lambda: jv.make_scene(3.1, 1.9, 0.06, 0.75, (jv.Wall(-1.1, 0.6), 0.9)),
    "soft": lambda: jv.make_scene(
        2.5, 1.7, 0.05, 0.7, (jv.Wall(-1.0, stiffness=30.0, damping=0.4), jv.Wall(0.8, stiffness=900.0, damping=2.0))
    ),
    "mixed": lambda: jv.make_scene(2.5, 1.3, 0.1, 0.8, (-1.2, jv.Wall(0.7, stiffness=5e4, damping=20.0))),
}


@pytest.mark.parametrize(
    "kind", [pytest.param(one, marks=pytest.mark.slow if one == "rigid" else pytest.mark.long) for one in SCENES]
)
def test_what_walls_bear_is_what_scipy_integrates(kind):
    scene = SCENES[kind]()
    borne, span = flown(scene, 4)
    found = jv.wall_loads(scene, START, 4)
    for side, (speed, force, energy) in borne.items():
        own = found.sel(wall=side)
        assert speed > 0 and float(own["largest_speed"]) == pytest.approx(speed, rel=1e-8)
        assert float(own["work_rate"]) == pytest.approx(energy / span, rel=1e-7)
        if scene.walls[side].soft:
            assert float(own["largest_force"]) == pytest.approx(force, rel=1e-7)
        else:
            assert np.isnan(own["largest_force"])
    assert int(found["status"]) == 0


@pytest.mark.long
def linear(depth, rate, p):
    """The push of a spring and a damper, of a wall that stands still."""
    return p["k"] * depth + 2.0 * p["c"] * rate


@pytest.mark.parametrize("kind", ["one", "soft and rigid", "two, one at 0 and moving", "law"])
def test_beside_a_force_they_are_those_of_the_spring_that_it_equals(kind):
    """Those of the spring are SciPy's. Beside a force a wall adds 2 gamma2 x', beside the spring 2 (gamma2 - gamma) x':
    with gamma = 0 both are one."""
    left = jv.Wall(-0.5, stiffness=40.0, damping=0.3)
    spring, own = {
        "one": ((left, None), (left, None)),
        "soft and rigid": ((left, jv.Wall(0.8, 0.7)), (left, jv.Wall(0.8, 0.7))),
        "two, one at 0 and moving": (
            (
                jv.Wall(0.0, stiffness=40.0, damping=0.3, motion=jv.Motion(0.05, 0.3, 2)),
                jv.Wall(0.6, stiffness=30.0, damping=0.2),
            ),
        )
        * 2,
        "law": ((left, None), (jv.Wall(-0.5, law=jv.Push(linear, {"k": 40.0, "c": 0.3})), None)),
    }[kind]
    force = jv.Force("duffing", {"cubic": 0.0, "damping": 0.0})
    scenes = jv.make_scene(1.5, 1.3, 0.0, walls=spring), jv.make_scene(1.5, 1.3, walls=own, force=force)
    true, found = (jv.wall_loads(scene, jv.State(0.3, 0.8, 0.4), 2) for scene in scenes)
    assert int(found["status"]) == int(true["status"]) == 0 and float(true["largest_speed"].min()) > 0
    for name in ("largest_speed", "largest_force", "work_rate"):
        np.testing.assert_allclose(found[name], true[name], rtol=1e-9, atol=1e-12)


def test_a_ball_on_a_soft_ground_beside_a_force_in_closed_form():
    """No drive: it falls from 0 with -3 under x'' = -x onto a wall at -2, k 100 and gamma2 2.5."""
    wall = jv.Wall(-2.0, stiffness=100.0, damping=2.5)
    force = jv.Force("duffing", {"cubic": 0.0, "damping": 0.0})
    found = jv.wall_loads(jv.make_scene(0.0, 4.0, walls=(wall, None), force=force), jv.State(0.0, -3.0))
    speed = 5.0**0.5  # 3^2 - 2^2
    assert float(found["largest_speed"][0]) == pytest.approx(speed, rel=1e-12)
    # within it y'' + 5 y' + 101 y = -2 of the depth y, from y = 0 with y' = speed, until y = 0
    rest, root = -2.0 / 101.0, (101.0 - 2.5**2) ** 0.5
    t = np.linspace(0.0, 1.2 * np.pi / root, 2_000_001)
    sine = (speed - 2.5 * rest) / root
    y = rest + np.exp(-2.5 * t) * (-rest * np.cos(root * t) + sine * np.sin(root * t))
    w = np.exp(-2.5 * t) * (
        (2.5 * rest + root * sine) * np.cos(root * t) + (root * rest - 2.5 * sine) * np.sin(root * t)
    )
    end = np.flatnonzero(y[1:] < 0)[0] + 2
    push = (100.0 * y + 5.0 * w)[:end]
    assert float(found["largest_force"][0]) == pytest.approx(push.max(), rel=1e-9)
    work = np.trapezoid(push * w[:end], t[:end]) / (2.0 * np.pi / 4.0)
    assert float(found["work_rate"][0]) == pytest.approx(work, rel=1e-5)


def test_lanes_are_single_runs_and_units_are_told():
    scene, x = SCENES["soft"](), np.array([[0.3, -0.5, 0.9], [0.0, 0.1, -1.05]])  # two of them begin within a wall
    many = jv.wall_loads(scene, jv.State(x, 0.6), 2)
    assert many["largest_force"].dims == ("lane_0", "lane_1", "wall") and many["wall"].values.tolist() == [
        "left",
        "right",
    ]
    for place in np.ndindex(x.shape):
        one = jv.wall_loads(scene, jv.State(x[place], 0.6), 2)
        for name in one:
            np.testing.assert_allclose(one[name], many[name][place], rtol=1e-10)
    rig = jv.scene_from_physical(0.5, None, 3e4, 30.0, None, 0.7, gap=0.5e-3, damping_ratio=0.05, frequency_hz=60.0)
    own = jv.wall_loads(rig, START)
    physical = to_physical(own)
    assert physical["work_rate"].attrs["units"] == "W" and physical["largest_force"].attrs["units"] == "N"
    watts = 3e4 * 0.5e-3**2 * np.sqrt(6e4)
    np.testing.assert_allclose(physical["work_rate"], watts * own["work_rate"], rtol=1e-14)


def test_a_branch_s_work_rate_is_the_same_by_its_data():
    orbit = jv.find_orbit(jv.make_scene(4.65, 2.1, 0.05, 0.7, (-1.0, 1.0)), jv.State(0.9, -1.1))
    branch = jv.follow(orbit, "amplitude", (4.0, 5.0))
    told = branch.to_frame()
    states = jv.State(branch.data["x"].values[:, 0], branch.data["v"].values[:, 0])
    found = jv.wall_loads(branch.scene.replace(amplitude=branch.values), states)
    sure = np.abs(branch.multipliers).max(axis=1) < 50.0
    np.testing.assert_allclose(found["work_rate"].sum("wall")[sure], told["work_rate"][sure], rtol=1e-8)
    np.testing.assert_allclose(found["largest_speed"].max("wall")[sure], told["largest_speed"][sure], rtol=1e-8)


def test_a_mass_that_comes_to_rest_leaves_all_its_energy():
    """Without a drive between still walls: what is lost is the energy at the start, less that of the pressed spring."""
    scene = jv.make_scene(0.0, 1.0, 0.0, 0.4, (0.5, None))
    found = jv.wall_loads(scene, jv.State(1.5, 0.0), 3)
    span = 6 * np.pi
    assert float(found["work_rate"].sum()) * span == pytest.approx(0.5 * (1.5**2 - 0.5**2), rel=1e-9)


def test_what_cannot_be_is_refused():
    with pytest.raises(jv.ArgumentError, match="periods: must be"):
        jv.wall_loads(SCENES["rigid"](), START, 0)
    assert jv.wall_loads(jv.make_scene(1.0, 1.0, 0.1, 0.5, (None, None)), START)["status"] == 0


def test_of_a_sweep_they_keep_its_dimensions():
    scene = jv.make_scene(2.0, 2.1, 0.05, 0.7, (-1.0, 1.0))
    swept = jv.sweep(scene, "amplitude", [1.5, 2.5, 3.5], jv.State(0.9, -1.1), settle=20, keep=2)
    found = jv.wall_loads(scene, swept)
    assert found["work_rate"].dims == (*swept["x"].dims, "wall") and found["amplitude"].equals(swept["amplitude"])
    states = jv.State(swept["x"].values, swept["v"].values)
    own = jv.wall_loads(scene.replace(amplitude=swept["amplitude"].values[:, None]), states)
    assert np.array_equal(found["largest_speed"].values, own["largest_speed"].values)
    with pytest.raises(jv.ArgumentError, match="state: must be a State, or a Dataset of sweep"):
        jv.wall_loads(scene, found)
