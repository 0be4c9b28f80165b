"""Programs around a kernel change nothing within it: what XLA's emitter cannot take is never handed to it."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

import jaxvibro as jv
from jaxvibro.compiled.kernel_calls import call_as_kernel, can_be_kernel
from jaxvibro.compiled.kernel_costs import max_cost_to_limit_ratio

from .lanes import at

LANES = 4


def looped(a, b, c):
    """A loop that needs a; b stays as it is, and nothing needs c."""
    return lax.while_loop(lambda s: s[0] < 3, lambda s: (s[0] + 1, jnp.sin(s[1] + b), s[2] * 2.0), (0, a, c))[1]


def small_calls(function, *args):
    """The calls that XLA is asked to compile as one kernel, in the text of a lowered program."""
    text = jax.jit(function).lower(*args).as_text()
    return [line for line in text.splitlines() if "xla_cpu_small_call" in line and "call @" in line]


def test_operands_are_stacked_behind_a_barrier():
    """Whatever the operands are, a kernel takes arrays of at least two rows, which constant folding does not see."""
    lane = np.linspace(0.1, 0.4, LANES)
    programs = {
        "operands": (lambda a, b: call_as_kernel(looped, a, b, a), lane, 2.0 * lane),
        "repeated": (lambda a: call_as_kernel(looped, a, a, a), lane),
        "constant": (lambda a: call_as_kernel(looped, a, jnp.zeros(LANES), jnp.zeros(LANES)), lane),
        "scalar": (lambda a: call_as_kernel(looped, a, 0.5, a), lane),
        "all constant": (lambda: call_as_kernel(looped, *[jnp.ones(LANES)] * 3),),
    }
    for name, (program, *args) in programs.items():
        (call,) = small_calls(program, *args)
        operands = call.split(" : (")[1].split(") ->")[0].split(", ")
        assert all(int(one.split("<")[1].split("x")[0]) >= 2 for one in operands), (name, call)
        assert jax.jit(program).lower(*args).as_text().count("optimization_barrier") == 2, name
        expected = jax.jit(lambda *a, f=program: f(*a))(*args)
        assert np.all(np.isfinite(expected)), name


def test_a_constant_operand_is_a_parameter_with_a_use():
    """The cause of an abort: constant folding moved a constant array into a kernel, and its parameter had no use."""
    program = jax.jit(lambda a: call_as_kernel(looped, a, jnp.zeros(LANES), 0.5 + jnp.zeros(LANES)))
    lane = np.linspace(0.1, 0.4, LANES)
    text = program.lower(lane).compile().as_text()
    calls = [line for line in text.splitlines() if "xla_cpu_small_call" in line and " call(" in line]
    assert any('inlineable="false"' in call for call in calls)
    for call in calls:
        name = call.split("to_apply=%")[1].split(",")[0]
        body = text.split(f"\n%{name} ", 1)[1].split("\n}", 1)[0].splitlines()[1:]
        for parameter in [line.split("=")[0].strip() for line in body if " parameter(" in line]:
            used = [line for line in body if parameter in line and not line.strip().startswith(parameter)]
            assert used, (parameter, body)
    np.testing.assert_allclose(program(lane), np.sin(np.sin(np.sin(lane))), rtol=1e-15)


def test_derivatives_and_lanes_of_a_kernel():
    """Derivatives are compiled without the attribute; a vmap keeps it where a kernel can hold what it becomes."""
    lane = np.linspace(0.1, 0.4, LANES)
    run = lambda a: call_as_kernel(looped, a, 0.5 * a, a)  # noqa: E731
    assert len(small_calls(run, lane)) == 1
    assert not small_calls(lambda a: jax.jvp(run, (a,), (a,))[1], lane)
    many = np.stack([lane, 2.0 * lane, 3.0 * lane])
    assert len(small_calls(jax.vmap(run), many)) == 1
    np.testing.assert_array_equal(jax.jit(jax.vmap(run))(many), np.stack([jax.jit(run)(one) for one in many]))
    slope = jax.jit(lambda a: jax.jvp(run, (a,), (jnp.ones_like(a),))[1])(lane)
    step = 1e-6
    around = [jax.jit(run)(lane + way * step) for way in (1, -1)]
    np.testing.assert_allclose(slope, (around[0] - around[1]) / (2 * step), rtol=1e-8)


@pytest.mark.parametrize("operation", ["gathered", "scattered", "sorted"])
def test_a_vmap_that_adds_operations_without_a_kernel(operation):
    """Lanes that index an array each become a gather or scatter, which is compiled without the attribute."""

    def indexed(values, place):
        def turn(carry):
            count, values = carry
            if operation == "sorted":
                return count + 1, lax.sort(values)
            if operation == "gathered":
                return count + 1, values + lax.dynamic_index_in_dim(values, place, keepdims=False)
            return count + 1, lax.dynamic_update_index_in_dim(values, values[0] + 1.0, place, 0)

        return lax.while_loop(lambda carry: carry[0] < 2, turn, (0, values))[1]

    values, places = np.random.default_rng(0).normal(size=(5, 7)), np.array([0, 3, 6, 2, 1])
    found = jax.jit(jax.vmap(lambda v, k: call_as_kernel(indexed, v, k)))(values, places)
    alone = [jax.jit(indexed)(*one) for one in zip(values, places, strict=True)]
    np.testing.assert_array_equal(found, alone)


def test_the_cost_of_an_operation_follows_xla():
    """Of n lanes, 40 of them read and 400 multiplied and added: (400 + 10 * 8 * 41) n of 200,000, by XLA's model."""

    def polynomial(lanes):
        total = lanes[0]
        for k in range(400):
            total = total * lanes[k % 40]
        return total

    for n in (1, 32, 64):
        jaxpr = jax.make_jaxpr(polynomial)([np.ones(n)] * 40).jaxpr
        expected = 0.0 if n == 1 else (400 + 10 * 8 * 41) * n / 200_000
        assert max_cost_to_limit_ratio(jaxpr) == pytest.approx(expected, rel=1e-12), n
    jaxpr = jax.make_jaxpr(polynomial)([np.ones(64)] * 40).jaxpr
    assert max_cost_to_limit_ratio(jaxpr) > 1 and not can_be_kernel(jaxpr)


