"""What is evaluated in NumPy is what is compiled: each rule, each function that is so tried, and what comes of them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

import jaxvibro as jv
from continuation import numpy_evaluation, persistent_jit
from continuation.jaxpr_to_python import build_program
from continuation.numpy_evaluation import NumpyEvaluator
from jaxvibro.flight.wall_positions import wall_states

rng = np.random.default_rng(0)
ROW, OTHER = rng.normal(size=(2, 6))
TABLE, CUBE = rng.normal(size=(6, 4)), rng.normal(size=(3, 6, 4))
PLACES, FAR = np.array([4, 0, 2, 2]), np.array([[5, 1], [-9, 3], [2, 40]])
SQUARE = rng.normal(size=(4, 4))
YES = ROW > 0


def halved(x):
    return lax.while_loop(lambda c: c[0] > 1e-3, lambda c: (0.5 * c[0], c[1] + 1), (jnp.abs(x), 0))


def summed(reverse):
    def run(x, y):
        return lax.scan(lambda c, row: (c + row[0] * row[1], c * row[1]), 0.5, (x, y), reverse=reverse)

    return run


def chosen(k, x):
    return lax.switch(k, [jnp.sin, jnp.cos, lambda x: 2.0 * x], x)


def sorted_by(x, y):
    return lax.sort((jnp.round(x), y, jnp.arange(6)), num_keys=2)


CASES = {
    "arithmetic": (
        lambda x, y: ((x + y) * x - y / x, -x, x**3, x**-2, x**0, jnp.abs(x) ** y, x // y, x % y),
        ROW,
        OTHER,
    ),
    "functions": (lambda x: [f(jnp.abs(x)) for f in (jnp.exp, jnp.log, jnp.sin, jnp.sqrt, jnp.exp2, jnp.expm1)], ROW),
    "hyperbolic": (lambda x: [f(x) for f in (jnp.sinh, jnp.cosh, jnp.tanh, jnp.cos, jnp.sign, lax.rsqrt)], abs(ROW)),
    "rounding": (lambda x: [f(3.0 * x) for f in (jnp.floor, jnp.ceil, jnp.round, lax.round)], ROW),
    "angles": (lambda x, y: (jnp.arctan2(x, y), jnp.log1p(jnp.abs(x)), jnp.tan(x), jnp.square(x)), ROW, OTHER),
    "order": (lambda x, y: (x > y, x <= y, jnp.maximum(x, y), jnp.minimum(x, y), jnp.clip(x, -0.3, y)), ROW, OTHER),
    "neighbours": (lambda x, y: (jnp.nextafter(x, y), jnp.isfinite(x / 0.0)), ROW, OTHER),
    "logic": (lambda a, x: (a & (x > 0), a | (x > 0.5), ~a, a ^ (x > 0), ~jnp.arange(3)), YES, OTHER),
    "whole numbers": (lambda k: (k // 2, -k // 3, k % 3, k * k, lax.div(-k, 3), k.astype(jnp.float32)), PLACES),
    "bits": (
        lambda x, y: [
            lax.bitcast_convert_type(lax.bitcast_convert_type(each, whole) & ~whole(255), x.dtype)
            for each in (x, y[0], x[None] * y[:, None])
            for whole in [jnp.int64 if x.dtype == jnp.float64 else jnp.int32]
        ],
        ROW,
        OTHER,
    ),
    "where": (
        lambda a, x, y: (jnp.where(a, x, y), jnp.where(a[0], x, y), lax.select_n(PLACES[:1] % 3, *[x[:1]] * 3)),
        YES,
        ROW,
        OTHER,
    ),
    "shapes": (lambda x: (x.reshape(4, 6), x[2:5:2, ::-1], x.T, x[:, None], jnp.squeeze(x[:1]), x.ravel()[3]), TABLE),
    "joined": (
        lambda x, y: (jnp.concatenate([x, y]), jnp.stack([x, y], 1), jnp.tile(x, 3), jnp.split(x, 3)),
        ROW,
        OTHER,
    ),
    "padded": (lambda x: (jnp.pad(x, 2), lax.pad(x, x[0], [(1, 2, 3)])), ROW),
    "sums": (
        lambda x: (x.sum(), x.prod(1), x.max(0), x.min(), (x > 0).all(0), (x > 0).any(), x.argmax(1), x.argmin(0)),
        TABLE,
    ),
    "running": (lambda x: (jnp.cumsum(x, 0), jnp.cumprod(x, 1), lax.cumsum(x, 0, reverse=True)), TABLE),
    "products": (
        lambda x, y, c: (x @ y, x.T @ x, jnp.einsum("kij,ij->k", c, x), jnp.einsum("kij,lij->kl", c, c), c @ y),
        TABLE,
        SQUARE,
        CUBE,
    ),
    "lanes of products": (lambda c: jax.vmap(lambda x: x.T @ x)(c), CUBE),
    "one taken": (lambda x, k: (x[k], x[:, k % 4], x[k, k % 4], x[k[0]], x[k[0], k[1]]), TABLE, PLACES),
    "beyond": (
        lambda x, k: (x.at[k].get(mode="fill"), x.at[k].get(mode="clip"), x.at[k].get(mode="fill", fill_value=3.0)),
        ROW,
        FAR,
    ),
    "lanes taken": (
        lambda x, k: (jax.vmap(lambda x, k: x[k])(x, k), jnp.take_along_axis(x, k[:, None], 1)),
        CUBE[:, :, 0],
        PLACES[:3],
    ),
    "put": (
        lambda x, k: (x.at[k].set(2.0), x.at[1:3].add(x[:2]), x.at[:, k].multiply(3.0), x.at[k[1], 2].set(0.5)),
        TABLE[:, :],
        PLACES[1:2],
    ),
    "put beyond": (lambda x, k: (x.at[k].set(1.5, mode="drop"), x.at[k].add(1.5, mode="clip")), ROW, FAR),
    "lanes put": (lambda x, k: jax.vmap(lambda x, k: x.at[k].add(1.0))(x, k), CUBE[:, :, 0], PLACES[:3]),
    "windows": (
        lambda x, k: (lax.dynamic_slice_in_dim(x, k[0], 4), lax.dynamic_update_slice_in_dim(x, x[:2], k[0], 0)),
        TABLE,
        PLACES,
    ),
    "lanes of windows": (lambda x, k: jax.vmap(lambda x, k: lax.dynamic_slice_in_dim(x, k, 4))(x, k), CUBE, PLACES[:3]),
    "loop": (halved, ROW[0]),
    "lanes of a loop": (jax.vmap(halved), 10.0 * ROW),
    "counted": (lambda x: lax.fori_loop(0, 5, lambda k, c: c.at[k].set(c[k - 1] + k), x), ROW),
    "scan": (summed(False), ROW, OTHER),
    "scan back": (summed(True), ROW, OTHER),
    "lanes of a scan": (jax.vmap(summed(False)), TABLE, TABLE),
    "branches": (lambda k, x: chosen(k[0], x), PLACES, ROW),
    "lanes of branches": (jax.vmap(chosen), PLACES, SQUARE),
    "sort": (sorted_by, ROW, OTHER),
    "slopes": (jax.jacfwd(lambda x: jnp.sum(jnp.where(x > 0, jnp.sin(x), x**2)) * x), ROW),
    "slopes back": (jax.grad(lambda x: jnp.sum(jnp.sort(x)[PLACES] ** 3) + jnp.max(x)), ROW),
    "few": (
        lambda x: ((x @ x.T).sum(), x.prod(), x.max(1), x.min(), x.argmax(), jnp.cumsum(x, 1), x.T[::-1], x[:1] @ x.T),
        ROW.reshape(2, 3),
    ),
    "few taken": (
        lambda x, k: (x[k], x[k[:1]], x.at[k].set(2.0), x[jnp.array([5, 0])], lax.dynamic_slice_in_dim(x, k[0], 2)),
        ROW,
        PLACES,
    ),
    "one of two": (
        lambda x, y, k, far: (
            x[:2].at[k % 2].get(mode="promise_in_bounds"),
            x[:2].at[far].get(mode="clip"),
            x.at[far].get(mode="clip"),
            y.at[:, k % 2].get(mode="promise_in_bounds"),
            jax.vmap(lambda x, k: x.at[k].get(mode="clip"))(y.T, far[:2]),
            lax.gather(y, far[:, :1], lax.GatherDimensionNumbers((1, 2), (), (1,)), (2, 1), mode="clip"),
        ),
        ROW,
        SQUARE[:2, :2],
        PLACES,
        FAR,
    ),
    "few beyond": (lambda x: (x.at[jnp.array([7, 1])].get(mode="fill"), x.at[jnp.array([7, 1])].get(mode="clip")), ROW),
    "what is no number": (
        lambda x, y: (
            [f(x) for f in (jnp.sqrt, jnp.log, jnp.exp, jnp.sin, jnp.cos, jnp.sign, jnp.isfinite, lax.rsqrt)],
            [f(x, y) for f in (jnp.maximum, jnp.minimum, lax.div, jnp.less, jnp.equal)],
            [x**-3, x.max(), x.min(), jnp.where(x > y, x, y), jnp.clip(x, -1.0, y), x[0] * y],
        ),
        np.array([np.nan, np.inf, -np.inf, 0.0, -2.0, 1.0, 800.0]),
        np.array([1.0, np.nan, 0.0, 0.0, 0.0, np.inf, -0.0]),
    ),
    "whole numbers beyond": (
        lambda k: (k + k, k * k, -k, k - 7, (k + k) > 0, k.astype(jnp.int64) + k, k.astype(bool), k * 1.5),
        np.array([2**31 - 1, -(2**31), 5], np.int32),
    ),
    "changed about": (lambda x: lax.fori_loop(0, 7, lambda _, c: (c[1], c[0] + c[2], c[2]), (x[0], x[1], 0.5)), ROW),
    "what no turn needs": (
        lambda x: lax.fori_loop(0, 9, lambda k, c: (c[0] * x[1], c[1] + c[0], k), (x[0], 0.0, 0))[1],
        ROW,
    ),
    "loop in a loop": (
        lambda x: lax.while_loop(
            lambda c: c.max() < 9.0, lambda c: lax.fori_loop(0, 3, lambda k, d: d * 1.1 + abs(x[:2]), c), x[:2] * 0.0
        ),
        ROW,
    ),
    "rows of few": (lambda x: lax.scan(lambda c, row: (c + row, (c[0], row > c)), x[0], x), TABLE[:, :2]),
    "branch that is known": (lambda x: [chosen(jnp.sum(jnp.arange(k)), x) for k in (2, 3, 7)], ROW),
    "windows beyond": (
        lambda x: lax.gather(
            x,
            jnp.array([[7], [1]]),
            lax.GatherDimensionNumbers((), (0,), (0,)),
            (1,),
            mode=lax.GatherScatterMode.FILL_OR_DROP,
        ),
        ROW,
    ),
    "numbers alone": (lambda x: (x * 2, x > 0, jnp.full(3, x), jnp.arange(4) * x), 0.5),
}


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("kind", [np.float64, np.float32])
def test_every_rule_gives_what_the_compiler_gives(name, kind):
    function, *given = CASES[name]
    given = [np.asarray(each, kind) if np.asarray(each).dtype.kind == "f" else each for each in given]
    tried = NumpyEvaluator(function, (), {})
    found = tried(tuple(given))
    assert found is not None, "no rule"
    expected = jax.jit(function)(*given)
    assert jax.tree.structure(found) == jax.tree.structure(expected)
    for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        assert (np.shape(one), np.asarray(one).dtype) == (other.shape, other.dtype)
        np.testing.assert_allclose(one, other, rtol=64 * np.finfo(kind).eps, atol=64 * np.finfo(kind).eps)


def test_what_has_no_rule_is_compiled():
    assert NumpyEvaluator(jnp.linalg.eigh, (), {})((SQUARE + SQUARE.T,)) is None
    assert NumpyEvaluator(lambda x: lax.reduce_precision(x, 5, 10), (), {})((ROW,)) is None


def test_what_another_version_of_jax_tells_otherwise_is_compiled(monkeypatch):
    def otherwise(closed):
        raise KeyError("num_consts")

    monkeypatch.setattr(numpy_evaluation, "build_program", otherwise)
    tried = NumpyEvaluator(lambda x: x + 1.0, (), {})
    assert tried((np.float64(1.0),)) is None and list(tried.evaluation_by_signature.values()) == [None]


def test_what_no_result_needs_is_not_written():
    def wasted(x):
        return lax.fori_loop(0, 3, lambda _, x: (x + 1.0, jnp.sin(x) * jnp.arange(100.0))[0], x)

    def plain(x):
        return lax.fori_loop(0, 3, lambda _, x: x + 1.0, x)

    written = [build_program(jax.jit(each).trace(1.0).jaxpr) for each in (wasted, plain)]
    assert written[0].text == written[1].text


def test_it_is_compiled_once_it_has_cost_as_much(monkeypatch):
    monkeypatch.setattr(numpy_evaluation, "MAX_EVALUATIONS", 3)
    tried = NumpyEvaluator(lambda x, k: x * k + 1.0, (1,), {})
    assert [tried((ROW, 2)) is None for _ in range(5)] == [False] * 3 + [True] * 2
    assert tried((ROW, 3)) is not None and tried((ROW[:2], 2)) is not None  # of another kind


def test_what_was_evaluated_is_compiled_when_there_is_time(monkeypatch):
    monkeypatch.setattr(persistent_jit, "_pending", [])
    scene, phase = jv.make_scene(1.0, 2.0, 0.1, 0.7, (jv.Wall(-1.0, motion=jv.Motion(0.2, 0.5, 2)), None)), np.ones(13)
    wall_states(scene, phase)
    before = wall_states(scene, phase)
    assert list(persistent_jit.compile_numpy_functions()) == [0]  # of two calls one kind
    monkeypatch.setattr(NumpyEvaluator, "evaluate", None)
    for one, other in zip(jax.tree.leaves(wall_states(scene, phase)), jax.tree.leaves(before), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-14)
    np.testing.assert_allclose(before[0][0], -1.0 + 0.2 * np.cos(2.5), rtol=1e-14)


def told(scene, start):
    """What the README asks of a scene, as text and as numbers."""
    orbit = jv.find_orbit(scene, start)
    branch = jv.follow(orbit, "amplitude", (0.05 * float(scene.amplitude), 2.0 * float(scene.amplitude)))
    sn = branch.points("SN")[0]
    locus = jv.locus(sn, ("amplitude", "frequency"), {"amplitude": (0.1, 9.0), "frequency": (1.8, 2.4)})
    special = [(one.kind, one.orbit.label) for one in branch.special]
    numbers = [np.ravel([one.value, one.orbit.state.x, one.orbit.state.v]) for one in branch.special]
    return branch.table(), special, np.array(numbers), str(locus)


@pytest.mark.parametrize("walls", [(-1.0, 1.0), (-0.8, 1.1)])
def test_both_ways_come_to_the_same_points_and_text(walls, monkeypatch):
    scene, start = jv.make_scene(2.0, 2.1, 0.05, 0.7, walls), jv.State(0.69, 1.8)
    ruled = []
    traced = NumpyEvaluator.trace_function
    monkeypatch.setattr(
        NumpyEvaluator, "trace_function", lambda self, args: ruled.append(traced(self, args)) or ruled[-1]
    )
    found = []
    for patience in (np.inf, 0):
        monkeypatch.setattr(numpy_evaluation, "MAX_EVALUATIONS", patience)
        found.append(told(scene, start))
    assert all(each is not None for each in ruled)
    (table, special, numbers, locus), (other_table, other_special, others, other_locus) = found
    assert table == other_table and special == other_special and locus == other_locus
    assert "SN" in dict(special)
    np.testing.assert_allclose(numbers, others, rtol=1e-13, atol=1e-13)


@pytest.mark.parametrize("restitution, start", [(0.0, (0.9, -1.1)), (0.7, (0.0, 0.1))])
def test_orbits_by_their_state_are_the_same_both_ways(restitution, start, monkeypatch):
    """One whose impact leaves no speed, and one that meets no wall."""
    scene = jv.make_scene(2.0, 2.1, 0.2, restitution, (-1.0 if restitution else -0.1, None))
    found = []
    for patience in (np.inf, 0):
        monkeypatch.setattr(numpy_evaluation, "MAX_EVALUATIONS", patience)
        found.append(jv.find_orbit(scene, jv.State(*start)))
    one, other = found
    assert one.unknowns == other.unknowns == "state" and one.rests == other.rests
    assert one.itinerary == other.itinerary and one.label == other.label
    numbers = [[each.state.x, each.state.v, each.least_clearance, *each.multipliers] for each in found]
    np.testing.assert_allclose(*numbers, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(one.impacts.time, other.impacts.time, rtol=1e-12, atol=1e-12)
