"""Functions evaluated in NumPy, their stored programs, and packed calls; random functions are in the properties."""

import marshal
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

import continuation as co
import jaxvibro as jv
from continuation.hostcall import CompilationQueue, compile_at_once, fallback_counts, persistent_jit
from continuation.hostcall.host_jit import PackedCall
from continuation.hostcall.program_writer import ProgramWriter, literal_text, load_program
from continuation.hostcall.rules import RULES, NoRuleError, make_rule
from jaxvibro.branches.branch import scene_at_value
from jaxvibro.orbits.orbit_from_impacts import padded_sequence, solve_guess
from jaxvibro.orbits.shooting import _strobe_period_compiled
from jaxvibro.scene.state import make_state_arrays

from .cached_functions import host_function, in_numpy

EVALUATION = "continuation.hostcall.host_jit"
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
    found = in_numpy(function, *given)
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
    before = fallback_counts()
    assert in_numpy(function, given) is None
    ((name, reason),) = {key for key, count in fallback_counts().items() if count > before.get(key, 0)}
    assert name == function.__qualname__
    assert any(
        word in reason for word in ("KeyError: 'num_consts'", "NoRuleError: eigh", "NoRuleError: reduce_precision")
    )


def test_an_operand_that_a_rule_refuses_leads_to_the_compiled_function():
    def halves(x):
        return lax.bitcast_convert_type(x, np.float32)

    call, before = host_function(halves), fallback_counts()
    for _ in range(2):
        np.testing.assert_array_equal(call(np.arange(30.0)), np.arange(30.0).view(np.float32).reshape(30, 2))
    added = {key: count for key, count in fallback_counts().items() if key not in before}
    assert added == {(halves.__qualname__, "NoRuleError: bitcast_convert_type between widths"): 1}


class CompiledAtOnce(NamedTuple):
    compile_at_once: bool = True


def test_a_function_that_its_caller_wants_compiled_is_no_fallback():
    def scaled(problem, x):
        return (2.0 + problem.compile_at_once) * x

    call, before = persistent_jit(numpy_first=True, static_argnums=0)(scaled), fallback_counts()
    np.testing.assert_array_equal(call(CompiledAtOnce(), ROW), 3.0 * ROW)
    assert fallback_counts() == before


def test_what_is_compiled_at_once_stays_compiled():
    def doubled(x):
        return 2.0 * x

    call = host_function(doubled)
    with compile_at_once():
        call(3.0)
    np.testing.assert_array_equal(call(4.0), 8.0)
    (signature_call,) = call.signature_calls.values()
    assert signature_call.program is None and signature_call.n_lines_run == 0


def test_the_table_of_rules_refuses_parameters_that_it_does_not_know():
    assert len(RULES) > 80
    assert make_rule("sin", {"accuracy": None})(0.5) == np.sin(0.5)
    with pytest.raises(NoRuleError, match=r"sin: .*accuracy"):
        make_rule("sin", {"accuracy": "high"})
    with pytest.raises(NoRuleError, match="no_such_primitive"):
        make_rule("no_such_primitive", {})


def text_of(function, given):
    return ProgramWriter(jax.jit(function).trace(given).jaxpr).text


def test_programs_hold_neither_unused_results_nor_rules_twice():
    def wasted(x):
        return lax.fori_loop(0, 3, lambda _, x: (x + 1.0, jnp.sin(x) * jnp.arange(100.0))[0], x)

    def plain(x):
        return lax.fori_loop(0, 3, lambda _, x: x + 1.0, x)

    def twice(x):
        return jnp.concatenate([lax.slice(x, (1,), (20,)), lax.slice(x * 2.0, (1,), (20,))])

    assert text_of(wasted, 1.0) == text_of(plain, 1.0)
    assert text_of(twice, np.arange(30.0)).count("RULES['slice']") == 1


def test_it_is_compiled_once_it_has_cost_as_much(monkeypatch):
    monkeypatch.setattr(f"{EVALUATION}.max_evaluations", 3)
    monkeypatch.setattr(PackedCall, "__call__", lambda self, leaves: None)
    tried = host_function(lambda x, k: x * k + 1.0, static=(1,))
    assert [tried(ROW, 2) is None for _ in range(5)] == [False] * 3 + [True] * 2
    assert tried(ROW, 3) is not None and tried(ROW[:2], 2) is not None  # of another kind


class Pair(NamedTuple):
    first: np.ndarray
    second: np.ndarray


@persistent_jit(static_argnums=1, numpy_first=True)
def turned(pair, times, by):
    return Pair(jnp.roll(pair.second, times), by * pair.first)


