"""Functions evaluated in NumPy, their stored programs, and packed calls; random functions are in the properties."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

import continuation as co
import jaxvibro as jv
from continuation.jaxpr_to_python import build_program, compile_program_text, load_program
from continuation.numpy_evaluation import NumpyEvaluator
from continuation.numpy_gather_scatter import NoRuleError
from continuation.persistent_jit import compile_numpy_functions, persistent_jit
from continuation.python_literals import literal_text
from jaxvibro.branches.branch import scene_at_value

EVALUATION = "continuation.numpy_evaluation"
rng = np.random.default_rng(0)
ROW, OTHER = rng.normal(size=(2, 6))
TABLE, CUBE = rng.normal(size=(6, 4)), rng.normal(size=(3, 6, 4))
PLACES, FAR = np.array([4, 0, 2, 2]), np.array([[5, 1], [-9, 3], [2, 40]])
SQUARE = rng.normal(size=(4, 4))


def chosen(k, x):
    return lax.switch(k, [jnp.sin, jnp.cos, lambda x: 2.0 * x], x)


# structures that the random programs of the properties lack
CASES = {
    "where": (
        lambda a, x, y: (jnp.where(a, x, y), jnp.where(a[0], x, y), lax.select_n(PLACES[:1] % 3, *[x[:1]] * 3)),
        ROW > 0,
        ROW,
        OTHER,
    ),
    "shapes": (lambda x: (x.reshape(4, 6), x[2:5:2, ::-1], x.T, x[:, None], jnp.squeeze(x[:1]), x.ravel()[3]), TABLE),
    "lanes of products": (lambda c: jax.vmap(lambda x: x.T @ x)(c), CUBE),
    "one taken": (lambda x, k: (x[k], x[:, k % 4], x[k, k % 4], x[k[0]], x[k[0], k[1]]), TABLE, PLACES),
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
def test_structures_give_what_the_compiler_gives(name, kind):
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


@pytest.mark.parametrize(
    ("function", "given"),
    [(jnp.linalg.eigh, SQUARE + SQUARE.T), (lambda x: lax.reduce_precision(x, 5, 10), ROW), (jnp.sin, "other JAX")],
)
def test_what_has_no_rule_or_is_traced_otherwise_by_another_jax_is_compiled(function, given, monkeypatch):
    def otherwise(closed):
        raise KeyError("num_consts")

    if isinstance(given, str):
        monkeypatch.setattr(f"{EVALUATION}.build_program", otherwise)
        given = ROW
    evaluator = NumpyEvaluator(function, (), {})
    assert evaluator((given,)) is None and list(evaluator.evaluation_by_signature.values()) == [None]


def text_of(function, given):
    return build_program(jax.jit(function).trace(given).jaxpr).text


def test_programs_hold_neither_unused_results_nor_rules_twice():
    def wasted(x):
        return lax.fori_loop(0, 3, lambda _, x: (x + 1.0, jnp.sin(x) * jnp.arange(100.0))[0], x)

    def plain(x):
        return lax.fori_loop(0, 3, lambda _, x: x + 1.0, x)

    def twice(x):
        return jnp.concatenate([lax.slice(x, (1,), (20,)), lax.slice(x * 2.0, (1,), (20,))])

    assert text_of(wasted, 1.0) == text_of(plain, 1.0)
    assert text_of(twice, np.arange(30.0)).count("rules['slice']") == 1


def test_it_is_compiled_once_it_has_cost_as_much(monkeypatch):
    monkeypatch.setattr(f"{EVALUATION}.MAX_EVALUATIONS", 3)
    tried = NumpyEvaluator(lambda x, k: x * k + 1.0, (1,), {})
    assert [tried((ROW, 2)) is None for _ in range(5)] == [False] * 3 + [True] * 2
    assert tried((ROW, 3)) is not None and tried((ROW[:2], 2)) is not None  # of another kind


class Pair(NamedTuple):
    first: np.ndarray
    second: np.ndarray


@persistent_jit(static_argnums=1, numpy_first=True)
def turned(pair, times, by):
    return Pair(jnp.roll(pair.second, times), by * pair.first)


def test_what_was_evaluated_is_compiled_when_there_is_time(monkeypatch):
    monkeypatch.setattr("continuation.persistent_jit._pending", [])
    pair = Pair(np.arange(13.0), np.ones(13))
    turned(pair, 1, 2.0)
    turned(pair, 1, 3.0)
    assert list(compile_numpy_functions()) == [0]  # of two calls one kind
    monkeypatch.setattr(NumpyEvaluator, "evaluate", None)
    np.testing.assert_array_equal(turned(pair, 1, 3.0).second, 3.0 * np.arange(13.0))


def constant(text):
    """The value of a literal in a program that is read."""
    return load_program(compile_program_text(f"size = 1\ndef run():\n    return [{text}], 1")).run()[0][0]


def test_a_program_without_text_is_run_but_not_stored(monkeypatch):
    class Odd(int):
        pass

    with pytest.raises(NoRuleError):
        literal_text((1, Odd(2)))
    with pytest.raises(NoRuleError):
        literal_text(np.array([1j]))

    def refused(value):
        raise NoRuleError(value)

    monkeypatch.setattr("continuation.jaxpr_to_python.literal_text", refused)
    program = build_program(jax.jit(lambda x: jnp.asarray(TABLE).T @ x).trace(ROW).jaxpr)
    assert program.text is None
    np.testing.assert_allclose(program.run(ROW)[0][0], TABLE.T @ ROW, rtol=1e-14)


@pytest.mark.parametrize(
    "value",
    (
        np.array([[0.1, -0.0, np.nan], [np.inf, 5e-324, -np.inf]]),
        np.zeros((0, 3), np.int32),
        np.float32(0.1),
        np.array([True, False]),
        (1, (None, "a'b"), 2.5),
        lax.GatherDimensionNumbers((0,), (1,), (0,), (), ()),
        lax.GatherScatterMode.CLIP,
        np.dtype(bool),
    ),
)
def test_a_literal_is_its_value(value):
    found = constant(literal_text(value))
    assert type(found) is type(value)
    if isinstance(value, np.ndarray | np.generic):
        assert found.dtype == value.dtype and found.shape == value.shape and found.tobytes() == value.tobytes()
    else:
        assert found == value


MIXED = [
    rng.normal(size=(3, 2)),
    np.float64(0.25),
    np.int32(7),
    np.arange(4),
    np.zeros((0, 3)),
    np.array([True, False]),
    np.float32(1.5),
    rng.normal(size=5),
    jnp.linspace(0.0, 1.0, 3),
    3,
]


def everything(table, share, count, places, none, mask, single, row, more, weak):
    return {"sum": table.sum() * share + count, "rest": (places[mask.sum()] * weak, none, ~mask, None)}, row[::-1], more


def test_a_compiled_call_of_many_types_is_that_of_jit(monkeypatch):
    monkeypatch.setattr(f"{EVALUATION}.MAX_EVALUATIONS", 0)
    found = persistent_jit(everything, numpy_first=True)(*MIXED)
    expected = jax.jit(everything)(*MIXED)
    assert jax.tree.structure(found) == jax.tree.structure(expected)
    for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        assert isinstance(one, np.ndarray) and (one.shape, one.dtype) == (other.shape, other.dtype)
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("patience", [np.inf, 0])
def test_calls_of_other_kinds_are_told_apart(patience, monkeypatch):
    """Of another length, type, static argument or form; with a number of the host's own; and under transformations."""
    monkeypatch.setattr(f"{EVALUATION}.MAX_EVALUATIONS", patience)
    for size, kind in ((3, float), (5, float), (3, np.float32), (3, np.int32)):
        one, two = np.arange(size).astype(kind), np.ones(size, kind)
        for times in (1, 2):
            for by in (2, np.int32(2), np.array([2] * size, np.int32)):
                found = turned(Pair(one, two + one), times, by)
                np.testing.assert_array_equal(found.first, np.roll(two + one, times))
                np.testing.assert_array_equal(found.second, 2 * one)
                assert found.second.dtype == jnp.asarray(by * jnp.asarray(one)).dtype
    slope = jax.grad(lambda x: turned(Pair(x * np.ones(3), np.ones(3)), 1, 2.0).second.sum())(1.0)
    assert slope == 6.0


