"""Proofs that areas never grow: intervals against many digits, forces against samples, and branches without a proof."""

import operator

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest
from jax import lax
from mpmath import mp, mpf

import jaxvibro as jv
from jaxvibro.scene.force_operations import areas_never_grow
from jaxvibro.scene.interval_arithmetic import OPERATION_RULES, Interval

WALLS = (-1.0, 1.0)
STRIBECK = {"belt": 0.3, "low": 0.1, "high": 0.25, "slip": 0.8, "smooth": 0.4}
EXACT = {  # in many digits, where neither mpmath nor operator has the name
    "add_any": operator.add,
    "div": operator.truediv,
    "square": lambda a: a * a,
    "rsqrt": lambda a: 1 / mp.sqrt(a),
    "cbrt": lambda a: mp.sign(a) * mp.cbrt(abs(a)),
    "exp2": lambda a: mpf(2) ** a,
    "logistic": lambda a: 1 / (1 + mp.exp(-a)),
    "max": max,
    "min": min,
    "copy": lambda a: a,
    "convert_element_type": lambda a: a,
}
TWO = ["add", "add_any", "sub", "mul", "div", "pow", "max", "min", "gt", "ge", "lt", "le"]
POSITIVE = ["sqrt", "rsqrt", "log", "pow"]


def scene(function, numbers, walls=WALLS, **more):
    return jv.make_scene(1.0, 2.0, restitution=0.7, walls=walls, force=jv.Force(function, numbers, **more))


@pytest.mark.parametrize("name", sorted(set(OPERATION_RULES) - {"select_n", "integer_pow"}))
def test_each_operation_stays_in_its_interval(name):
    rng, count = np.random.default_rng(3), 40
    exact = EXACT.get(name) or getattr(mp, name, None) or getattr(operator, name)
    given, inside = [], []
    for _ in range(2 if name in TWO else 1):
        ends = rng.normal(size=(2, count)) * 10.0 ** rng.uniform(-3, 0.8, count)
        ends[:, :4] = [[-1, 0, 0, -1], [0, 0, 1, 1]]
        ends = abs(ends) if name in POSITIVE else np.maximum(ends, -0.9) if name == "log1p" else ends
        low, high = np.sort(ends, axis=0)
        given.append(Interval(low, high))
        inside.append([low, high, *(low + (high - low) * share for share in rng.uniform(size=(4, count)))])
    found = OPERATION_RULES[name](*given)
    assert np.isfinite(np.asarray(found.upper)).sum() > count / 3 and (found.lower <= found.upper).all()
    with mpmath.workdps(40):
        for lane in range(count):
            for places in zip(*inside, strict=True):
                at = [mpf(float(np.clip(p[lane], *(e[lane] for e in g)))) for p, g in zip(places, given, strict=True)]
                if (name in ("div", "rsqrt") and at[-1] == 0) or (name in ("log", "pow") and at[0] == 0):
                    continue
                if name in ("gt", "ge", "lt", "le") and at[0] == at[1]:
                    continue
                assert mpf(float(found.lower[lane])) <= exact(*at) <= mpf(float(found.upper[lane]))


@pytest.mark.parametrize("power", [-3, -2, 0, 1, 2, 3, 5])
def test_whole_powers_stay_in_their_intervals(power):
    low, high = np.array([-2.0, -1.5, 0.0, 0.3, -1.0]), np.array([-0.1, 0.7, 0.0, 2.0, 1.0])
    given = Interval(low, high)
    for found in (
        OPERATION_RULES["integer_pow"](given, y=power),
        OPERATION_RULES["pow"](given, Interval(power, power)),
    ):
        for share in (0.0, 0.3, 0.9, 1.0):
            for lane, at in enumerate(np.clip(low + (high - low) * share, low, high)):
                if at or power > 0:
                    lowest, highest = (float(np.broadcast_to(end, 5)[lane]) for end in found)
                    assert mpf(lowest) <= mpf(at) ** power <= mpf(highest)


