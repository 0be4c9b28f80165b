"""Forces that diffrax's solvers fly under: without a Taylor series, asked for, stiff, from a table."""

import subprocess
import sys

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import jaxvibro as jv
from jaxvibro.flight.power_series import RULES
from jaxvibro.scene.codes import Status
from jaxvibro.scene.force_operations import SERIES_OPS_SET

OMEGA, DAMPING, R = 2.1, 0.05, 0.7
COUNT = 64
RNG = np.random.default_rng(5)
STARTS = jv.State(RNG.uniform(-0.9, 0.9, COUNT), RNG.uniform(-2.0, 2.0, COUNT))


def bilinear(t, x, v, p):
    """A second spring beyond 0.4, to the right."""
    return -x - 2.0 * p["damping"] * v - p["stiffness"] * jnp.where(x > 0.4, x - 0.4, 0.0)


def looped(t, x, v, p):
    return -jax.lax.fori_loop(0, 1, lambda k, pull: pull + x, 0.0 * x) - 2.0 * p["damping"] * v


def scene(function, numbers=None, tolerance=1e-10, solver=None, walls=(-1.0, 1.0), amplitude=2.0, drive=()):
    force = jv.Force(function, {"damping": DAMPING} if numbers is None else numbers, tolerance, solver)
    return jv.make_scene(amplitude, OMEGA, restitution=R, walls=walls, force=force, drive=drive)


def linear(damping=DAMPING, amplitude=2.0, walls=(-1.0, 1.0)):
    return jv.make_scene(amplitude, OMEGA, damping, R, walls)


def apart(scene, other):
    """How far the ends of two scenes' strobes are apart at most, over 1 + the norm of the derivative: they are to have
    the same impacts."""
    end, impacts = jax.tree.map(np.asarray, jv.strobe(scene, STARTS))
    true, told = jax.tree.map(np.asarray, jv.strobe(other, STARTS))
    assert (impacts.status == told.status).all()
    assert (impacts.count == told.count).all()
    return (np.maximum(abs(end.x - true.x), abs(end.v - true.v)) / (1.0 + norm(other))).max()


def norm(scene):
    """The norms of the derivatives of the strobe at the starts."""
    return np.linalg.norm(np.asarray(jv.monodromy(scene, STARTS)).reshape(COUNT, -1), axis=1)


def test_a_loop_is_flown_by_dopri8_as_the_exact_flow_of_its_spring_has_it():
    end, impacts = jv.strobe(scene(looped), STARTS)
    true, told = jv.strobe(linear(), STARTS)
    assert (np.asarray(impacts.count) == np.asarray(told.count)).all()
    assert np.asarray(told.count).sum() > 50
    assert max(abs(end.x - true.x).max(), abs(end.v - true.v).max()) < 20 * 1e-10 * 10.0


def test_a_scene_says_how_it_flies():
    assert linear().flow.startswith("exact")
    assert scene("duffing", {"cubic": 0.5, "damping": 0.1}).flow.startswith("Taylor steps to 1e-10")
    assert scene(looped).flow == "steps of diffrax's Dopri8 to 1e-10: no Taylor series is known for scan"
    told = scene("pendulum", solver=diffrax.Kvaerno5(), tolerance=1e-7).flow
    assert told == "steps of diffrax's Kvaerno5 to 1e-07: selected by the user"
    table = {"x0": -1.0, "f0": -1.0, "x1": 0.0, "f1": 0.0, "x2": 1.0, "f2": 1.0, "damping": 0.1}
    assert "Dopri8" in scene("tabulated", table).flow


def test_the_operations_that_are_said_to_have_a_series_are_those_with_a_rule():
    assert frozenset(RULES) == SERIES_OPS_SET


@pytest.mark.parametrize(
    ("given", "rule"),
    [
        ({"solver": "Euler"}, "force.solver: must be a diffrax solver with error estimates.*'Euler'"),
        ({"solver": "Nobody"}, "force.solver: .*'Nobody'"),
        ({"solver": 3}, "force.solver: .*got 3"),
        ({"solver": diffrax.Tsit5(), "tolerance": 1e-15}, "force.tolerance: must be at least 1e-14 with a solver"),
        (
            {"numbers": {"damping": 1e6}},
            r'force: is too stiff for explicit steps, at a rate of 2e\+06: use solver="Kvaerno5"',
        ),
        ({"numbers": {"damping": 1e6}, "solver": "Tsit5"}, "force: is too stiff"),
    ],
)
def test_a_bad_solver_is_one_error(given, rule):
    with pytest.raises(jv.SceneError, match=rule):
        scene("pendulum", **given)
    scene("pendulum", {"damping": 1e6}, solver="Kvaerno5")


