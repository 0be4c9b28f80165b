"""Compute Taylor series of elementary functions of other series, one coefficient at a time.

The k-th coefficient of a function of u depends on the coefficients of u up to the k-th and on its own earlier ones
(Griewank and Walther, Evaluating Derivatives, chapter 13). Each sum of products is a separate stage, so that it is
computed once.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from ..compiled.compiler_hints import stage

Coefficient = Any  # lanes, a number, or None for zero


class Series:
    """Power series in t whose coefficients are computed on first access.

    Parameters
    ----------
    recurrence : callable or None
        Function from this series and k to the k-th coefficient, given the earlier ones. None if all coefficients but
        the first are zero.
    *initial : coefficient
        First coefficients.
    """

    def __init__(self, recurrence: Callable[["Series", int], Coefficient] | None, *initial: Coefficient) -> None:
        self.recurrence, self.coefficients = recurrence, list(initial)

    @property
    def is_constant(self) -> bool:
        """True if all coefficients but the first are zero."""
        return self.recurrence is None

    def __getitem__(self, k: int) -> Coefficient:
        if self.recurrence is None:
            return self.coefficients[0] if k == 0 else None
        while len(self.coefficients) <= k:
            self.coefficients.append(self.recurrence(self, len(self.coefficients)))
        return self.coefficients[k]


def sum_of_products(pairs, weights=None, addend=None, divisor=None):
    """Return (addend + sum of weight a b) / divisor over the pairs of which neither factor is zero."""
    weights = [1.0] * len(pairs) if weights is None else weights
    nonzero = [
        (*pair, weight) for pair, weight in zip(pairs, weights, strict=True) if not (pair[0] is None or pair[1] is None)
    ]
    if not nonzero and addend is None:
        return None
    left_factors, right_factors, weights = zip(*nonzero, strict=True) if nonzero else ((), (), ())
    return stage(_sum_of_products, left_factors, right_factors, addend, divisor, weights=tuple(map(float, weights)))


def _sum_of_products(left_factors, right_factors, addend, divisor, weights):
    total = addend
    for a, b, weight in zip(left_factors, right_factors, weights, strict=True):
        term = a * b if weight == 1.0 else weight * (a * b)
        total = term if total is None else total + term
    return total if divisor is None else total / divisor


def evaluate_constant(name, *operands):
    """Return the first coefficient of an operation of `jax.lax`."""
    return stage(_evaluate_constant, *(operand[0] for operand in operands), name=name)


def _evaluate_constant(*operands, name):
    shape = jnp.broadcast_shapes(*map(jnp.shape, operands))
    return getattr(lax, name)(*(jnp.broadcast_to(operand, shape) for operand in operands))


def scale_coefficient(number, a):
    """Return a multiple of a coefficient."""
    return None if a is None else number * a


def add_coefficients(a, b):
    """Return the sum of two coefficients."""
    return b if a is None else a if b is None else a + b


def add_series(a, b):
    """Return the sum of two series."""
    return Series(lambda series, k: add_coefficients(a[k], b[k]))


def subtract_series(a, b):
    """Return the difference of two series."""
    return Series(lambda series, k: add_coefficients(a[k], scale_coefficient(-1.0, b[k])))


def add_constant(number, a):
    """Return the series number + a."""
    return Series(lambda series, k: a[k] if k else add_coefficients(number, a[0]))


def scale_series(number, a):
    """Return a multiple of a series."""
    return Series(lambda series, k: scale_coefficient(number, a[k]))


def multiply_series(a, b):
    """Return the product of two series."""
    if a is b:
        return Series(lambda series, k: sum_of_products(*_square_pairs(a, k)))
    if a.is_constant or b.is_constant:
        constant, factor = (a, b) if a.is_constant else (b, a)
        return scale_series(constant[0], factor)
    return Series(lambda series, k: sum_of_products([(a[j], b[k - j]) for j in range(k + 1)]))


class Square(Series):
    """Square of a series; half-integer powers of it are powers of the series, also at its zeros."""

    def __init__(self, root: Series) -> None:
        super().__init__(lambda series, k: sum_of_products(*_square_pairs(root, k)))
        self.root = root


def _square_pairs(a, k):
    """Return (pairs, weights) of the k-th coefficient of a square."""
    pairs = [(a[j], a[k - j]) for j in range(k // 2 + 1)]
    return pairs, [1.0 if 2 * j == k else 2.0 for j in range(k // 2 + 1)]


def divide_series(a, b):
    """Return the quotient of two series."""
    if b.is_constant:
        return Series(lambda series, k: None if a[k] is None else a[k] / b[0])

    def recurrence(series, k):
        return sum_of_products([(b[j], series[k - j]) for j in range(1, k + 1)], [-1.0] * k, a[k], b[0])

    return Series(recurrence)


def integrate_rate(u, constant, rate):
    """Return y with y' = rate(y) u' and a given constant y_0."""

    def recurrence(series, k):
        rate_series = rate_of(series)
        return sum_of_products([(u[j], rate_series[k - j]) for j in range(1, k + 1)], [j / k for j in range(1, k + 1)])

    rate_of = _call_once(rate)
    return Series(recurrence, constant)


def integrate_weighted(u, constant, weight):
    """Return y with weight(y) y' = u' and a given constant y_0."""

    def recurrence(series, k):
        weight_series = weight_of(series)
        return sum_of_products(
            [(series[j], weight_series[k - j]) for j in range(1, k)],
            [-j / k for j in range(1, k)],
            u[k],
            weight_series[0],
        )

    weight_of = _call_once(weight)
    return Series(recurrence, constant)


def _call_once(function):
    """Return a function of one series that calls another at most once."""
    results: list[Series] = []

    def cached_call(series):
        if not results:
            results.append(function(series))
        return results[0]

    return cached_call


def power(u, exponent, constant):
    """Return u^exponent for a number or lanes, from u y' = exponent u' y."""

    def recurrence(series, k):
        pairs = [(u[j], series[k - j]) for j in range(1, k + 1)]
        rate_sum = sum_of_products(pairs, [j / k for j in range(1, k + 1)])
        return sum_of_products(
            pairs[:-1], [(j - k) / k for j in range(1, k)], scale_coefficient(exponent, rate_sum), u[0]
        )

    return Series(recurrence, constant)


def integer_power(u, exponent):
    """Return u^exponent for an integer by products, which holds at zeros of u as well."""
    if exponent < 0:
        return divide_series(Series(None, 1.0), integer_power(u, -exponent))
    if exponent < 2:
        return u if exponent else Series(None, jnp.ones_like(u[0]))
    half_power = integer_power(u, exponent // 2)
    square = multiply_series(half_power, half_power)
    return multiply_series(square, u) if exponent % 2 else square


def coupled_pair(u, names, sign):
    """Return (y, z) with y' = z u', z' = sign y u', given their names in `jax.lax`."""
    constants = [evaluate_constant(name, u) for name in names]
    pair: list[Series] = []
    pair.append(integrate_rate(u, constants[0], lambda series: pair[1]))
    pair.append(integrate_rate(u, constants[1], lambda series: scale_series(sign, pair[0])))
    return pair


def constant_plus_square(number, sign, u):
    """Return number + sign u^2."""
    return add_constant(number, scale_series(sign, multiply_series(u, u)))


def square_root(a):
    """Return the square root of a series."""
    if isinstance(a, Square):
        return a.root
    return power(a, 0.5, evaluate_constant("sqrt", a))


def exponential(u):
    """Return the exponential function of a series."""
    return integrate_rate(u, evaluate_constant("exp", u), lambda series: series)


def logarithm(u):
    """Return the logarithm of a series."""
    return integrate_weighted(u, evaluate_constant("log", u), lambda series: u)


def _rule_from_rate(name, rate):
    """Return the rule of an operation of `jax.lax` with y' = rate(u, y) u'."""
    return lambda operands, **_: integrate_rate(
        operands[0], evaluate_constant(name, operands[0]), lambda series: rate(operands[0], series)
    )


def _rule_from_weight(name, weight):
    """Return the rule of an operation of `jax.lax` with weight(u, y) y' = u'."""
    return lambda operands, **_: integrate_weighted(
        operands[0], evaluate_constant(name, operands[0]), lambda series: weight(operands[0], series)
    )


def _power_rule(operands, **_):
    """Return a power: by products for squares, by a recurrence for constant exponents, by exp and log otherwise."""
    base, exponent = operands
    n_halves = _count_halves(exponent) if isinstance(base, Square) else None
    if n_halves is not None:
        return integer_power(base.root, n_halves)
    if exponent.is_constant:
        return power(base, exponent[0], evaluate_constant("pow", base, exponent))
    return exponential(multiply_series(exponent, logarithm(base)))


def _count_halves(exponent):
    """Return twice an exponent if that is an integer constant of the force itself, and None otherwise."""
    is_known = exponent.is_constant and isinstance(exponent[0], float | np.floating | np.ndarray)
    twice_exponent = 2.0 * float(exponent[0]) if is_known else 0.5
    return int(twice_exponent) if twice_exponent.is_integer() else None


def _atan2_rule(operands, **_):
    """Return atan2(a, b) from (a^2 + b^2) y' = b a' - a b'."""
    a, b = operands
    radius_squared = add_series(multiply_series(a, a), multiply_series(b, b))

    def recurrence(series, k):
        plus_pairs, minus_pairs = (
            [(b[k - j], a[j]) for j in range(1, k + 1)],
            [(a[k - j], b[j]) for j in range(1, k + 1)],
        )
        weights = [j / k for j in range(1, k + 1)]
        numerator = sum_of_products(plus_pairs + minus_pairs, weights + [-weight for weight in weights])
        return sum_of_products(
            [(series[j], radius_squared[k - j]) for j in range(1, k)],
            [-j / k for j in range(1, k)],
            numerator,
            radius_squared[0],
        )

    return Series(recurrence, evaluate_constant("atan2", a, b))