def test_intervals_without_bound():
    entire, rules = Interval(-np.inf, np.inf), OPERATION_RULES
    assert rules["mul"](Interval(0.0, np.inf), Interval(-1.0, np.inf)) == (-np.inf, np.inf)
    assert rules["mul"](entire, Interval(0.0, 0.0)) == (0.0, 0.0)
    assert rules["div"](Interval(1.0, 1.0), Interval(-1.0, 1.0)) == (-np.inf, np.inf)
    assert rules["exp"](entire) == (0.0, np.inf) and rules["tanh"](entire) == (-1.0, 1.0)
    assert rules["exp"](Interval(900.0, 901.0)).lower < np.inf  # no real number is as large as infinity
    assert rules["mul"](Interval(1e-300, 1.0), Interval(1e-300, 1.0)).lower <= 1e-300 * 1e-300 == 0.0
    assert rules["exp"](Interval(-901.0, -900.0)).upper > 0.0
    assert rules["atan"](entire).upper > mp.pi / 2 and rules["sin"](entire) == (-1.0, 1.0)


def _squared(u):
    return u * u


PROVED = {
    "-v |v|": (lambda t, x, v, p: -x - p["c"] * jnp.abs(v) * v, WALLS),
    "-v root": (lambda t, x, v, p: -x - p["c"] * v * jnp.sqrt(v * v + 1e-3), WALLS),
    "-tanh v": (lambda t, x, v, p: -x - p["c"] * jnp.tanh(v / 0.3), WALLS),
    "-atan v": (lambda t, x, v, p: -x - p["c"] * jnp.arctan(v / 0.3), (None, None)),
    "by x and t": (lambda t, x, v, p: -x - (0.1 + p["c"] * x**2) * v * (1.0 + 0.5 * jnp.cos(4.0 * t)), (None, 1.0)),
    "by a square": (lambda t, x, v, p: -x - p["c"] * _squared(x - 0.3) * v, WALLS),
    "jump in x": (lambda t, x, v, p: jnp.where(x > 0.3, -x, -2.0 * x) - p["c"] * jnp.where(x > 0.2, v, 2.0 * v), WALLS),
    "bend in v": (lambda t, x, v, p: -x - p["c"] * jnp.maximum(v, 2.0 * v), WALLS),
    "loop in x": (lambda t, x, v, p: -lax.fori_loop(0, 3, lambda k, a: 0.5 * a, x) - p["c"] * v, WALLS),
}
NOT_PROVED = {
    "jump in v": (lambda t, x, v, p: -x + p["c"] * jnp.sign(v), WALLS),
    "which by v": (lambda t, x, v, p: -x - p["c"] * jnp.where(v > 0.2, v, 2.0 * v), WALLS),
    "held": (lambda t, x, v, p: -x + p["c"] * lax.stop_gradient(v), WALLS),
    "feeds a little": (lambda t, x, v, p: -x - v**3 + 1e-3 * p["c"] * v, WALLS),
    "feeds far off": (lambda t, x, v, p: -x - p["c"] * v * (9.0 - x**2), (-3.0, 3.0 + 1e-9)),
    "by a loop": (lambda t, x, v, p: -x - p["c"] * lax.fori_loop(0, 3, lambda k, a: 0.5 * a, v), WALLS),
}


@pytest.mark.parametrize("name", [*PROVED, *NOT_PROVED])
def test_forces_with_and_without_a_proof(name):
    function, walls = (PROVED | NOT_PROVED)[name]
    assert scene(function, {"c": 0.1}, walls).dissipative is (True if name in PROVED else None)


def test_the_spring_and_the_predefined_forces():
    assert jv.make_scene(1.0, 2.0, 0.05, 0.7, WALLS).dissipative is True
    assert jv.make_scene(1.0, 2.0, 0.0, 1.0, (-1.0, jv.Wall(1.0, stiffness=9.0, damping=0.1))).dissipative is True
    for name, numbers in (("duffing", {"cubic": 0.5}), ("pendulum", {}), ("polynomial", {"c0": 0.1, "c3": 1.0})):
        for damping, expected in ((0.05, True), (0.0, True), (-1e-9, None)):
            assert scene(name, numbers | {"damping": damping}).dissipative is expected
    assert scene("stribeck", STRIBECK).dissipative is None
    assert scene("stribeck", STRIBECK | {"high": 0.1}).dissipative is True


