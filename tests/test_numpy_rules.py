"""Every rule of `continuation.numpy_primitives` against XLA, for every type of number: same type, same values, edges
too."""

import inspect

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

import continuation as co
from continuation.numpy_evaluation import NumpyEvaluator
from continuation.numpy_primitives import rules

TYPES = ["float32", "float64", "complex64", "complex128", "bool"]
TYPES += [f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)]
UNARY = "abs ceil cos cosh exp exp2 expm1 floor is_finite log log1p neg rsqrt sign sin sinh sqrt square tan tanh"
BINARY = "add sub mul div rem max min pow atan2 nextafter eq ne lt le gt ge bitwise_and bitwise_or bitwise_xor"
ONE, TWO = UNARY.split(" "), BINARY.split(" ")
BITS = {1: np.uint8, 2: np.uint16, 4: np.uint32, 8: np.uint64}


def row(x):
    return x.reshape(3, -1)


CASES = {name: getattr(lax, name) for name in ONE} | {"not": lax.bitwise_not}
CASES |= {name: lambda x, y, name=name: getattr(lax, name)(x, y) for name in TWO}
CASES |= {f"power {n}": lambda x, n=n: lax.integer_pow(x, n) for n in (0, 1, 2, 3, -1, -2, 5)}
CASES |= {f"to {kind}": lambda x, kind=kind: lax.convert_element_type(x, kind) for kind in TYPES}
CASES |= {f"round {one}": lambda x, one=one: lax.round(x, one) for one in lax.RoundingMethod}
CASES |= {
    f"reduce_{name}": lambda x, name=name: (
        getattr(lax, f"reduce_{name}")(row(x), (0,)),
        getattr(lax, f"reduce_{name}")(x, (0,)),
    )
    for name in ("sum", "prod", "max", "min", "and", "or")
}
CASES |= {
    "clamp": lambda x, y: lax.clamp(lax.min(x[2], x[3]), y, lax.max(x[2], x[3])),
    "argmax": lambda x: (lax.argmax(x, 0, np.int32), lax.argmin(x, 0, np.int32)),
    "running": lambda x: [f(x, reverse=way) for f in (lax.cumsum, lax.cumprod) for way in (False, True)],
    "sort": lambda x, y: (lax.sort(x), lax.sort((x, y), num_keys=1)),
    "dot": lambda x, y: row(x) @ row(y).T,
    "select": lambda x, y: (lax.select(x == y, x, y), lax.select(x == x, x, y)),
    "gather": lambda x: (x.at[np.array([1, 400, -1])].get(mode="fill"), x.at[np.array([1, 400])].get(mode="clip")),
    "scatter": lambda x: (x.at[np.array([1, 2, 1])].add(x[:3]), x.at[np.array([1, 2, 1])].multiply(x[:3])),
    "put": lambda x: (x.at[np.array([1, 2])].set(x[:2]), lax.pad(x, x[0], [(1, 2, 3)]), lax.iota(x.dtype, 5)),
    "bits": lambda x: lax.bitcast_convert_type(x, BITS[x.dtype.itemsize]),
    "shapes": lambda x, y: (lax.concatenate([x, y], 0), lax.rev(x, (0,)), lax.broadcast_in_dim(x, (2, len(x)), (1,))),
    "parts": lambda x: (lax.real(x), lax.imag(x), lax.conj(x)),
    "complex": lambda x, y: lax.complex(x, y),
}


def numbers(kind, seed, size):
    """Numbers of a type, its edges among them; their order is random."""
    kind, draw = np.dtype(kind), np.random.default_rng(seed)
    if kind.kind == "f":
        some = [0.0, -0.0, 1.0, -1.0, 0.5, -0.5, 2.5, np.nan, np.inf, -np.inf, 3.3, -2.0]
    elif kind.kind == "c":
        some = [0, 1, -1, 1j, -1j, 0.5 + 2j, -0.5 - 1j, 2 - 0.3j, complex(-0.0, 1), 3.3, -2 + 0.1j, 0.1j]
    elif kind.kind == "b":
        some = [0, 1] * 6
    else:
        ends = np.iinfo(kind)
        some = [0, 1, ends.max, ends.min, 2, 3, 5, ends.max - 1, ends.min + 1, 7, ends.max // 2, 1]
    return np.concatenate([draw.permutation(np.array(some, kind)) for _ in range(size // 12)])


def given_of(name, kind, size):
    """Arguments of a case; None where jax refuses numbers of this type."""
    parameters = inspect.signature(CASES[name]).parameters.values()
    count = 1 if name in ONE or name == "not" else sum(each.default is each.empty for each in parameters)
    args = [numbers(kind, seed, size) for seed in range(count)]
    try:
        jax.jit(CASES[name]).lower(*args)
    except (TypeError, NotImplementedError, KeyError):
        return None
    return args


FAST = (("complex128", 36), ("int32", 12))  # the others take half a minute
EVERY = [
    pytest.param(kind, size, marks=[] if (kind, size) in FAST else pytest.mark.slow)
    for kind in TYPES
    for size in (12, 36)  # written number by number, and evaluated by NumPy
]


@pytest.mark.parametrize(("kind", "size"), EVERY)
@pytest.mark.filterwarnings("ignore")
def test_every_rule_is_right_for_every_type(kind, size):
    given = {name: args for name in CASES if (args := given_of(name, kind, size)) is not None}
    expected = jax.jit(lambda given: {name: CASES[name](*args) for name, args in given.items()})(given)
    evaluated = 0
    for name, args in given.items():
        found = NumpyEvaluator(CASES[name], (), {})(tuple(args))
        if found is None:  # compiled, always
            continue
        evaluated += 1
        for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(expected[name]), strict=True):
            one, other = np.asarray(one), np.asarray(other)
            assert (one.shape, one.dtype) == (other.shape, other.dtype), name
            if other.dtype.kind not in "fc":
                np.testing.assert_array_equal(one, other, name)
                continue
            eps = np.finfo(other.dtype).eps
            np.testing.assert_allclose(one, other, 64 * eps, 16 * eps, equal_nan=True, err_msg=name)
    assert evaluated > 30


def test_complex_constants_are_divided():
    a, b = np.array([1.0 + 2.0j, 0.5j]), np.array([2.0 - 1.0j, 1.0 + 1.0j])
    assert "div" in rules

    def move(u, p, args):
        return 0.5 * u + 0.1 * jnp.sin(p["a"] * u) + (jnp.asarray(a) / jnp.asarray(b)).real

    branch = co.trace(co.fixed_points(move), [0.1, 0.5], {"a": 0.3}, "a", (0.0, 1.0))
    ends = branch.u[np.argmin(branch.p["a"])]
    np.testing.assert_allclose(ends, 2.0 * (a / b).real, atol=1e-9)  # at a = 0 u = u / 2 + c


def test_a_complex_number_may_be_an_argument():
    system = co.fixed_points(lambda u, p, args: 0.5 * u + p["a"] * (args / (1.0 + 1.0j)).real)
    branch = co.trace(system, 0.4, {"a": 0.4}, "a", (0.0, 1.0), args=np.complex128(1.0 + 0.0j))
    np.testing.assert_allclose(branch.u[:, 0], branch.p["a"], atol=1e-9)
    again = co.trace(system, 0.4, {"a": 0.4}, "a", (0.0, 1.0), args=1.0 + 0.0j)
    np.testing.assert_array_equal(again.u, branch.u)
    with pytest.raises(co.ContinuationError, match="args: must be numbers and arrays"):
        co.trace(system, 0.4, {"a": 0.4}, "a", (0.0, 1.0), args="x")
