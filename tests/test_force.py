"""User-defined forces: Taylor series, closed forms, files, and invalid forces.

`tests/properties/test_flight.py` compares flights with series by hand, and a spring as a force with the spring.
"""

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest
from jax import lax
from mpmath import mp, mpf

import jaxvibro as jv
from jaxvibro.flight.jaxpr_series import force_series
from jaxvibro.flight.power_series import RULES, Series
from jaxvibro.scene.force_operations import SERIES_OPS_SET

DAMPING, OMEGA, R = 0.05, 2.1, 0.7
DUFFING = {"cubic": 0.5, "damping": DAMPING}


def spring(t, x, v, p):
    return -x - 2.0 * p["damping"] * v


def under(force):
    """Return a scene between rigid walls under a force."""
    return jv.make_scene(2.0, OMEGA, restitution=R, walls=(-1.0, 1.0), force=force)


# ---- series ------------------------------------------------------------------------------------------------------

SPECIAL = {
    "add": (lambda u: u + 0.3 * u * u, None),
    "add_any": (lambda u: u + u * u, None),
    "sub": (lambda u: u * u - u, None),
    "mul": (lambda u: u * (1.0 + u), None),
    "div": (lambda u: (1.0 + u) / (2.0 + u * u), None),
    "neg": (lambda u: -u, None),
    "square": (lambda u: lax.square(u), lambda u: u * u),
    "integer_pow": (lambda u: u**5 + u**-3, None),
    "pow": (lambda u: u**1.7 + (1.0 + u) ** (0.2 + u), None),
    "rsqrt": (lax.rsqrt, lambda u: 1 / mp.sqrt(u)),
    "cbrt": (lax.cbrt, mp.cbrt),
    "exp2": (lax.exp2, lambda u: mpf(2) ** u),
    "logistic": (lax.logistic, lambda u: 1 / (1 + mp.exp(-u))),
    "acosh": (lambda u: lax.acosh(1.5 + u), lambda u: mp.acosh(1.5 + u)),
    "atan2": (lambda u: lax.atan2(u * u - 0.3, 0.2 - u), lambda u: mp.atan2(u * u - 0.3, 0.2 - u)),
    "copy": (lambda u: jnp.array(u, copy=True), lambda u: u),
}


@pytest.mark.parametrize("name", sorted(RULES))
def test_each_operation_has_the_taylor_coefficients_of_its_function(name):
    function, exact = SPECIAL.get(name, (getattr(lax, name, None), getattr(mp, name, None)))
    exact = exact or function
    found = _coefficients(lambda t, x, v, p: function(0.4 + 0.3 * t - 0.1 * t * t), 12)
    with mpmath.workdps(40):
        true = mpmath.taylor(lambda t: exact(mpf(0.4) + mpf(0.3) * t - mpf(0.1) * t * t), 0, 12)
        size = max(map(abs, true))
        assert max(abs(a - b) for a, b in zip(found, true, strict=True)) < 4e-16 * max(1, size) * 50


def _coefficients(function, order):
    def found(zero):
        time, none = Series(lambda own, k: None, zero, 1.0), Series(None, zero)
        series = force_series(jv.Force(function, {}), time, none, none)
        return [zero if series[k] is None else series[k] + zero for k in range(order + 1)]

    return list(map(float, jax.jit(found)(jnp.zeros(()))))


def test_operations_that_are_accepted_have_a_rule():
    assert frozenset(RULES) == SERIES_OPS_SET


# ---- flights -----------------------------------------------------------------------------------------------------


def test_a_mass_at_rest_at_a_wall_at_0_stays():
    scene = jv.make_scene(0.0, OMEGA, restitution=R, walls=(0.0, None), force=jv.Force("duffing", DUFFING))
    end, hits = jv.strobe(scene, jv.State(0.0, 0.0))
    assert (end.x, end.v, hits.count, hits.status) == (0.0, 0.0, 0, 0)


def test_shallow_impacts():
    """A pendulum thrown at walls just below its turning point meets them, just above it not."""
    depth = 10.0 ** -np.arange(3.0, 11.5, 0.5)
    with mpmath.workdps(30):
        speed = mpf("0.8")
        top = float(2 * mp.asin(speed / 2))
        fast = float(mp.sqrt(speed**2 - 2 + 2 * mp.cos(mpf("0.3"))))
    walls = np.append(top - depth, top + depth)
    force = jv.Force("pendulum", {"damping": 0.0})
    scene = jv.make_scene(0.0, 1.0, restitution=R, walls=(None, walls), force=force)
    _, hits = jv.strobe(scene, jv.State(-0.3, fast))
    assert (np.asarray(hits.count) == np.repeat([1, 0], len(depth))).all()