def test_the_walls_decide_for_van_der_pol():
    moving = jv.Wall(1.3, motion=jv.Motion(0.4)), 3.0
    for gain, walls, expected in (
        (0.3, WALLS, None),
        (-0.3, WALLS, True),
        (-0.3, (-1.0, np.nextafter(1.0, 2.0)), None),
        (0.3, (1.0, 2.0), True),
        (0.3, (None, -1.2), True),
        (0.3, (1.3, 3.0), True),
        (0.3, moving, None),
    ):
        assert scene("van_der_pol", {"gain": gain}, walls).dissipative is expected


def test_a_batch_has_one_answer():
    gains, left, right = np.array([-0.3, 0.3]), np.array([-1.0, 1.1]), np.array([1.0, 2.0])
    assert scene("van_der_pol", {"gain": gains}, (left, right)).dissipative is True
    assert scene("van_der_pol", {"gain": gains[::-1]}, (left, right)).dissipative is None
    assert scene("duffing", {"cubic": 0.5, "damping": np.append(np.ones(9000), -1.0)}).dissipative is None
    assert jax.jit(lambda d: scene("pendulum", {"damping": d}).dissipative is None)(0.1)


def test_a_proof_along_a_branch_holds_between_its_ends():
    force = jv.Force(lambda t, x, v, p: -x - (p["k"] ** 2 - 0.01) * v, {"k": 1.0})
    scene = jv.make_scene(1.0, 2.0, restitution=0.7, walls=WALLS, force=force)
    negative = scene.replace(**{"force.k": -1.0})
    assert scene.dissipative is True and negative.dissipative is True and areas_never_grow(negative, scene) is None
    assert areas_never_grow(scene, scene.replace(**{"force.k": 0.2})) is True


def test_proofs_hold_for_samples():
    """Random polynomials of x and v: where the proof says so, the derivative is nowhere positive."""
    rng, proved, grows = np.random.default_rng(5), 0, 0
    x, v = rng.uniform(-1, 1, 4000), rng.standard_cauchy(4000)

    def force(t, x, v, p):
        return -x - v * (p["a"] + p["b"] * x + p["c"] * x * x) - p["d"] * v**3 - p["e"] * jnp.tanh(v)

    numbers = {name: rng.uniform(-0.4, 1.0, 60) for name in "abcde"}
    for k in range(60):
        a, b, c, d, e = (numbers[name][k] for name in "abcde")
        expected = scene(force, dict(zip("abcde", (a, b, c, d, e), strict=True))).dissipative
        most = (-(a + b * x + c * x * x) - 3 * d * v * v - e / np.cosh(np.minimum(abs(v), 300.0)) ** 2).max()
        assert most <= 0 or expected is None
        proved, grows = proved + (expected is True), grows + (most > 0)
    assert proved > 8 and proved + grows > 55  # there is hardly one of which nothing is known


def test_conserved_areas_have_no_special_points_of_rounding():
    """A motion that is its own image in reversed time has the determinant 1, whatever the force feeds and takes."""
    force = jv.Force(lambda t, x, v, p: -x - p["c"] * x * v, {"c": 0.2})
    own = jv.make_scene(0.3, 2.1, restitution=1.0, walls=(-2.0, 2.0), force=force)
    orbit = jv.find_orbit(own, jv.State(-0.09, 0.0), periods=1, settle=0)
    branch = jv.follow(orbit, "amplitude", (0.1, 1.0))
    products = np.prod(branch.multipliers, axis=1).real - 1.0
    assert own.dissipative is None and (np.diff(np.sign(products)) != 0).any() and abs(products).max() < 1e-11
    assert [one.kind for one in branch.special] == ["EP", "EP"]