def test_complex_constants_and_arguments():
    def move(u, p, args):
        return 0.5 * u + p["a"] * (jnp.asarray([1.0 + 2.0j, 0.5j]) * args / jnp.asarray([2.0 - 1.0j, 1.0 + 1.0j])).real

    system, quotient = co.fixed_points(move), np.array([(1.0 + 2.0j) / (2.0 - 1.0j), 0.5j / (1.0 + 1.0j)])
    branches = [
        co.trace(system, [0.0, 0.2], {"a": 0.4}, "a", (0.0, 1.0), args=kind(0.5 + 1.0j))
        for kind in (complex, np.complex128)
    ]
    expected = 2.0 * branches[0].p["a"][:, None] * (quotient * (0.5 + 1.0j)).real
    np.testing.assert_allclose(branches[0].u, expected, atol=1e-9)
    np.testing.assert_array_equal(branches[0].u, branches[1].u)
    with pytest.raises(co.ContinuationError, match="args: must be numbers and arrays"):
        co.trace(system, [0.0, 0.2], {"a": 0.4}, "a", (0.0, 1.0), args="x")


def study(scene, start):
    """Return what the README computes of a scene, as text and as numbers."""
    orbit = jv.find_orbit(scene, start)
    branch = jv.follow(orbit, "amplitude", (0.05 * float(scene.amplitude), 2.0 * float(scene.amplitude)))
    locus = jv.locus(
        branch.points("SN")[0], ("amplitude", "frequency"), {"amplitude": (0.1, 9.0), "frequency": (1.8, 2.4)}
    )
    special = [(one.kind, one.orbit.label) for one in branch.special]
    numbers = [(one.value, one.orbit.state.x, one.orbit.state.v) for one in branch.special]
    return (branch.table(), special, str(locus)), np.ravel(numbers)


