"""Taylor series of elementary functions of other series, a coefficient at a time.

The k-th coefficient of a function of u needs those of u up to the k-th and its own before that (Griewank and Walther,
Evaluating Derivatives, chapter 13). Each sum of products is a stage of its own, so that it is worked out once.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from ..compiled.compiler_hints import stage

Coefficient = Any  # lanes, a number, or None: zero


class Series:
    """The coefficients of t^0, t^1, ..., each found when it is first asked for.

    rule: (this series, k) -> the k-th, from those before it; None where all but the first are zero.
    """

    def __init__(self, rule: Callable[["Series", int], Coefficient] | None, *first: Coefficient) -> None:
        self.rule, self.found = rule, list(first)

    @property
    def constant(self) -> bool:
        return self.rule is None

    def __getitem__(self, k: int) -> Coefficient:
        if self.rule is None:
            return self.found[0] if k == 0 else None
        while len(self.found) <= k:
            self.found.append(self.rule(self, len(self.found)))
        return self.found[k]


def products(pairs, weights=None, more=None, over=None):
    """(more + the sum of weight a b) / over: of the pairs those of which neither is zero."""
    weights = [1.0] * len(pairs) if weights is None else weights
    kept = [
        (*pair, weight) for pair, weight in zip(pairs, weights, strict=True) if not (pair[0] is None or pair[1] is None)
    ]
    if not kept and more is None:
        return None
    first, second, weights = zip(*kept, strict=True) if kept else ((), (), ())
    return stage(_products, first, second, more, over, weights=tuple(map(float, weights)))


def _products(first, second, more, over, weights):
    total = more
    for a, b, weight in zip(first, second, weights, strict=True):
        term = a * b if weight == 1.0 else weight * (a * b)
        total = term if total is None else total + term
    return total if over is None else total / over


def at_first(name, *given):
    """The first coefficient of an operation of lax."""
    return stage(_at_first, *(each[0] for each in given), name=name)


def _at_first(*given, name):
    shape = jnp.broadcast_shapes(*map(jnp.shape, given))
    return getattr(lax, name)(*(jnp.broadcast_to(each, shape) for each in given))


def times(number, a):
    return None if a is None else number * a


def added(a, b):
    return b if a is None else a if b is None else a + b


def plus(a, b):
    return Series(lambda own, k: added(a[k], b[k]))


def minus(a, b):
    return Series(lambda own, k: added(a[k], times(-1.0, b[k])))


def shifted(number, a):
    """number + a."""
    return Series(lambda own, k: a[k] if k else added(number, a[0]))


def scaled(number, a):
    return Series(lambda own, k: times(number, a[k]))


def product(a, b):
    if a is b:
        return Series(lambda own, k: products(*_halves(a, k)))
    if a.constant or b.constant:
        still, other = (a, b) if a.constant else (b, a)
        return scaled(still[0], other)
    return Series(lambda own, k: products([(a[j], b[k - j]) for j in range(k + 1)]))


class Square(Series):
    """The square of a series, of which powers by halves are those of the series itself, also where it passes zero."""

    def __init__(self, root: Series) -> None:
        super().__init__(lambda own, k: products(*_halves(root, k)))
        self.root = root


def _halves(a, k):
    """(pairs, weights) of the k-th coefficient of a square."""
    pairs = [(a[j], a[k - j]) for j in range(k // 2 + 1)]
    return pairs, [1.0 if 2 * j == k else 2.0 for j in range(k // 2 + 1)]


def quotient(a, b):
    if b.constant:
        return Series(lambda own, k: None if a[k] is None else a[k] / b[0])

    def rule(own, k):
        return products([(b[j], own[k - j]) for j in range(1, k + 1)], [-1.0] * k, a[k], b[0])

    return Series(rule)


def driven(u, first, rate):
    """y, y_0 being given, with y' = rate(y) u'."""

    def rule(own, k):
        by = rates(own)
        return products([(u[j], by[k - j]) for j in range(1, k + 1)], [j / k for j in range(1, k + 1)])

    rates = _kept(rate)
    return Series(rule, first)


def held(u, first, weight):
    """y, y_0 being given, with weight(y) y' = u'."""

    def rule(own, k):
        by = weights(own)
        return products([(own[j], by[k - j]) for j in range(1, k)], [-j / k for j in range(1, k)], u[k], by[0])

    weights = _kept(weight)
    return Series(rule, first)


def _kept(function):
    """A function of one series, which is asked of no other, called once."""
    found: list[Series] = []

    def called(own):
        if not found:
            found.append(function(own))
        return found[0]

    return called


def power(u, exponent, first):
    """u^exponent, a number or lanes: u y' = exponent u' y."""

    def rule(own, k):
        pairs = [(u[j], own[k - j]) for j in range(1, k + 1)]
        rise = products(pairs, [j / k for j in range(1, k + 1)])
        return products(pairs[:-1], [(j - k) / k for j in range(1, k)], times(exponent, rise), u[0])

    return Series(rule, first)


def whole_power(u, exponent):
    """u^exponent, a whole number, by products: right where u passes zero too."""
    if exponent < 0:
        return quotient(Series(None, 1.0), whole_power(u, -exponent))
    if exponent < 2:
        return u if exponent else Series(None, jnp.ones_like(u[0]))
    half = whole_power(u, exponent // 2)
    square = product(half, half)
    return product(square, u) if exponent % 2 else square


def turning(u, names, sign):
    """(y, z), of these names in lax: y' = z u', z' = sign y u'."""
    first = [at_first(name, u) for name in names]
    pair: list[Series] = []
    pair.append(driven(u, first[0], lambda own: pair[1]))
    pair.append(driven(u, first[1], lambda own: scaled(sign, pair[0])))
    return pair


def square_and(number, sign, u):
    """number + sign u^2."""
    return shifted(number, scaled(sign, product(u, u)))


def root(a):
    if isinstance(a, Square):
        return a.root
    return power(a, 0.5, at_first("sqrt", a))


def exponential(u):
    return driven(u, at_first("exp", u), lambda own: own)


def logarithm(u):
    return held(u, at_first("log", u), lambda own: u)


def _by(name, rate):
    """The rule of an operation of lax whose result y has y' = rate(u, y) u'."""
    return lambda given, **_: driven(given[0], at_first(name, given[0]), lambda own: rate(given[0], own))


def _over(name, weight):
    """The rule of an operation of lax whose result y has weight(u, y) y' = u'."""
    return lambda given, **_: held(given[0], at_first(name, given[0]), lambda own: weight(given[0], own))


def _general_power(given, **_):
    base, exponent = given
    halves = _halves_of(exponent) if isinstance(base, Square) else None
    if halves is not None:
        return whole_power(base.root, halves)
    if exponent.constant:
        return power(base, exponent[0], at_first("pow", base, exponent))
    return exponential(product(exponent, logarithm(base)))


def _halves_of(exponent):
    """How many halves an exponent is, None where that is not a whole number that stands in the force itself."""
    known = exponent.constant and isinstance(exponent[0], float | np.floating | np.ndarray)
    twice = 2.0 * float(exponent[0]) if known else 0.5
    return int(twice) if twice.is_integer() else None


def _angle(given, **_):
    """atan2(a, b): (a^2 + b^2) y' = b a' - a b'."""
    a, b = given
    size = plus(product(a, a), product(b, b))

    def rule(own, k):
        first, second = [(b[k - j], a[j]) for j in range(1, k + 1)], [(a[k - j], b[j]) for j in range(1, k + 1)]
        weights = [j / k for j in range(1, k + 1)]
        turn = products(first + second, weights + [-weight for weight in weights])
        return products([(own[j], size[k - j]) for j in range(1, k)], [-j / k for j in range(1, k)], turn, size[0])

    return Series(rule, at_first("atan2", a, b))


