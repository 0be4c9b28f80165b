"""Compute Taylor series of elementary functions of other series, one coefficient at a time.

The k-th coefficient of a function of u depends on the coefficients of u up to the k-th and on the earlier coefficients
of the function (Griewank and Walther, Evaluating Derivatives, chapter 13). Each sum of products is computed once and
stored (`lane_arithmetic.call_without_inlining`).
"""

import math
from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import lax

from ..compiled.lane_arithmetic import call_without_inlining

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


def sum_of_products(factor_pairs, weights=None, addend=None, divisor=None):
    """Return (addend + sum of weight * product) / divisor over the pairs without a zero factor."""
    weights = [1.0] * len(factor_pairs) if weights is None else weights
    nonzero_pairs = [
        (*pair, pair_weight)
        for pair, pair_weight in zip(factor_pairs, weights, strict=True)
        if not (pair[0] is None or pair[1] is None)
    ]
    if not nonzero_pairs and addend is None:
        return None
    left_factors, right_factors, weights = zip(*nonzero_pairs, strict=True) if nonzero_pairs else ((), (), ())
    return call_without_inlining(
        _sum_of_products, left_factors, right_factors, addend, divisor, weights=tuple(map(float, weights))
    )


def _sum_of_products(left_factors, right_factors, addend, divisor, weights):
    partial_sum = addend
    for left_factor, right_factor, weight in zip(left_factors, right_factors, weights, strict=True):
        product = left_factor * right_factor if weight == 1.0 else weight * (left_factor * right_factor)
        partial_sum = product if partial_sum is None else partial_sum + product
    return partial_sum if divisor is None else partial_sum / divisor


def first_result_coefficient(name, *operands):
    """Return the first coefficient of the result of the operation `name` of `jax.lax` on series."""
    return call_without_inlining(_apply_lax_operation, *(operand[0] for operand in operands), name=name)


def _apply_lax_operation(*operands, name):
    shape = jnp.broadcast_shapes(*map(jnp.shape, operands))
    return getattr(lax, name)(*(jnp.broadcast_to(operand, shape) for operand in operands))


def scale_coefficient(factor, coefficient):
    """Return a multiple of a coefficient."""
    return None if coefficient is None else factor * coefficient


def add_coefficients(left_coefficient, right_coefficient):
    """Return the sum of two coefficients."""
    return (
        right_coefficient
        if left_coefficient is None
        else left_coefficient
        if right_coefficient is None
        else left_coefficient + right_coefficient
    )


def add_series(left_operand, right_operand):
    """Return the sum of two series."""
    return Series(lambda series, k: add_coefficients(left_operand[k], right_operand[k]))


def subtract_series(left_operand, right_operand):
    """Return the difference of two series."""
    return Series(lambda series, k: add_coefficients(left_operand[k], scale_coefficient(-1.0, right_operand[k])))


def add_constant(constant, operand):
    """Return the sum of a constant and a series."""
    return Series(lambda series, k: operand[k] if k else add_coefficients(constant, operand[0]))


def scale_series(factor, operand):
    """Return a multiple of a series."""
    return Series(lambda series, k: scale_coefficient(factor, operand[k]))


def multiply_series(left_operand, right_operand):
    """Return the product of two series."""
    if left_operand is right_operand:
        return Series(lambda series, k: sum_of_products(*_square_pairs(left_operand, k)))
    if left_operand.is_constant or right_operand.is_constant:
        constant_series, factor = (
            (left_operand, right_operand) if left_operand.is_constant else (right_operand, left_operand)
        )
        return scale_series(constant_series[0], factor)
    return Series(lambda series, k: sum_of_products([(left_operand[j], right_operand[k - j]) for j in range(k + 1)]))


class Square(Series):
    """Square of a series `root`.

    A half-integer power of the square is an integer power of the root, also at zeros.
    """

    def __init__(self, root: Series) -> None:
        super().__init__(lambda series, k: sum_of_products(*_square_pairs(root, k)))
        self.root = root