@pytest.mark.parametrize(
    "force",
    [lambda t, x, v, p: p["g"], lambda t, x, v, p: -1.25, lambda t, x, v, p: p["g"] * jax.jit(lambda x: 1.0)(x)],
)
def test_a_constant_force_is_gravity(force):
    """A mass falls from rest, bounces and rises; the force is a parameter, a number, or calls an inner function."""
    scene = jv.make_scene(0.0, 3.0, restitution=R, walls=(-1.0, None), force=jv.Force(force, {"g": -1.25}))
    end, hits = jv.strobe(scene, jv.State(0.0, 0.0))
    fall = np.sqrt(2.0 / 1.25)
    rise, speed = 2.0 * np.pi / 3.0 - fall, R * 1.25 * fall
    assert hits.count == 1
    assert abs(end.x - (-1.0 + speed * rise - 0.625 * rise**2)) < 1e-13 and abs(end.v - (speed - 1.25 * rise)) < 1e-13


# ---- files and studies ---------------------------------------------------------------------------------------------


def test_a_force_in_scene_files(tmp_path):
    with pytest.raises(jv.ArgumentError, match=r"force.function: must be predefined \(duffing, .*\) to be saved"):
        jv.save_scene(under(jv.Force(spring, {"damping": DAMPING})), tmp_path / "other.toml")
    assert not (tmp_path / "other.toml").exists()
    jv.save_scene(under(jv.Force("duffing", DUFFING, 1e-13)), tmp_path / "scene.toml")
    text = (tmp_path / "scene.toml").read_text()
    for old, new, rule in (
        (
            'name = "duffing"',
            'name = "dufing"',
            "scene.force.function: must be a function, or the name of a predefined",
        ),
        ("cubic = 0.5\n", "", "scene.force.numbers: must be the parameters of duffing: cubic, damping; got 'damping'"),
        ("restitution = 0.7", "restitution = 0.7\ndamping = 0.1", "scene.damping: must not be given with a force"),
    ):
        (tmp_path / "wrong.toml").write_text(text.replace(old, new))
        with pytest.raises(jv.SceneError, match=rule):
            jv.load_scene(tmp_path / "wrong.toml")


def test_a_scene_file_with_a_force_runs(tmp_path):
    jv.save_scene(under(jv.Force("duffing", DUFFING, 1e-13)), tmp_path / "own.toml")
    sweep = """
        [sweep]
        parameter = "force.cubic"
        count = 3
        settle = 100
        keep = 4
        [[sweep.legs]]
        name = "up"
        from = 0.0
        to = 1.0
        start = {x = 0.9, v = -1.1}
    """
    (tmp_path / "own.toml").write_text((tmp_path / "own.toml").read_text() + sweep)
    jv.run(tmp_path / "own.toml", tmp_path / "out")
    data = jv.load_data(tmp_path / "out" / "own.nc")
    assert data.attrs["equation"].startswith("x'' = duffing(t, x, v) + amplitude cos(frequency t), ")
    assert "force.cubic" in (tmp_path / "out" / "own.txt").read_text()
    spring = jv.find_orbit(jv.make_scene(2.0, OMEGA, DAMPING, R, (-1.0, 1.0)), jv.State(0.9, -1.1))
    assert abs(data["x"].values.reshape(3, -1)[0] - spring.state.x).max() < 1e-9


def test_studies_of_springs_alone_refuse_a_force():
    scene = under(jv.Force(spring, {"damping": DAMPING}))
    record = jv.ImpactRecord(np.array([0.5, 1.5]), np.array([1, -1]), 1e-3)
    orbit = jv.find_orbit(scene.replace(amplitude=0.1), jv.State(0.0, 0.0), settle=50)
    for name, call in {
        "fit": lambda: jv.fit(scene, record, {"force.damping": 0.1}),
        "search": lambda: jv.search(scene, "SN", {"amplitude": 1.0}, {"amplitude": (1.0, 3.0)}),
        "margin of an orbit without impacts": lambda: jv.margin(orbit, {"amplitude": 1.0}),
    }.items():
        with pytest.raises(jv.ArgumentError, match=f"force: must be None for {name}"):
            call()