@pytest.mark.parametrize(("powers", "flops"), [(7, 0), (18, 19 * 64 + 1)])
def test_a_scalar_counts_once_and_what_moves_more_than_it_computes_counts_by_its_bytes(powers, flops):
    def program(scalar, lanes):
        total = lanes * (scalar * scalar)
        for _ in range(powers):
            total = total * lanes
        return total

    moved = 2 * 8 * 64 + 8  # the lanes read and written, and the scalar
    compute, memory = (flops + 10 * min(moved, flops)) / 200_000, moved / (2 * (256 << 10))
    jaxpr = jax.make_jaxpr(program)(np.ones(()), np.ones(64)).jaxpr
    assert max_cost_to_limit_ratio(jaxpr) == pytest.approx(max(compute, memory), rel=1e-12)


@pytest.mark.parametrize(("rows", "reads"), [(15, 15 + 2), (16, 16 + 16)])
def test_a_value_that_many_operations_read_is_kept_in_memory(rows, reads):
    """XLA does not fuse an operation that one fusion would evaluate more than 15 times: it is stored, and read."""

    def horner(table, x):
        for _ in range(40):
            table = table * 1.5
        total = x
        for k in range(rows):
            total = total * x + table[k]
        return total

    jaxpr = jax.make_jaxpr(horner)(np.ones((rows, 64)), np.ones(64)).jaxpr
    flops = 40 * rows * 64 + (2 * rows * 64 if rows == 15 else 0)  # of all, or of the table alone
    assert max_cost_to_limit_ratio(jaxpr) == pytest.approx((flops + 10 * 8 * 64 * reads) / 200_000, rel=1e-12)


