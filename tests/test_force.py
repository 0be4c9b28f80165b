"""User-defined forces: Taylor series, closed forms, derivatives, orbits and branches, files, and invalid forces.

`tests/properties/test_flight.py` compares flights with series by hand, and a spring as a force with the spring.
"""

from dataclasses import replace

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

from .reference import own_force

DAMPING, OMEGA, R = 0.05, 2.1, 0.7
NUMBERS = {
    "duffing": {"cubic": 0.5, "damping": DAMPING},
    "stribeck": {"belt": 0.3, "low": 0.1, "high": 0.25, "slip": 0.8, "smooth": 0.4},
}


def spring(t, x, v, p):
    return -x - 2.0 * p["damping"] * v


def own(force, amplitude=2.0, tolerance=1e-13):
    """Return a scene between rigid walls under a predefined force."""
    force = jv.Force(force, NUMBERS[force], tolerance)
    return jv.make_scene(amplitude, OMEGA, restitution=R, walls=(-1.0, 1.0), force=force)


def linear(**more):
    return jv.make_scene(2.0, OMEGA, DAMPING, R, (-1.0, 1.0)).replace(**more)


def linear_as_own(**more):
    force = jv.Force(spring, {"damping": DAMPING}, 1e-13)
    return jv.make_scene(2.0, OMEGA, restitution=R, walls=(-1.0, 1.0), force=force).replace(**more)


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


def test_periods_of_a_pendulum_and_of_duffing_between_elastic_walls_are_elliptic_integrals():
    for name, start in (("pendulum", 2.9), ("pendulum", 0.4), ("duffing", 1.7)):
        force = jv.Force(name, {"damping": 0.0} | ({"cubic": 0.8} if name == "duffing" else {}), 1e-14)
        scene = jv.make_scene(0.0, 0.05, restitution=1.0, walls=(0.0, None), force=force)
        _, hits = jv.strobe(scene, jv.State(start, 0.0), slots=32)
        with mpmath.workdps(30):
            if name == "pendulum":
                quarter, speed = mp.ellipk(mp.sin(mpf(start) / 2) ** 2), 2 * mp.sin(mpf(start) / 2)
            else:
                stiff = 1 + mpf("0.8") * mpf(start) ** 2
                quarter = mp.ellipk(mpf("0.8") * mpf(start) ** 2 / (2 * stiff)) / mp.sqrt(stiff)
                speed = mp.sqrt(mpf(start) ** 2 + mpf("0.8") * mpf(start) ** 4 / 2)
            for k in range(5):
                assert abs(hits.time[k] - (2 * k + 1) * quarter) < 1e-12 * (1 + 2 * k)
                assert abs(hits.speed[k] - speed) < 1e-12


def test_a_mass_at_rest_at_a_wall_at_0_stays():
    scene = jv.make_scene(0.0, OMEGA, restitution=R, walls=(0.0, None), force=jv.Force("duffing", NUMBERS["duffing"]))
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


def test_sections_and_the_return_map_are_those_of_the_spring():
    found, expected = (jv.return_map(scene, "right", 0.3, -1.0) for scene in (linear_as_own(), linear()))
    assert found.found == expected.found == 1
    assert abs(found.velocity - expected.velocity) < 1e-12 and abs(found.time - expected.time) < 1e-12
    motions = [jv.simulate(scene, jv.State(-0.9, 2.0, 1.1), 2) for scene in (linear_as_own(), linear())]
    assert np.allclose(motions[0]["x"], motions[1]["x"], rtol=0, atol=1e-12)


# ---- derivatives -------------------------------------------------------------------------------------------------


def _end(scene, force, args):
    x, v, amplitude, *numbers = args
    names = [f"force.{name}" for name in NUMBERS[force]]
    scene = scene.replace(amplitude=amplitude, **dict(zip(names, numbers, strict=True)))
    end, hits = jv.strobe(scene, jv.State(x, v))
    return jnp.stack([end.x, end.v, hits.time[0], hits.speed[0]])


