"""JAX functions for the interpreter of the continuation package: primitives of every type, and random programs."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

UNARY = "abs ceil cos cosh exp exp2 expm1 floor is_finite log log1p neg rsqrt sign sin sinh sqrt square tan tanh"
BINARY = "add sub mul div rem max min pow atan2 nextafter eq ne lt le gt ge bitwise_and bitwise_or bitwise_xor"
TYPES = ["float32", "float64", "complex64", "complex128", "bool"]
TYPES += [f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)]
BITS = {1: np.uint8, 2: np.uint16, 4: np.uint32, 8: np.uint64}


def row(x):
    return x.reshape(3, -1)


def power(x, y):
    """x**y but for a complex x = 0, of which XLA makes NaN where NumPy gives 0."""
    return lax.pow(jnp.where(x == 0, 1, x) if x.dtype.kind == "c" else x, y)


# functions of one array, and of two
ONE = {name: getattr(lax, name) for name in UNARY.split()} | {"not": lax.bitwise_not}
ONE |= {f"power {n}": lambda x, n=n: lax.integer_pow(x, n) for n in (0, 1, 2, 3, -1, -2, 5)}
ONE |= {f"to {kind}": lambda x, kind=kind: lax.convert_element_type(x, kind) for kind in TYPES}
ONE |= {f"round {method}": lambda x, method=method: lax.round(x, method) for method in lax.RoundingMethod}
ONE |= {
    f"reduce_{name}": lambda x, name=name: (
        getattr(lax, f"reduce_{name}")(row(x), (0,)),
        getattr(lax, f"reduce_{name}")(x, (0,)),
    )
    for name in ("sum", "prod", "max", "min", "and", "or")
}
ONE |= {
    "argmax": lambda x: (lax.argmax(x, 0, np.int32), lax.argmin(x, 0, np.int32)),
    "running": lambda x: [f(x, reverse=way) for f in (lax.cumsum, lax.cumprod) for way in (False, True)],
    "gather": lambda x: (x.at[np.array([1, 400, -1])].get(mode="fill"), x.at[np.array([1, 400])].get(mode="clip")),
    "scatter": lambda x: (x.at[np.array([1, 2, 1])].add(x[:3]), x.at[np.array([1, 2, 1])].multiply(x[:3])),
    "put": lambda x: (x.at[np.array([1, 2])].set(x[:2]), lax.pad(x, x[0], [(1, 2, 3)]), lax.iota(x.dtype, 5)),
    "bits": lambda x: lax.bitcast_convert_type(x, BITS[x.dtype.itemsize]),
    "parts": lambda x: (lax.real(x), lax.imag(x), lax.conj(x)),
}
TWO = {name: getattr(lax, name) for name in BINARY.split()} | {"complex": lax.complex, "pow": power}
TWO |= {
    "clamp": lambda x, y: lax.clamp(lax.min(x[2], x[3]), y, lax.max(x[2], x[3])),
    "sort": lambda x, y: (lax.sort(x), lax.sort((x, y), num_keys=1)),
    "dot": lambda x, y: row(x) @ row(y).T,
    "select": lambda x, y: (lax.select(x == y, x, y), lax.select(x == x, x, y)),
    "shapes": lambda x, y: (lax.concatenate([x, y], 0), lax.rev(x, (0,)), lax.broadcast_in_dim(x, (2, len(x)), (1,))),
}
EDGES = {
    "f": [0.0, -0.0, 1.0, -1.0, 0.5, -0.5, 2.5, np.nan, np.inf, -np.inf, 3.3, -2.0],
    "c": [0, 1, -1, 1j, -1j, 0.5 + 2j, -0.5 - 1j, 2 - 0.3j, complex(-0.0, 1), 3.3, -2 + 0.1j, 0.1j],
    "b": [0, 1] * 6,
}


@dataclass(frozen=True)
class NumberType:
    """A type of number."""

    name: str

    def draw(self, rng, size):
        """Return numbers of the type, its edges among them, in random order."""
        dtype = np.dtype(self.name)
        if dtype.kind in "iu":
            low, high = np.iinfo(dtype).min, np.iinfo(dtype).max
            edges = [0, 1, high, low, 2, 3, 5, high - 1, low + 1, 7, high // 2, 1]
        else:
            edges = EDGES[dtype.kind]
        return np.concatenate([rng.permutation(np.array(edges, dtype)) for _ in range(size // 12)])


def functions_of(arrays):
    """Return {name: (function, arguments)} of the functions that JAX has for numbers of this type."""
    found = {}
    for count, functions in ((1, ONE), (2, TWO)):
        for name, function in functions.items():
            try:
                jax.jit(function).lower(*arrays[:count])
            except (TypeError, NotImplementedError, KeyError):
                continue
            found[name] = function, arrays[:count]
    return found


# Steps of random programs, from (x, k, table) to x, with shapes (n,), (3,) and (n, n); some of k exceed n.
def waved(x, k, table):
    return jnp.sin(x[::-1]) * x + jnp.cos(table[0])


def chosen(x, k, table):
    return jnp.where((x > x.mean()) & jnp.isfinite(x), x, -0.5 * x**2)


def multiplied(x, k, table):
    return jnp.tanh(table @ x + jnp.einsum("ij,kj,k->i", table, table, x))


def ordered(x, k, table):
    return lax.sort((jnp.round(x), jnp.cumsum(x) / len(x), jnp.arange(len(x))), num_keys=2)[1]


def scattered(x, k, table):
    return x.at[k].add(0.3, mode="drop").at[k[1]].multiply(0.7).at[1:3].set(x[:2]).at[k].set(k * 0.1, mode="clip")


def gathered(x, k, table):
    some = (
        x.at[k].get(mode="fill", fill_value=0.5)
        + table[:, 0].at[k].get(mode="clip")
        + lax.dynamic_slice_in_dim(x, k[0], 1)
    )
    return jnp.concatenate([some, x[3:]])


def windowed(x, k, table):
    rows = jax.vmap(lambda row, start: lax.dynamic_slice_in_dim(row, start, 2).sum())(table, jnp.arange(len(x)) + k[0])
    return lax.dynamic_update_slice_in_dim(rows, x[:2], k[2], 0)


def counted(x, k, table):
    return lax.fori_loop(0, 3, lambda turn, y: y.at[turn].add(0.5 * y[k[0] - turn]), x)


def looped(x, k, table):
    halves = lax.while_loop(lambda c: c[0] > 1e-2, lambda c: (0.5 * c[0], c[1] + 1), (jnp.abs(x[0]), 0))
    lanes = jax.vmap(lambda y: lax.while_loop(lambda c: jnp.abs(c) > 0.3, lambda c: 0.6 * c, y))(x)
    return lanes + 0.01 * halves[1]


def exchanged(x, k, table):
    first, second, _ = lax.fori_loop(0, 7, lambda _, c: (c[1], 0.5 * c[0] + c[2], c[2]), (x[0], x[1], 0.5))
    return jnp.stack([first, second, *x[2:]])


def scanned(x, k, table):
    total, rows = lax.scan(lambda c, row: (c + row[0] * row[1], c * row[1]), 0.5, (x, table[1]), reverse=True)
    return jnp.tanh(rows) + 0.1 * total


def branched(x, k, table):
    x = lax.cond(x[0] > x[1], lambda x: x + 1.0, lambda x: 0.5 * x, x)
    lanes = jax.vmap(lambda k, x: lax.switch(k, [jnp.sin, jnp.cos, lambda x: 2.0 * x], x))(k, x[:3])
    return jnp.concatenate([lanes, lax.switch(k[0], [jnp.sin, jnp.cos, lambda x: -x], x[3:])])


def sloped(x, k, table):
    slopes = jax.jacfwd(lambda x: jnp.where(x > 0, jnp.sin(x), x**2) * x[0])(x)
    return slopes.sum(0) + jax.grad(lambda x: jnp.sum(jnp.sort(x) ** 2) + jnp.max(x))(x)


def padded(x, k, table):
    wide = lax.pad(jnp.tile(x, 2), x[0], [(1, 2, 1)])
    return jnp.stack(jnp.split(wide[3 : 3 + 2 * len(x)], 2)).max(0) + jnp.argmax(x) * 0.1


def indexed(x, k, table):
    rows = jnp.take_along_axis(table, jnp.argsort(table, 1)[:, :1], 1)[:, 0]
    return rows + table[k % 3, k[0]].sum() + (k // 2 - -k // 3).sum() * 0.1 + k.astype(jnp.float32)[0]


STEPS = (waved, chosen, multiplied, ordered, scattered, gathered, windowed, counted, looped, exchanged, scanned)
STEPS += (branched, sloped, padded, indexed)


@dataclass(frozen=True)
class RandomProgram:
    """Programs of some random steps: on numbers written one by one, or on arrays."""

    name: str
    size: int

    def draw(self, rng):
        """Return a function and its arguments."""
        steps, constant = rng.choice(len(STEPS), 5), rng.normal(size=(3, self.size))

        def function(x, k, table):
            parts, offset = [], jnp.asarray(constant).at[k[0]].get(mode="clip")
            for step in steps:
                x = STEPS[step](x, k, table) / (1.0 + 0.1 * jnp.abs(x)) + offset
                parts.append(x[0])
            return {"x": x, "parts": (tuple(parts), None), "order": x > x[::-1], "whole": (8.0 * x).astype(np.int32)}

        return function, (rng.normal(size=self.size), rng.integers(0, 9, 3), rng.normal(size=(self.size, self.size)))


TYPES_OF_NUMBERS = {name: NumberType(name) for name in TYPES}
PROGRAMS = {program.name: program for program in (RandomProgram("few", 4), RandomProgram("many", 7))}