def _of(name, place, sign):
    """The rule of one of a pair of functions that turn into each other."""
    return lambda given, **_: turning(given[0], name, sign)[place]


CIRCULAR, HYPERBOLIC = ("sin", "cos"), ("sinh", "cosh")
HALF_NORMAL = 2.0 / math.sqrt(math.pi)
RULES: dict[str, Callable[..., Series]] = {  # of an operation's inputs, and its parameters by name
    "add": lambda given, **_: plus(*given),
    "add_any": lambda given, **_: plus(*given),
    "sub": lambda given, **_: minus(*given),
    "mul": lambda given, **_: product(*given),
    "div": lambda given, **_: quotient(*given),
    "neg": lambda given, **_: scaled(-1.0, given[0]),
    "square": lambda given, **_: product(given[0], given[0]),
    "integer_pow": lambda given, y, **_: whole_power(given[0], y),
    "pow": _general_power,
    "sqrt": lambda given, **_: root(given[0]),
    "rsqrt": lambda given, **_: power(given[0], -0.5, at_first("rsqrt", given[0])),
    "cbrt": lambda given, **_: power(given[0], 1.0 / 3.0, at_first("cbrt", given[0])),
    "exp": lambda given, **_: exponential(given[0]),
    "exp2": lambda given, **_: exponential(scaled(math.log(2.0), given[0])),
    "expm1": _by("expm1", lambda u, own: shifted(1.0, own)),
    "log": lambda given, **_: logarithm(given[0]),
    "log1p": _over("log1p", lambda u, own: shifted(1.0, u)),
    "sin": _of(CIRCULAR, 0, -1.0),
    "cos": _of(CIRCULAR, 1, -1.0),
    "sinh": _of(HYPERBOLIC, 0, 1.0),
    "cosh": _of(HYPERBOLIC, 1, 1.0),
    "tan": _by("tan", lambda u, own: square_and(1.0, 1.0, own)),
    "tanh": _by("tanh", lambda u, own: square_and(1.0, -1.0, own)),
    "logistic": _by("logistic", lambda u, own: minus(own, product(own, own))),
    "erf": _by("erf", lambda u, own: scaled(HALF_NORMAL, exponential(scaled(-1.0, product(u, u))))),
    "erfc": _by("erfc", lambda u, own: scaled(-HALF_NORMAL, exponential(scaled(-1.0, product(u, u))))),
    "asin": _over("asin", lambda u, own: root(square_and(1.0, -1.0, u))),
    "acos": _over("acos", lambda u, own: scaled(-1.0, root(square_and(1.0, -1.0, u)))),
    "atan": _over("atan", lambda u, own: square_and(1.0, 1.0, u)),
    "asinh": _over("asinh", lambda u, own: root(square_and(1.0, 1.0, u))),
    "acosh": _over("acosh", lambda u, own: root(square_and(-1.0, 1.0, u))),
    "atanh": _over("atanh", lambda u, own: square_and(1.0, -1.0, u)),
    "atan2": _angle,
    "copy": lambda given, **_: given[0],
}


def evaluated(series: Sequence[Coefficient], time: jax.Array) -> jax.Array:
    """The polynomial with these coefficients, from the constant on, at a time."""
    total = series[-1]
    for term in series[-2::-1]:
        total = added(None if total is None else total * time, term)
    return jnp.zeros_like(time) if total is None else total