@pytest.mark.parametrize("force", ["duffing", "stribeck"])
def test_derivatives_are_differences_of_series_by_hand(force):
    scene, args = own(force), np.array([0.3, 0.4, 2.0, *NUMBERS[force].values()])
    found = np.asarray(jax.jacfwd(lambda args: _end(scene, force, args))(args))
    back = np.asarray(jax.jacrev(lambda args: _end(scene, force, args))(args))
    assert np.allclose(found, back, rtol=0, atol=1e-12 * abs(found).max())

    def at(args):
        numbers = dict(zip(NUMBERS[force], args[3:], strict=True))
        given = args[2], OMEGA, (-1.0, 1.0), R, args[0], args[1]
        (x, v), met, *_ = own_force.flown(own_force.FORCES[force], numbers, *given)
        return [x, v, met[0][0], met[0][2]]

    with mpmath.workdps(28):
        step = mpf(10) ** -9
        for k in range(len(args)):
            ends = [[mpf(each) + (sign * step if j == k else 0) for j, each in enumerate(args)] for sign in (1, -1)]
            true = [(a - b) / (2 * step) for a, b in zip(*map(at, ends), strict=True)]
            assert max(abs(a - b) for a, b in zip(found[:, k], true, strict=True)) < 1e-10 * abs(found).max()


# ---- orbits and branches -----------------------------------------------------------------------------------------


def test_an_orbit_without_impacts_and_its_grazing():
    scene = own("duffing", amplitude=0.5)
    orbit = jv.find_orbit(scene, jv.State(0.0, 0.0))
    assert orbit.label == "P100" and orbit.residual < 1e-14
    branch = jv.follow(orbit, "amplitude", (0.0, 6.0))
    points = " ".join(f"{point.kind} {point.label}" for point in branch.special)
    assert points == "EP P100 GR P100 SN P111 SB P111 EP P111"
    grazing = branch.points("GR")[0]
    with mpmath.workdps(40):  # the motion that grazes turns back at 1
        x, v = grazing.orbit.state.x, grazing.orbit.state.v
        numbers = grazing.value, OMEGA, (-1.0 - 1e-9, 1.0 + 1e-9), R, x, v
        end, met, _, nearest, _ = own_force.flown(own_force.duffing, NUMBERS["duffing"], *numbers)
        assert not met and abs(nearest - 1e-9) < 1e-12
        assert abs(end[0] - x) < 1e-12 and abs(end[1] - v) < 1e-12


def test_a_force_that_feeds_the_motion_has_a_neimark_sacker_point():
    """Van der Pol's oscillator between two walls: its determinant passes 1 with complex multipliers."""
    force = jv.Force("van_der_pol", {"gain": 0.2})
    scene = jv.make_scene(3.0, OMEGA, restitution=0.8, walls=(-1.0, 1.0), force=force)
    branch = jv.follow(jv.find_orbit(scene, jv.State(0.3, 0.2)), "force.gain", (0.0, 1.0))
    (point,) = branch.points("NS")
    assert point.label == "P111" and point.orbit.state.phase == 0
    assert abs(abs(point.multipliers) - 1.0).max() < 1e-10 and abs(point.multipliers[0].imag) > 0.1
    with mpmath.workdps(28):
        step, x, v = mpf(10) ** -9, mpf(point.orbit.state.x), mpf(point.orbit.state.v)

        def map_of(x, v, gain):
            return own_force.flown(own_force.van_der_pol, {"gain": gain}, 3.0, OMEGA, (-1.0, 1.0), 0.8, x, v)[0]

        def area(gain):
            (a, c), (b, d) = (
                [(p - q) / (2 * step) for p, q in zip(map_of(*one), map_of(*two), strict=True)]
                for one, two in (
                    ((x + step, v, gain), (x - step, v, gain)),
                    ((x, v + step, gain), (x, v - step, gain)),
                )
            )
            return a * d - b * c

        assert abs(area(mpf(point.value)) - 1) < 1e-9