def test_a_solver_beside_a_soft_wall_is_one_error():
    soft = jv.Wall(0.4, stiffness=3.0, damping=DAMPING)
    with pytest.raises(
        jv.SceneError,
        match=r"force.solver: must be None .* Taylor steps, which do not exist for gt, select_n; got .*Dopri8",
    ):
        scene(bilinear, {"damping": DAMPING, "stiffness": 3.0}, walls=(-1.0, soft))


@pytest.mark.parametrize(
    ("numbers", "rule"),
    [
        ({"x0": 0.0, "f0": 0.0, "x1": 1.0, "f1": 1.0, "damping": 0.1}, "force.numbers: must be damping and x0, f0"),
        ({"x0": 0.0, "f0": 0.0, "x1": 1.0, "f1": 1.0, "x2": 2.0, "f3": 1.0, "damping": 0.1}, "force.numbers"),
        ({"x0": 0.0, "f0": 0.0, "x1": 2.0, "f1": 1.0, "x2": 1.0, "f2": 1.0, "damping": 0.1}, "force.x2: .* than x1"),
    ],
)
def test_a_bad_table_is_one_error(numbers, rule):
    with pytest.raises(jv.SceneError, match=rule):
        scene("tabulated", numbers)


def test_scenes_without_such_a_force_load_no_diffrax():
    code = (
        "import sys, jax; jax.config.update('jax_enable_x64', True); import jaxvibro as jv;"
        "s = jv.make_scene(2.0, 2.1, restitution=0.7, walls=(-1.0, 1.0), force=jv.Force('duffing', {'cubic': 0.5,"
        "'damping': 0.1})); s.flow; t = jv.make_scene(2.0, 2.1, 0.1, 0.7, (-1.0, 1.0)); t.flow;"
        "import jaxvibro.flight.force_flow; assert not {'diffrax', 'equinox', 'lineax'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_a_scene_file_names_a_solver(tmp_path):
    path = tmp_path / "scene.toml"
    jv.save_scene(scene("pendulum", solver="Kvaerno4"), path)
    assert 'solver = "Kvaerno4"' in path.read_text()
    assert jv.load_scene(path).force.solver == diffrax.Kvaerno4()
    own = diffrax.Kvaerno4(root_finder=diffrax.VeryChord(1e-9, 1e-9))
    with pytest.raises(ValueError, match=r"force\.solver: must be a solver that diffrax makes from its name alone"):
        jv.save_scene(scene("pendulum", solver=own), path, force=True)


@pytest.mark.parametrize("gap", [1.0, 2000.0])
@pytest.mark.parametrize("speed", [1e-5, 1e-14, 1e-40])
def test_errors_of_a_motion_much_smaller_than_its_scene_are_relative_to_the_motion(gap, speed):
    """A damped spring between impacts on a wall at 0: tolerance times gap is larger than the motion."""
    spring, damping, bounce = 1.68, 0.1, 0.6
    numbers = {"c0": 0.0, "c1": spring, "damping": damping}
    force = jv.Force("polynomial", numbers, tolerance=1e-8, solver="Tsit5")
    swings = jv.make_scene(0.0, 0.5, restitution=bounce, walls=(0.0, gap), force=force)
    end, impacts = jv.strobe(swings, jv.State(0.0, speed, 0.0, -1.0), slots=8)
    rate = np.sqrt(spring - damping**2)
    time = np.pi / rate * np.arange(1, 6)
    assert (int(impacts.status), int(impacts.count)) == (Status.OK, 5)
    np.testing.assert_allclose(impacts.time[:5], time, rtol=0, atol=2e-4)
    np.testing.assert_allclose(impacts.speed[:5], speed * np.exp(-damping * time) * bounce ** np.arange(5), rtol=1e-4)
    late = 4.0 * np.pi - time[-1]
    away = speed * bounce**5 * np.exp(-damping * 4.0 * np.pi)
    np.testing.assert_allclose(end.x, away * np.sin(rate * late) / rate, rtol=1e-3)


# ---- slow: every solver compiles for some seconds ----------------------------------------------------------------


def test_a_kink_is_flown_by_dopri8_as_the_exact_flow_of_a_soft_wall_has_it():
    force = scene(bilinear, {"damping": DAMPING, "stiffness": 3.0}, walls=(-1.0, None))
    soft = jv.Wall(0.4, stiffness=3.0, damping=DAMPING)
    end, impacts = jv.strobe(force, STARTS)
    exact = linear(walls=(-1.0, soft))
    true, told = jv.strobe(exact, STARTS)
    left = np.asarray(told.side == -1).sum(-1)
    assert (np.asarray(impacts.count) == left).all()
    assert left.sum() > 10
    error = np.maximum(abs(end.x - true.x), abs(end.v - true.v)) / (1.0 + norm(exact))
    assert error.max() < 20 * 1e-10 * 2.0


@pytest.mark.parametrize(
    ("solver", "tolerance"),
    [
        pytest.param("Tsit5", 1e-8, marks=pytest.mark.long),
        pytest.param("Dopri8", 1e-12, marks=pytest.mark.long),
        pytest.param("Kvaerno5", 1e-8, marks=pytest.mark.long),
    ],
)
def test_each_solver_comes_to_where_taylor_steps_come(solver, tolerance):
    numbers = {"cubic": 0.5, "damping": DAMPING}
    walls = jv.Wall(-1.2, 0.5), jv.Wall(0.9, motion=jv.Motion(0.1, 0.4, 2))
    more = {"walls": walls, "drive": [(0.4, 3, 0.5), (0.2, 0, 0.0)]}
    given, taylor = (scene("duffing", numbers, *how, **more) for how in ((tolerance, solver), (1e-14, None)))
    assert apart(given, taylor) < 20 * tolerance * 4.0


def test_derivatives_through_a_solver_are_those_of_taylor_steps():
    numbers = {"cubic": 0.5, "damping": DAMPING}

    def end(cubic, x, solver):
        return jv.strobe(scene("duffing", {**numbers, "cubic": cubic}, 1e-12, solver), jv.State(x, -1.1))[0].v

    found, true = (jax.grad(end, (0, 1))(0.5, 0.3, solver) for solver in ("Dopri8", None))
    np.testing.assert_allclose(found, true, rtol=0, atol=1e-9)
    forward = jax.jacfwd(end, (0, 1))(0.5, 0.3, "Dopri8")
    np.testing.assert_allclose(forward, found, rtol=0, atol=1e-12)


def test_kvaerno5_rests_and_flies_in_thick_oil_as_the_exact_flow_does():
    """Damping 500: boundary layers of 1e-3, and long stays on the walls, which take no more steps than the press."""
    thick = scene("duffing", {"cubic": 0.0, "damping": 500.0}, 1e-9, "Kvaerno5", amplitude=2000.0)
    exact = linear(500.0, 2000.0)
    end, impacts = jv.strobe(thick, STARTS)
    true, told = jv.strobe(exact, STARTS)
    assert (np.asarray(impacts.status) == np.asarray(told.status)).all()
    assert (np.asarray(impacts.status) < Status.CAP).all()
    np.testing.assert_allclose(end.x, true.x, rtol=0, atol=20 * 1e-9 * 2000.0)


def test_a_table_of_a_line_is_the_spring_and_one_of_a_curve_what_scipy_makes_of_it():
    places = np.linspace(-1.5, 1.5, 7)
    line = {f"{letter}{k}": x for k, x in enumerate(places) for letter in "xf"} | {"damping": DAMPING}
    assert apart(scene("tabulated", line), linear()) < 20 * 1e-10 * 2.0
    curve = line | {f"f{k}": x + 0.5 * x**3 for k, x in enumerate(places)}
    table = scene("tabulated", curve)
    pull = jax.jit(lambda x, v: table.force.function(0.0, x, v, table.force.numbers))
    for x, v in ((0.3, -1.1), (-0.2, 0.4)):
        end, impacts = jv.strobe(table, jv.State(x, v))
        true, count = _by_scipy(pull, x, v)
        assert int(impacts.count) == count
        np.testing.assert_allclose((end.x, end.v), true, rtol=0, atol=1e-8)


def _by_scipy(pull, x, v):
    """((x, v) a period later, how many impacts there were)."""

    def field(t, y):
        return [y[1], float(pull(y[0], y[1])) + 2.0 * np.cos(OMEGA * t)]

    def right(t, y):
        return y[0] - 1.0

    def left(t, y):
        return -1.0 - y[0]

    for event in (right, left):
        event.terminal, event.direction = True, 1.0
    t, state, count = 0.0, [x, v], 0
    while True:
        span = (t, 2.0 * np.pi / OMEGA)
        told = solve_ivp(field, span, state, "DOP853", rtol=1e-12, atol=1e-13, events=(right, left))
        t, state = told.t[-1], list(told.y[:, -1])
        if told.status != 1:
            return state, count
        state, count = [state[0], -R * state[1]], count + 1


def test_a_force_that_is_lost_on_the_way_is_capped_and_ends():
    def hole(t, x, v, p):
        return jnp.where(x > 0.9999, jnp.nan, -x)

    end, impacts = jv.strobe(scene(hole, {}), jv.State([0.3, -0.2], [-1.1, 0.4]))
    assert int(impacts.status[1]) == Status.CAP
    assert np.isnan(end.x[1])