def test_derivatives_of_a_batch_of_scenes():
    """Case A1: every number of the scene as lanes, any derivative; XLA's emitter aborted the process."""
    rng = np.random.default_rng(0)
    named = {"A": (1, 6), "w": (1, 3), "g": (0.01, 0.2), "R": (0.3, 0.9), "l": (-1.2, -1), "r": (1, 1.2)}
    lanes = {name: rng.uniform(*bounds, LANES) for name, bounds in named.items()}
    start = np.stack([rng.uniform(-0.9, 0.9, LANES), rng.uniform(-2, 2, LANES)], 1)

    def end(z, p):
        scene = jv.make_scene(p["A"], p["w"], p["g"], p["R"], (p["l"], p["r"]))
        state, _ = jv.strobe(scene, jv.State(z[0], z[1]))
        return jnp.stack([state.x, state.v])

    slopes = jax.jit(jax.vmap(jax.jacfwd(end)))(start, lanes)
    for k in range(LANES):
        z, p = at((start, lanes), k)
        scene = jv.make_scene(p["A"], p["w"], p["g"], p["R"], (p["l"], p["r"]))
        np.testing.assert_allclose(slopes[k], jv.monodromy(scene, jv.State(*z)), rtol=1e-9, atol=1e-12)


def test_many_harmonics_with_clearances():
    """Case A2: a fusion of 37 arrays of 64 lanes was split over threads within a kernel, which did not link."""
    rng = np.random.default_rng(0)

    def lanes(low, high):
        return rng.uniform(low, high, 100)

    left = jv.Wall(lanes(-1.2, -1), lanes(0.3, 0.9), motion=jv.Motion(lanes(0, 0.1), lanes(-3, 3), 5))
    right = jv.Wall(lanes(1, 1.2), lanes(0.3, 0.9), motion=jv.Motion(lanes(0, 0.1), lanes(-3, 3), 4))
    drive = ((lanes(0, 1), 5, lanes(-3, 3)), (lanes(0, 1), 5, lanes(-3, 3)), (lanes(-1, 1), 0, 0.0))
    scene = jv.make_scene(lanes(1, 5), lanes(1, 3), lanes(0, 0.2), None, (left, right), drive=drive)
    state = jv.State(lanes(-0.8, 0.8), lanes(-2, 2), lanes(-3, 3))
    end, impacts = jv.strobe(scene, state, slots=64, clearance=True)
    for k in (0, 57, 99):
        one, alone = jv.strobe(*at((scene, state), k), slots=64, clearance=True)
        np.testing.assert_allclose([end.x[k], end.v[k]], [one.x, one.v], rtol=1e-12, atol=1e-13)
        np.testing.assert_allclose(impacts.least_clearance[k], alone.least_clearance, rtol=1e-12, atol=1e-13)


ROWS = 64
ONES = np.ones(3)
REDUCTIONS = {
    "largest": lambda lib, a: lib.max(a, -1, keepdims=True),
    "least": lambda lib, a: lib.min(a, 0, keepdims=True),
    "sum": lambda lib, a: lib.sum(a) / a.size,
    "product of matrices": lambda lib, a: (a @ a.T) @ a / a.size,
    "product of lanes": lambda lib, a: lib.einsum("ij,ij->i", a, a)[:, None] / a.size,
    "product with a vector": lambda lib, a: (a[:, :3] @ ONES)[:, None],
}


@pytest.mark.parametrize("columns", [3, 80])
@pytest.mark.parametrize("kind", REDUCTIONS)
def test_reductions_and_products_of_any_size(kind, columns):
    function = REDUCTIONS[kind]

    def turned(values):
        def turn(carry):
            count, a = carry
            return count + 1, jnp.cos(a + function(jnp, a))

        return lax.while_loop(lambda carry: carry[0] < 3, turn, (0, values))[1]

    start = np.random.default_rng(0).normal(size=(ROWS, columns))
    expected = start
    for _ in range(3):
        expected = np.cos(expected + function(np, expected))
    found = jax.jit(lambda values: call_as_kernel(turned, values))(start)
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-13)