def test_the_error_estimate_of_a_special_point():
    orbit = jv.find_orbit(own("duffing", tolerance=1e-8), jv.State(0.9, -1.1))
    point = jv.follow(orbit, "amplitude", bounds=(0.0, 6.0)).points("SN")[0]
    estimate = jv.located(point).flow_error()
    tight = replace(point.scene, force=replace(point.scene.force, tolerance=1e-14))
    true = abs(float(jv.located(replace(point, scene=tight))(tight)) - point.value)
    assert 1e-11 < true < 1e-7
    assert 0.2 * true < estimate < 5.0 * true


def test_a_named_force_survives_files(tmp_path):
    scene = own("duffing", tolerance=1e-12)
    jv.save_scene(scene, tmp_path / "scene.toml")
    again = jv.load_scene(tmp_path / "scene.toml")
    assert again.numbers == scene.numbers and again.force.function is scene.force.function
    assert again.force.tolerance == 1e-12
    with pytest.raises(jv.ArgumentError, match=r"force.function: must be predefined \(duffing, .*\) to be saved"):
        jv.save_scene(linear_as_own(), tmp_path / "other.toml")
    assert not (tmp_path / "other.toml").exists()
    text = (tmp_path / "scene.toml").read_text()
    for change, rule in (
        (
            ('name = "duffing"', 'name = "dufing"'),
            "scene.force.function: must be a function, or the name of a predefined one, perhaps",
        ),
        (
            ("cubic = 0.5\n", ""),
            r"scene.force.numbers: must be the parameters of duffing: cubic, damping; got 'damping'",
        ),
        (("restitution = 0.7", "restitution = 0.7\ndamping = 0.1"), "scene.damping: must not be given with a force"),
    ):
        (tmp_path / "wrong.toml").write_text(text.replace(*change))
        with pytest.raises(jv.SceneError, match=rule):
            jv.load_scene(tmp_path / "wrong.toml")


