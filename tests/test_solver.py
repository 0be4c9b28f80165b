"""Forces integrated by diffrax's solvers: without a Taylor series, by request, stiff, from a table."""

import subprocess
import sys

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline

import jaxvibro as jv

OMEGA, DAMPING, R = 2.1, 0.05, 0.7
RNG = np.random.default_rng(5)
STARTS = jv.State(RNG.uniform(-0.9, 0.9, 8), RNG.uniform(-2.0, 2.0, 8))


def bilinear(t, x, v, p):
    """A second spring beyond 0.4, to the right."""
    return -x - 2.0 * p["damping"] * v - p["stiffness"] * jnp.where(x > 0.4, x - 0.4, 0.0)


def looped(t, x, v, p):
    return -jax.lax.fori_loop(0, 1, lambda k, pull: pull + x, 0.0 * x) - 2.0 * p["damping"] * v


def scene(function, numbers=None, tolerance=1e-10, solver=None, walls=(-1.0, 1.0), amplitude=2.0):
    force = jv.Force(function, {"damping": DAMPING} if numbers is None else numbers, tolerance, solver)
    return jv.make_scene(amplitude, OMEGA, restitution=R, walls=walls, force=force)


def linear(damping=DAMPING, amplitude=2.0, walls=(-1.0, 1.0)):
    return jv.make_scene(amplitude, OMEGA, damping, R, walls)


def test_a_scene_says_how_it_flies():
    assert linear().flow.startswith("exact")
    assert scene("duffing", {"cubic": 0.5, "damping": 0.1}).flow.startswith("Taylor steps to 1e-10")
    assert scene(looped).flow == "steps of diffrax's Dopri8 to 1e-10: no Taylor series is known for scan"
    told = scene("pendulum", solver=diffrax.Kvaerno5(), tolerance=1e-7).flow
    assert told == "steps of diffrax's Kvaerno5 to 1e-07: selected by the user"
    table = {"x0": -1.0, "f0": -1.0, "x1": 0.0, "f1": 0.0, "x2": 1.0, "f2": 1.0, "damping": 0.1}
    assert "Dopri8" in scene("tabulated", table).flow


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


def test_scenes_without_a_solver_do_not_load_diffrax():
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


@pytest.mark.parametrize(("gap", "speed"), [(1.0, 1e-5), (2000.0, 1e-5), (1.0, 1e-14), (2000.0, 1e-40)])
def test_errors_of_a_motion_much_smaller_than_its_scene_are_relative_to_the_motion(gap, speed):
    """A damped spring between impacts on a wall at 0: tolerance times gap is larger than the motion."""
    spring, damping, bounce = 1.68, 0.1, 0.6
    numbers = {"c0": 0.0, "c1": spring, "damping": damping}
    force = jv.Force("polynomial", numbers, tolerance=1e-8, solver="Tsit5")
    swings = jv.make_scene(0.0, 0.5, restitution=bounce, walls=(0.0, gap), force=force)
    end, impacts = jv.strobe(swings, jv.State(0.0, speed, 0.0, -1.0), slots=8)
    rate = np.sqrt(spring - damping**2)
    time = np.pi / rate * np.arange(1, 6)
    assert (int(impacts.status), int(impacts.count)) == (0, 5)
    np.testing.assert_allclose(impacts.time[:5], time, rtol=0, atol=2e-4)
    np.testing.assert_allclose(impacts.speed[:5], speed * np.exp(-damping * time) * bounce ** np.arange(5), rtol=1e-4)
    late = 4.0 * np.pi - time[-1]
    away = speed * bounce**5 * np.exp(-damping * 4.0 * np.pi)
    np.testing.assert_allclose(end.x, away * np.sin(rate * late) / rate, rtol=1e-3)


@pytest.mark.parametrize("name", ["loop", "table", "kink", "stiff"])
def test_solvers_agree_with_the_exact_flow(name):
    """stiff: boundary layers of 1e-3, and long times on the walls. kink: the spring is that of a soft wall."""
    line = {f"{letter}{k}": x for k, x in enumerate(np.linspace(-1.5, 1.5, 7)) for letter in "xf"}
    line["damping"] = DAMPING
    more = {"walls": (-1.0, jv.Wall(0.4, stiffness=3.0, damping=DAMPING))}
    stiff = {"c1": 1.0, "damping": 500.0}
    given, other, error = {
        "loop": (scene(looped), linear(), 1e-10),
        "table": (scene("tabulated", line), linear(), 1e-10),
        "kink": (scene(bilinear, {"damping": DAMPING, "stiffness": 3.0}, walls=(-1.0, None)), linear(**more), 1e-10),
        "stiff": (scene("polynomial", stiff, 1e-9, "Kvaerno5", amplitude=2000.0), linear(500.0, 2000.0), 1e-6),
    }[name]
    (end, impacts), (expected, others) = (jax.device_get(jv.strobe(each, STARTS)) for each in (given, other))
    hits = (others.side == -1).sum(-1) if name == "kink" else others.count
    assert (impacts.status == others.status).all() and (impacts.status < 2).all()
    assert (impacts.count == hits).all() and impacts.count.sum() > 2
    norm = np.linalg.norm(np.asarray(jv.monodromy(other, STARTS)), axis=(1, 2))
    assert (np.maximum(abs(end.x - expected.x), abs(end.v - expected.v)) / (1.0 + norm)).max() < 80 * error


def test_a_table_is_a_cubic_interpolation():
    places = np.linspace(-1.5, 1.5, 7)
    forces = places + 0.5 * places**3
    numbers = {f"x{k}": x for k, x in enumerate(places)} | {f"f{k}": f for k, f in enumerate(forces)}
    table = scene("tabulated", numbers | {"damping": DAMPING}).force
    expected = CubicHermiteSpline(places, forces, np.gradient(forces, places, edge_order=2))
    for x in (-1.4, -0.3, 0.05, 0.9, 1.3):
        pull = float(table.function(0.0, x, 0.7, table.numbers))
        assert abs(pull + float(expected(x)) + 2.0 * DAMPING * 0.7) < 1e-13
    slope = float(expected(1.5, 1))  # linear beyond the ends
    pull = float(table.function(0.0, 2.0, 0.0, table.numbers))
    assert abs(pull + forces[-1] + 0.5 * slope) < 1e-12


def test_a_force_that_is_not_finite_ends_with_a_status():
    def hole(t, x, v, p):
        return jnp.where(x > 0.9999, jnp.nan, -x)

    end, impacts = jv.strobe(scene(hole, {}), jv.State([0.3, -0.2], [-1.1, 0.4]))
    assert impacts.status[1] == 2
    assert np.isnan(end.x[1])