def _pair_rule(names, index, sign):
    """Return the rule of one of two functions that are each other's derivatives up to sign."""
    return lambda operands, **_: coupled_pair(operands[0], names, sign)[index]


CIRCULAR, HYPERBOLIC = ("sin", "cos"), ("sinh", "cosh")
TWO_OVER_ROOT_PI = 2.0 / math.sqrt(math.pi)
RULES: dict[str, Callable[..., Series]] = {  # functions of the inputs of an operation and of its parameters
    "add": lambda operands, **_: add_series(*operands),
    "add_any": lambda operands, **_: add_series(*operands),
    "sub": lambda operands, **_: subtract_series(*operands),
    "mul": lambda operands, **_: multiply_series(*operands),
    "div": lambda operands, **_: divide_series(*operands),
    "neg": lambda operands, **_: scale_series(-1.0, operands[0]),
    "square": lambda operands, **_: multiply_series(operands[0], operands[0]),
    "integer_pow": lambda operands, y, **_: integer_power(operands[0], y),
    "pow": _power_rule,
    "sqrt": lambda operands, **_: square_root(operands[0]),
    "rsqrt": lambda operands, **_: power(operands[0], -0.5, evaluate_constant("rsqrt", operands[0])),
    "cbrt": lambda operands, **_: power(operands[0], 1.0 / 3.0, evaluate_constant("cbrt", operands[0])),
    "exp": lambda operands, **_: exponential(operands[0]),
    "exp2": lambda operands, **_: exponential(scale_series(math.log(2.0), operands[0])),
    "expm1": _rule_from_rate("expm1", lambda u, series: add_constant(1.0, series)),
    "log": lambda operands, **_: logarithm(operands[0]),
    "log1p": _rule_from_weight("log1p", lambda u, series: add_constant(1.0, u)),
    "sin": _pair_rule(CIRCULAR, 0, -1.0),
    "cos": _pair_rule(CIRCULAR, 1, -1.0),
    "sinh": _pair_rule(HYPERBOLIC, 0, 1.0),
    "cosh": _pair_rule(HYPERBOLIC, 1, 1.0),
    "tan": _rule_from_rate("tan", lambda u, series: constant_plus_square(1.0, 1.0, series)),
    "tanh": _rule_from_rate("tanh", lambda u, series: constant_plus_square(1.0, -1.0, series)),
    "logistic": _rule_from_rate("logistic", lambda u, series: subtract_series(series, multiply_series(series, series))),
    "erf": _rule_from_rate(
        "erf", lambda u, series: scale_series(TWO_OVER_ROOT_PI, exponential(scale_series(-1.0, multiply_series(u, u))))
    ),
    "erfc": _rule_from_rate(
        "erfc",
        lambda u, series: scale_series(-TWO_OVER_ROOT_PI, exponential(scale_series(-1.0, multiply_series(u, u)))),
    ),
    "asin": _rule_from_weight("asin", lambda u, series: square_root(constant_plus_square(1.0, -1.0, u))),
    "acos": _rule_from_weight(
        "acos", lambda u, series: scale_series(-1.0, square_root(constant_plus_square(1.0, -1.0, u)))
    ),
    "atan": _rule_from_weight("atan", lambda u, series: constant_plus_square(1.0, 1.0, u)),
    "asinh": _rule_from_weight("asinh", lambda u, series: square_root(constant_plus_square(1.0, 1.0, u))),
    "acosh": _rule_from_weight("acosh", lambda u, series: square_root(constant_plus_square(-1.0, 1.0, u))),
    "atanh": _rule_from_weight("atanh", lambda u, series: constant_plus_square(1.0, -1.0, u)),
    "atan2": _atan2_rule,
    "copy": lambda operands, **_: operands[0],
}


def evaluate_polynomial(coefficients: Sequence[Coefficient], time: jax.Array) -> jax.Array:
    """Evaluate a polynomial, given by its coefficients from the constant on."""
    total = coefficients[-1]
    for term in coefficients[-2::-1]:
        total = add_coefficients(None if total is None else total * time, term)
    return jnp.zeros_like(time) if total is None else total