def test_a_scene_file_with_a_force_runs(tmp_path):
    text = """
        [scene]
        amplitude = 2.0
        frequency = 2.1
        restitution = 0.7
        left = {position = -1.0}
        right = {position = 1.0}
        force = {name = "duffing", numbers = {cubic = 0.5, damping = 0.05}}
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
    (tmp_path / "own.toml").write_text(text)
    jv.run(tmp_path / "own.toml", tmp_path / "out")
    data = jv.load_data(tmp_path / "out" / "own.nc")
    assert data.attrs["equation"].startswith("x'' = duffing(t, x, v) + amplitude cos(frequency t), ")
    assert "force.cubic" in (tmp_path / "out" / "own.txt").read_text()
    spring = jv.find_orbit(linear(), jv.State(0.9, -1.1))
    assert abs(data["x"].values.reshape(3, -1)[0] - spring.state.x).max() < 1e-9


def test_studies_of_springs_alone_refuse_a_force():
    scene = linear_as_own()
    record = jv.ImpactRecord(np.array([0.5, 1.5]), np.array([1, -1]), 1e-3)
    with pytest.raises(jv.ArgumentError, match=r"force: must be None for fit"):
        jv.fit(scene, record, {"force.damping": 0.1})
    with pytest.raises(jv.ArgumentError, match=r"force: must be None for search"):
        jv.search(scene, "SN", {"amplitude": 1.0}, {"amplitude": (1.0, 3.0)})
    orbit = jv.find_orbit(scene.replace(amplitude=0.1), jv.State(0.0, 0.0), settle=50)
    with pytest.raises(jv.ArgumentError, match=r"force: must be None for margin of an orbit without impacts"):
        jv.margin(orbit, {"amplitude": 1.0})


# ---- bad input ---------------------------------------------------------------------------------------------------

TURNS = 0


def _python_state(t, x, v, p):
    global TURNS
    TURNS += 1
    return -x * TURNS


@pytest.mark.parametrize(
    ("force", "rule"),
    [
        (jv.Force(lambda t, x, v, p: -jnp.log(x)), "force: must be finite at all possible states"),
        (
            jv.Force(lambda t, x, v, p: jnp.stack([x, v])),
            r"force: must return one number of type float64 for scalar arguments; got .float64\[2\]",
        ),
        (jv.Force(lambda t, x, v, p: (x, v)), "force: must return one number"),
        (jv.Force(lambda t, x, v, p: [x]), r"force: must return one number .*; got 'list of float64\[\]'"),
        (jv.Force(lambda t, x, v, p: None), "force: must return one number .*; got 'nothing'"),
        (jv.Force(lambda t, x, v, p: x * 1j), r"force: must return one number .*; got 'complex128\[\]'"),
        (
            jv.Force(lambda t, x, v, p: -x if x > 0 else x),
            r"force: .* \(TracerBoolConversionError\): use jnp.where in place of if, and",
        ),
        (
            jv.Force(lambda t, x, v, p: float(x)),
            r"force: cannot be traced by JAX \(ConcretizationTypeError\): use jax.numpy",
        ),
        (jv.Force(lambda t, x, v, p: -np.sin(x)), r"force: .* \(TracerArrayConversionError\): use jax.numpy in place"),
        (
            jv.Force(lambda t, x, v, p: -x * p["stiffness"], {"damping": 0.1}),
            r"force: cannot be traced by JAX \(KeyError: 'stiffness'\): its numbers are damping; got '<lambda>'",
        ),
        (jv.Force(lambda t, x: -x), r"force: .* \(TypeError: .*\): it is called with \(t, x, v, numbers\)"),
        (
            jv.Force("van_der_pol", {"damping": 0.1}),
            "force.numbers: must be the parameters of van_der_pol: gain; got 'damping'",
        ),
        (
            jv.Force("polynomial", {"cx": 0.1, "damping": 0.1}),
            "force.numbers: must be the parameters of polynomial: c0, c1, c2, ...",
        ),
        (jv.Force(_python_state), "force: must be the same in each trace"),
        (jv.Force(lambda t, x, v, p: -x + jnp.cos(t)), "force: must repeat with the drive's period, 2.99199: "),
        (
            jv.Force("duff", {}),
            r"force.function: must be a function, or the name of a predefined one, perhaps duffing \(",
        ),
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
        jv.make_scene(2.0, OMEGA, restitution=R, walls=(-1.0, 1.0), force=force)


def test_beside_a_force_there_is_no_damping():
    force = jv.Force(spring, {"damping": DAMPING})
    with pytest.raises(jv.SceneError, match="damping: must not be given with a force"):
        jv.make_scene(2.0, OMEGA, 0.1, R, (-1.0, 1.0), force=force)
    with pytest.raises(jv.SceneError, match=r"damping: must be given, unless a force"):
        jv.make_scene(2.0, OMEGA, restitution=R, walls=(-1.0, 1.0))
    with pytest.raises(jv.SceneError, match=r"right.damping: must be given for a soft wall"):
        jv.make_scene(2.0, OMEGA, restitution=R, walls=(None, jv.Wall(1.0, stiffness=9.0)), force=force)
    scene = jv.make_scene(2.0, OMEGA, restitution=R, walls=(-1.0, 1.0), force=force)
    assert "damping" not in scene.names and scene.parameter("force.damping") == DAMPING
    assert scene.replace(**{"force.damping": 0.2}).parameter("force.damping") == 0.2
    with pytest.raises(
        jv.ArgumentError, match=r"force.dumping: is not a parameter of this scene, perhaps force.damping"
    ):
        scene.replace(**{"force.dumping": 0.2})