def test_what_was_evaluated_is_compiled_when_there_is_time():
    pair = Pair(np.arange(13.0), np.ones(13))
    turned(pair, 1, 2.0)
    with CompilationQueue() as waiting, CompilationQueue() as others:
        turned(pair, 1, 2.0)
        turned(pair, 1, 3.0)
    turned(Pair(np.arange(14.0), np.ones(14)), 1, 2.0)  # when no queue is open
    (call,) = waiting.leaves_by_call  # of two calls one kind
    assert others.leaves_by_call.keys() == {call} and call.program is not None
    assert waiting.compile_next() and not waiting.compile_next()
    assert call.program is None
    np.testing.assert_array_equal(turned(pair, 1, 3.0).second, 3.0 * np.arange(13.0))


def constant(text):
    """The value of a literal in a program that is read."""
    code = compile(f"size = 1\ndef run():\n    return [{text}], 1", "<program>", "exec")
    return load_program(marshal.dumps(code)).run()[0][0]


def test_a_function_whose_constants_have_no_text_is_compiled(monkeypatch):
    class Odd(int):
        pass

    with pytest.raises(NoRuleError):
        literal_text((1, Odd(2)))

    def refused(value):
        raise NoRuleError("no text")

    assert in_numpy(lambda x: jnp.asarray(TABLE).T @ x, ROW) is not None
    monkeypatch.setattr("continuation.hostcall.program_writer.literal_text", refused)
    assert in_numpy(lambda x: jnp.asarray(TABLE).T @ x, ROW) is None


@pytest.mark.parametrize(
    "value",
    (
        np.array([[0.1, -0.0, np.nan], [np.inf, 5e-324, -np.inf]]),
        np.zeros((0, 3), np.int32),
        np.array([complex(-0.0, np.nan), 1j]),
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
        assert isinstance(found, np.generic) or found.flags.writeable
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
    monkeypatch.setattr(f"{EVALUATION}.max_evaluations", 0)
    found = persistent_jit(numpy_first=True)(everything)(*MIXED)
    expected = jax.jit(everything)(*MIXED)
    assert jax.tree.structure(found) == jax.tree.structure(expected)
    for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        assert isinstance(one, np.ndarray) and (one.shape, one.dtype) == (other.shape, other.dtype)
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("patience", [np.inf, 0])
def test_calls_of_other_kinds_are_told_apart(patience, monkeypatch):
    """Of another length, type, static argument or form; with a number of the host's own; and under transformations."""
    monkeypatch.setattr(f"{EVALUATION}.max_evaluations", patience)
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
    before = fallback_counts()
    scene, results = jv.make_scene(2.0, 2.1, 0.05 if compute is study else 0.2, restitution, walls), []
    for evaluations in (np.inf, 0):
        monkeypatch.setattr(f"{EVALUATION}.max_evaluations", evaluations)
        results.append(compute(scene, jv.State(*start)))
    assert fallback_counts() == before
    (said, numbers), (expected, others) = results
    assert said == expected
    np.testing.assert_allclose(numbers, others, rtol=1e-12, atol=1e-12)


SOFT = {"stiffness": 300.0, "damping": 2.0}
SOFT_WALLS = jv.Wall(-1.0, **SOFT), jv.Wall(1.0, **SOFT, motion=jv.Motion(0.1, 0.5, 2))
CONTACT_LAW = jv.Push("hunt_crossley", {"stiffness": 300.0, "dissipation": 0.5})
DUFFING = jv.Force("polynomial", {"c1": 1.0, "c3": 0.2, "damping": 0.1})
SCENES = {
    "drive terms": {"damping": 0.1, "walls": (-1.0, 1.0), "drive": [(0.3, 2, 0.1)]},
    "soft walls": {"damping": 0.1, "walls": SOFT_WALLS, "drive": [(0.3, 2, 0.1)]},
    "force and contact law": {"force": DUFFING, "walls": (jv.Wall(-1.0, law=CONTACT_LAW), None)},
}


@pytest.mark.parametrize("solved", ["orbit", "period"])
@pytest.mark.parametrize("name", SCENES)
def test_the_motion_of_each_kind_of_scene_has_a_program(name, solved):
    """Newton's method for an orbit, and a period of the map with its monodromy matrix, are traced and not run."""
    scene, before = jv.make_scene(2.0, 1.7, restitution=0.7, **SCENES[name]), fallback_counts()
    if solved == "orbit":
        function, given = solve_guess, padded_sequence(scene, [0.5], [1.0], [-1.0], 0.0, 1)
    else:
        function, given = _strobe_period_compiled, make_state_arrays(scene, jv.State(0.0, 0.1))
    program, _ = function.find_program((scene, given))
    assert fallback_counts() == before and program.size > 1000


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