def state_of_orbit(scene, start):
    """Return an orbit that is found by its state: one whose impact leaves no speed, or one that meets no wall."""
    orbit = jv.find_orbit(scene, start)
    assert orbit.unknowns == "state"
    numbers = [orbit.state.x, orbit.state.v, orbit.least_clearance, *orbit.multipliers, *orbit.impacts.time]
    return (orbit.rests, orbit.itinerary, orbit.label), np.array(numbers)


@pytest.mark.parametrize(
    ("compute", "restitution", "walls", "start"),
    [
        (study, 0.7, (-0.8, 1.1), (0.69, 1.8)),
        (state_of_orbit, 0.0, (-0.1, None), (0.9, -1.1)),
        (state_of_orbit, 0.7, (-1.0, None), (0.0, 0.1)),
    ],
    ids=["study", "no speed", "no wall"],
)
def test_results_in_numpy_are_those_of_the_compiled_functions(compute, restitution, walls, start, monkeypatch):
    programs, trace = [], NumpyEvaluator.trace_function
    monkeypatch.setattr(
        NumpyEvaluator, "trace_function", lambda self, args: programs.append(trace(self, args)) or programs[-1]
    )
    scene, results = jv.make_scene(2.0, 2.1, 0.05 if compute is study else 0.2, restitution, walls), []
    for evaluations in (np.inf, 0):
        monkeypatch.setattr(f"{EVALUATION}.MAX_EVALUATIONS", evaluations)
        results.append(compute(scene, jv.State(*start)))
    assert all(program is not None for program in programs)
    (said, numbers), (expected, others) = results
    assert said == expected
    np.testing.assert_allclose(numbers, others, rtol=1e-12, atol=1e-12)


def test_the_scene_on_a_branch_is_the_one_with_another_value():
    """It is made without JAX."""
    moving = jv.Wall(-1.0, motion=jv.Motion(0.1, 0.5, 2)), jv.Wall(1.2, restitution=0.6)
    soft = jv.Wall(-1.0, stiffness=300.0, damping=2.0), None
    for scene in (jv.make_scene(2.0, 2.1, 0.05, 0.7, moving), jv.make_scene(2.0, 1.7, 0.1, 0.7, soft)):
        for name in scene.names:
            value = 1.07 * float(scene.parameter(name)) if name != "restitution" else 0.4
            found, expected = scene_at_value(scene, name, value), scene.replace(**{name: value})
            assert found.names == expected.names and type(found.amplitude) is type(expected.amplitude)
            for one, other in ((found.parameter(each), expected.parameter(each)) for each in expected.names):
                assert one.dtype == other.dtype and float(one) == float(other)
            assert type(found.parameter(name)) is type(expected.parameter(name))