# ---- bad input ---------------------------------------------------------------------------------------------------

TURNS = 0


def _python_state(t, x, v, p):
    global TURNS
    TURNS += 1
    return -x * TURNS


@pytest.mark.parametrize(
    ("function", "rule"),
    [
        (lambda t, x, v, p: -jnp.log(x), "force: must be finite at all possible states"),
        (lambda t, x, v, p: jnp.stack([x, v]), r"force: must return one number of .* arguments; got .float64\[2\]"),
        (lambda t, x, v, p: (x, v), "force: must return one number"),
        (lambda t, x, v, p: [x], r"force: must return one number .*; got 'list of float64\[\]'"),
        (lambda t, x, v, p: None, "force: must return one number .*; got 'nothing'"),
        (lambda t, x, v, p: x * 1j, r"force: must return one number .*; got 'complex128\[\]'"),
        (
            lambda t, x, v, p: -x if x > 0 else x,
            r"force: .* \(TracerBoolConversionError\): use jnp.where",
        ),
        (lambda t, x, v, p: float(x), r"force: cannot be traced .* \(ConcretizationTypeError\): use jax.numpy"),
        (lambda t, x, v, p: -np.sin(x), r"force: .* \(TracerArrayConversionError\): use jax.numpy in place"),
        (lambda t, x, v, p: -x * p["k"], r"force: .* \(KeyError: 'k'\): its numbers are damping; got '<lambda>'"),
        (lambda t, x: -x, r"force: .* \(TypeError: .*\): it is called with \(t, x, v, numbers\)"),
        (_python_state, "force: must be the same in each trace"),
        (lambda t, x, v, p: (jax.debug.print("{}", x), -x)[1], r"force: must not print or call Python .*debug\.print"),
        (lambda t, x, v, p: -x + jnp.cos(t), "force: must repeat with the drive's period, 2.99199: "),
        ("van_der_pol", "force.numbers: must be the parameters of van_der_pol: gain; got 'damping'"),
        ("duff", r"force.function: must be a function, or the name of a predefined one, perhaps duffing \("),
    ],
)
def test_functions_that_are_no_forces_are_refused(function, rule):
    with pytest.raises(jv.SceneError, match=rule):
        under(jv.Force(function, {"damping": 0.1}))


@pytest.mark.parametrize(
    ("force", "rule"),
    [
        (jv.Force("polynomial", {"cx": 0.1}), "force.numbers: must be the parameters of polynomial: c0, c1, c2, ..."),
        (jv.Force(spring, {"damping": "much"}), "force.damping: must be a real number; got 'much'"),
        (jv.Force(spring, {"damping": np.nan}), "force.damping: must be finite"),
        (jv.Force(spring, {"a.b": 1.0}), "force.numbers: must have names of letters"),
        (jv.Force(spring, [1.0]), "force.numbers: must be a dict"),
        (jv.Force(spring, {"damping": 0.1}, 1e-20), "force.tolerance: must be a number from 1e-15 to 0.001; got 1e-20"),
        (spring, "force: must be a Force or None"),
    ],
)
def test_invalid_forces_are_refused(force, rule):
    with pytest.raises(jv.SceneError, match=rule):
        under(force)


def test_beside_a_force_there_is_no_damping():
    force = jv.Force(spring, {"damping": DAMPING})
    soft = None, jv.Wall(1.0, stiffness=9.0)
    for damping, walls, given, rule in (
        (0.1, (-1.0, 1.0), force, "damping: must not be given with a force"),
        (None, (-1.0, 1.0), None, "damping: must be given, unless a force"),
        (None, soft, force, "right.damping: must be given for a soft wall"),
    ):
        with pytest.raises(jv.SceneError, match=rule):
            jv.make_scene(2.0, OMEGA, damping, R, walls, force=given)
    scene = under(force)
    assert "damping" not in scene.names and scene.parameter("force.damping") == DAMPING
    assert scene.replace(**{"force.damping": 0.2}).parameter("force.damping") == 0.2
    with pytest.raises(jv.ArgumentError, match=r"force.dumping: is not a parameter of this scene, perhaps force.damp"):
        scene.replace(**{"force.dumping": 0.2})