def _square_pairs(operand, k):
    """Return (pairs, weights) of the k-th coefficient of a square."""
    pairs = [(operand[j], operand[k - j]) for j in range(k // 2 + 1)]
    return pairs, [1.0 if 2 * j == k else 2.0 for j in range(k // 2 + 1)]


def divide_series(dividend, divisor):
    """Return the quotient of two series."""
    if divisor.is_constant:
        return Series(lambda series, k: None if dividend[k] is None else dividend[k] / divisor[0])

    def recurrence(series, k):
        return sum_of_products(
            [(divisor[j], series[k - j]) for j in range(1, k + 1)], [-1.0] * k, dividend[k], divisor[0]
        )

    return Series(recurrence)


def series_from_rate(argument, initial_value, rate_function):
    """Return the series y with y' = rate(y) u' and a given first coefficient, where u is the series `argument`."""

    def recurrence(series, k):
        rate_series = rate_of_series(series)
        return sum_of_products(
            [(argument[j], rate_series[k - j]) for j in range(1, k + 1)], [j / k for j in range(1, k + 1)]
        )

    rate_of_series = _always_first_result(rate_function)
    return Series(recurrence, initial_value)


def series_from_weight(argument, initial_value, weight_function):
    """Return the series y with weight(y) y' = u' and a given first coefficient, where u is the series `argument`."""

    def recurrence(series, k):
        weight_series = weight_of_series(series)
        return sum_of_products(
            [(series[j], weight_series[k - j]) for j in range(1, k)],
            [-j / k for j in range(1, k)],
            argument[k],
            weight_series[0],
        )

    weight_of_series = _always_first_result(weight_function)
    return Series(recurrence, initial_value)


def _always_first_result(function):
    """Return a function of a series that calls `function` once and then returns the first result."""
    cached_results: list[Series] = []

    def call_or_reuse(series):
        if not cached_results:
            cached_results.append(function(series))
        return cached_results[0]

    return call_or_reuse


def power_of_series(base, exponent, initial_value):
    """Return the series y = u^exponent of a series u, from u y' = exponent u' y.

    The exponent is a number or differs between lanes. The first coefficient of u must not be 0.
    """

    def recurrence(series, k):
        factor_pairs = [(base[j], series[k - j]) for j in range(1, k + 1)]
        base_rate_sum = sum_of_products(factor_pairs, [j / k for j in range(1, k + 1)])
        return sum_of_products(
            factor_pairs[:-1], [(j - k) / k for j in range(1, k)], scale_coefficient(exponent, base_rate_sum), base[0]
        )

    return Series(recurrence, initial_value)


def integer_power_of_series(base, exponent):
    """Return the series u^exponent for an integer exponent, by products that are also valid at zeros of u."""
    if exponent < 0:
        return divide_series(Series(None, 1.0), integer_power_of_series(base, -exponent))
    if exponent < 2:
        return base if exponent else Series(None, jnp.ones_like(base[0]))
    half_power = integer_power_of_series(base, exponent // 2)
    square = multiply_series(half_power, half_power)
    return multiply_series(square, base) if exponent % 2 else square


def coupled_pair(argument, function_names, sign):
    """Return the series (y, z) with y' = z u' and z' = sign y u', for two functions of u named as in `jax.lax`."""
    initial_values = [first_result_coefficient(function_name, argument) for function_name in function_names]
    coupled_series: list[Series] = []
    coupled_series.append(series_from_rate(argument, initial_values[0], lambda series: coupled_series[1]))
    coupled_series.append(
        series_from_rate(argument, initial_values[1], lambda series: scale_series(sign, coupled_series[0]))
    )
    return coupled_series


def constant_plus_square(constant, sign, argument):
    """Return the series constant + sign u^2 of a series u."""
    return add_constant(constant, scale_series(sign, multiply_series(argument, argument)))


def square_root_series(operand):
    """Return the square root of a series."""
    if isinstance(operand, Square):
        return operand.root
    return power_of_series(operand, 0.5, first_result_coefficient("sqrt", operand))


def exponential_series(argument):
    """Return the exponential function of a series."""
    return series_from_rate(argument, first_result_coefficient("exp", argument), lambda series: series)


def logarithm_series(argument):
    """Return the logarithm of a series."""
    return series_from_weight(argument, first_result_coefficient("log", argument), lambda series: argument)


def _rule_from_rate(operation_name, rate_function):
    """Return the rule of an operation of `jax.lax` with y' = rate(u, y) u'."""
    return lambda operands, **_: series_from_rate(
        operands[0],
        first_result_coefficient(operation_name, operands[0]),
        lambda series: rate_function(operands[0], series),
    )


def _rule_from_weight(operation_name, weight_function):
    """Return the rule for the series of an operation y of `jax.lax` with weight(u, y) y' = u'; u is its operand."""
    return lambda operands, **_: series_from_weight(
        operands[0],
        first_result_coefficient(operation_name, operands[0]),
        lambda series: weight_function(operands[0], series),
    )


def _power_rule(operands, **_):
    """Return the series of a base raised to an exponent, given both series.

    Half-integer powers of a `Square` are computed by products, powers with a constant exponent by a recurrence, and all
    other powers by exp and log.
    """
    base, exponent = operands
    root_exponent = _exponent_of_root(exponent) if isinstance(base, Square) else None
    if root_exponent is not None:
        return integer_power_of_series(base.root, root_exponent)
    if exponent.is_constant:
        return power_of_series(base, exponent[0], first_result_coefficient("pow", base, exponent))
    return exponential_series(multiply_series(exponent, logarithm_series(base)))


def _exponent_of_root(exponent):
    """Return twice an exponent that is a literal of the user-defined function if this is an integer, else None."""
    is_known_constant = exponent.is_constant and isinstance(exponent[0], float | np.floating | np.ndarray)
    twice_exponent = 2.0 * float(exponent[0]) if is_known_constant else 0.5
    return int(twice_exponent) if twice_exponent.is_integer() else None


def _atan2_rule(operands, **_):
    """Return y = atan2(a, b) for two series a and b, from (a^2 + b^2) y' = b a' - a b'."""
    ordinate_series, abscissa_series = operands
    radius_squared = add_series(
        multiply_series(ordinate_series, ordinate_series), multiply_series(abscissa_series, abscissa_series)
    )

    def recurrence(series, k):
        plus_pairs, minus_pairs = (
            [(abscissa_series[k - j], ordinate_series[j]) for j in range(1, k + 1)],
            [(ordinate_series[k - j], abscissa_series[j]) for j in range(1, k + 1)],
        )
        weights = [j / k for j in range(1, k + 1)]
        numerator = sum_of_products(plus_pairs + minus_pairs, weights + [-weight for weight in weights])
        return sum_of_products(
            [(series[j], radius_squared[k - j]) for j in range(1, k)],
            [-j / k for j in range(1, k)],
            numerator,
            radius_squared[0],
        )

    return Series(recurrence, first_result_coefficient("atan2", ordinate_series, abscissa_series))


def _pair_rule(function_names, index, sign):
    """Return the rule of one of two functions that are each other's derivatives up to sign."""
    return lambda operands, **_: coupled_pair(operands[0], function_names, sign)[index]


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
    "integer_pow": lambda operands, y, **_: integer_power_of_series(operands[0], y),
    "pow": _power_rule,
    "sqrt": lambda operands, **_: square_root_series(operands[0]),
    "rsqrt": lambda operands, **_: power_of_series(operands[0], -0.5, first_result_coefficient("rsqrt", operands[0])),
    "cbrt": lambda operands, **_: power_of_series(
        operands[0], 1.0 / 3.0, first_result_coefficient("cbrt", operands[0])
    ),
    "exp": lambda operands, **_: exponential_series(operands[0]),
    "exp2": lambda operands, **_: exponential_series(scale_series(math.log(2.0), operands[0])),
    "expm1": _rule_from_rate("expm1", lambda u, series: add_constant(1.0, series)),
    "log": lambda operands, **_: logarithm_series(operands[0]),
    "log1p": _rule_from_weight("log1p", lambda u, series: add_constant(1.0, u)),
    "sin": _pair_rule(CIRCULAR, 0, -1.0),
    "cos": _pair_rule(CIRCULAR, 1, -1.0),
    "sinh": _pair_rule(HYPERBOLIC, 0, 1.0),
    "cosh": _pair_rule(HYPERBOLIC, 1, 1.0),
    "tan": _rule_from_rate("tan", lambda u, series: constant_plus_square(1.0, 1.0, series)),
    "tanh": _rule_from_rate("tanh", lambda u, series: constant_plus_square(1.0, -1.0, series)),
    "logistic": _rule_from_rate("logistic", lambda u, series: subtract_series(series, multiply_series(series, series))),
    "erf": _rule_from_rate(
        "erf",
        lambda u, series: scale_series(TWO_OVER_ROOT_PI, exponential_series(scale_series(-1.0, multiply_series(u, u)))),
    ),
    "erfc": _rule_from_rate(
        "erfc",
        lambda u, series: scale_series(
            -TWO_OVER_ROOT_PI, exponential_series(scale_series(-1.0, multiply_series(u, u)))
        ),
    ),
    "asin": _rule_from_weight("asin", lambda u, series: square_root_series(constant_plus_square(1.0, -1.0, u))),
    "acos": _rule_from_weight(
        "acos", lambda u, series: scale_series(-1.0, square_root_series(constant_plus_square(1.0, -1.0, u)))
    ),
    "atan": _rule_from_weight("atan", lambda u, series: constant_plus_square(1.0, 1.0, u)),
    "asinh": _rule_from_weight("asinh", lambda u, series: square_root_series(constant_plus_square(1.0, 1.0, u))),
    "acosh": _rule_from_weight("acosh", lambda u, series: square_root_series(constant_plus_square(-1.0, 1.0, u))),
    "atanh": _rule_from_weight("atanh", lambda u, series: constant_plus_square(1.0, -1.0, u)),
    "atan2": _atan2_rule,
    "copy": lambda operands, **_: operands[0],
}
