"""Evaluate interval arithmetic, rounded outwards: each result holds for all real numbers in the input intervals.

Bounds are arrays over lanes. The product of 0 and an unbounded interval is 0, because no number is infinite. The result
of an unknown operation is unbounded. Arguments of roots and logarithms are taken as not negative, because a force is a
real number at every possible state. The result of a comparison may be wrong where both sides are equal.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

ERROR_ULPS = 8.0  # bound on the error of a NumPy function, in units in the last place
MAX_TRIG_ARGUMENT = 1e6  # for larger arguments the interval of sin and cos is [-1, 1]
PEAK_SLACK = 1e-9  # distance within which a peak of sin or cos counts as in the interval


class Interval(NamedTuple):
    """Interval of real numbers; the bounds are numbers or arrays over lanes."""

    lower: Any
    upper: Any


ENTIRE = Interval(-np.inf, np.inf)
BOOLEAN = Interval(0.0, 1.0)


def point_interval(value):
    """Return the interval of one number, or of each number of an array."""
    return Interval(value, value)


def hull(intervals):
    """Return the smallest interval that contains some intervals."""
    lowers, uppers = zip(*intervals, strict=True)
    lower, upper = lowers[0], uppers[0]
    for bound in lowers[1:]:
        lower = np.minimum(lower, bound)
    for bound in uppers[1:]:
        upper = np.maximum(upper, bound)
    return Interval(lower, upper)


def _round_down(value, is_exact):
    return np.where(is_exact, value, np.nextafter(value, -np.inf))


def _round_up(value, is_exact):
    return np.where(is_exact, value, np.nextafter(value, np.inf))


def add(a, b):
    with np.errstate(over="ignore"):
        lower, upper = np.add(a.lower, b.lower), np.add(a.upper, b.upper)
    is_exact = [
        (first == 0) | (second == 0) | (result == 0)
        for first, second, result in ((a.lower, b.lower, lower), (a.upper, b.upper, upper))
    ]
    return Interval(_round_down(lower, is_exact[0]), _round_up(upper, is_exact[1]))


def subtract(a, b):
    return add(a, negate(b))


def negate(a):
    return Interval(-a.upper, -a.lower)


def multiply(a, b):
    products = []
    for first in a:
        for second in b:
            with np.errstate(invalid="ignore", over="ignore"):
                value = np.where((first == 0) | (second == 0), 0.0, np.multiply(first, second))
            is_exact = (first == 0) | (second == 0) | (np.abs(first) == 1) | (np.abs(second) == 1)
            products.append(Interval(_round_down(value, is_exact), _round_up(value, is_exact)))
    return hull(products)


def reciprocal(a):
    """1 / a."""
    lower, upper = np.asarray(a.lower, float), np.asarray(a.upper, float)
    with np.errstate(divide="ignore", over="ignore"):
        new_lower, new_upper = 1.0 / np.where(upper == 0, -0.0, upper), 1.0 / np.where(lower == 0, 0.0, lower)
    contains_zero = (lower < 0) & (upper > 0) | (lower == 0) & (upper == 0)
    new_lower = _round_down(new_lower, (np.abs(upper) == 1) | np.isinf(upper))
    new_upper = _round_up(new_upper, (np.abs(lower) == 1) | np.isinf(lower))
    return Interval(np.where(contains_zero, -np.inf, new_lower), np.where(contains_zero, np.inf, new_upper))


def divide(a, b):
    return multiply(a, reciprocal(b))


def absolute(a):
    """Return ``|a|``."""
    lower = np.where((a.lower <= 0) & (a.upper >= 0), 0.0, np.minimum(np.abs(a.lower), np.abs(a.upper)))
    return Interval(lower, np.maximum(np.abs(a.lower), np.abs(a.upper)))


def integer_power(a, exponent):
    """Return a to an integer power."""
    if exponent < 0:
        return reciprocal(integer_power(a, -exponent))
    if exponent == 0:
        return point_interval(1.0)
    return _monotone_rule(lambda u: u**exponent)(absolute(a) if exponent % 2 == 0 else a)


def power(a, b):
    """Return ``a^b``; for a base that may be negative the exponent must be one integer in all lanes."""
    exponents = np.unique(np.stack(np.broadcast_arrays(*b)))
    if exponents.size == 1 and float(exponents[0]).is_integer() and abs(exponents[0]) < 2**31:
        return integer_power(a, int(exponents[0]))
    result, is_nonnegative = _exp_rule(multiply(b, _log_rule(a))), np.asarray(a.lower) >= 0
    return Interval(np.where(is_nonnegative, result.lower, -np.inf), np.where(is_nonnegative, result.upper, np.inf))


def _monotone_rule(function, minimum=-np.inf, maximum=np.inf, domain_start=-np.inf):
    """Return the rule of an increasing function with the given range and start of the domain."""

    def rule(a, **_):
        with np.errstate(all="ignore"):
            lower, upper = (
                _widen_value(function, np.maximum(bound, domain_start), sign)
                for bound, sign in zip(a, (-1, 1), strict=True)
            )
        return Interval(np.clip(lower, minimum, maximum), np.clip(upper, minimum, maximum))

    return rule


def _widen_value(function, bound, sign):
    """Return the value at a bound, moved outwards by the error of NumPy; exact values 0 and 1 stay."""
    value, max_float = np.asarray(function(np.asarray(bound, float))), np.finfo(float).max
    is_exact = ((value == 0) | (np.abs(value) == 1)) & ((value == bound) | np.isinf(bound)) | (
        np.isinf(value) & np.isinf(bound)
    )
    finite_value = np.clip(value, -max_float, max_float)
    return np.where(
        is_exact | (value == sign * np.inf), value, finite_value + sign * ERROR_ULPS * np.spacing(np.abs(finite_value))
    )


def _trig_rule(function, peak_phase, trough_phase):
    """Return the rule of sin or cos from the phases of its peaks and troughs."""

    def rule(a, **_):
        lower, upper = (
            np.clip(np.asarray(bound, float), -2.0 * MAX_TRIG_ARGUMENT, 2.0 * MAX_TRIG_ARGUMENT) for bound in a
        )
        bound_values = function(lower), function(upper)
        bounds = []
        for phase, sign in ((trough_phase, -1.0), (peak_phase, 1.0)):
            extremum = 2.0 * np.pi * np.ceil((lower - phase - PEAK_SLACK) / (2.0 * np.pi)) + phase
            end_extreme = np.maximum(*(sign * bound for bound in bound_values)) + ERROR_ULPS * np.finfo(float).eps
            has_extremum = (
                (extremum <= upper + PEAK_SLACK)
                | (np.abs(lower) > MAX_TRIG_ARGUMENT)
                | (np.abs(upper) > MAX_TRIG_ARGUMENT)
            )
            bounds.append(sign * np.where(has_extremum, 1.0, np.minimum(end_extreme, 1.0)))
        return Interval(*bounds)

    return rule


def _greater(a, b):
    """Return a > b as an interval within [0, 1]; the result for equal numbers is arbitrary."""
    always, never = a.lower >= b.upper, a.upper <= b.lower
    return Interval(np.where(always & ~never, 1.0, 0.0), np.where(never & ~always, 0.0, 1.0))


def _select(selector, cases):
    """Return the hull of some cases, or the selected one of two cases."""
    lower, upper = hull(cases)
    for condition, case in (
        ((selector.upper == 0, cases[0]), (selector.lower == 1, cases[1])) if len(cases) == 2 else ()
    ):
        lower, upper = np.where(condition, case.lower, lower), np.where(condition, case.upper, upper)
    return Interval(lower, upper)


def _logistic(u):
    return 1.0 / (1.0 + np.exp(-u))


_exp_rule, _log_rule = _monotone_rule(np.exp, 0.0), _monotone_rule(np.log, domain_start=0.0)
_sqrt_rule, _cosh_rule = _monotone_rule(np.sqrt, 0.0, domain_start=0.0), _monotone_rule(np.cosh, 1.0)
HALF_PI_UP = np.nextafter(np.pi / 2.0, 2.0)
OPERATION_RULES: dict[
    str, Callable[..., Interval]
] = {  # functions of the inputs of an operation, and of its parameters by name
    "add": lambda a, b, **_: add(a, b),
    "add_any": lambda a, b, **_: add(a, b),
    "sub": lambda a, b, **_: subtract(a, b),
    "mul": lambda a, b, **_: multiply(a, b),
    "div": lambda a, b, **_: divide(a, b),
    "neg": lambda a, **_: negate(a),
    "square": lambda a, **_: integer_power(a, 2),
    "integer_pow": lambda a, y, **_: integer_power(a, y),
    "pow": lambda a, b, **_: power(a, b),
    "sqrt": _sqrt_rule,
    "rsqrt": lambda a, **_: reciprocal(_sqrt_rule(a)),
    "cbrt": _monotone_rule(np.cbrt),
    "exp": _exp_rule,
    "exp2": _monotone_rule(np.exp2, 0.0),
    "expm1": _monotone_rule(np.expm1, -1.0),
    "log": _log_rule,
    "log1p": _monotone_rule(np.log1p, domain_start=-1.0),
    "sin": _trig_rule(np.sin, np.pi / 2.0, -np.pi / 2.0),
    "cos": _trig_rule(np.cos, 0.0, np.pi),
    "sinh": _monotone_rule(np.sinh),
    "cosh": lambda a, **_: _cosh_rule(absolute(a)),
    "tanh": _monotone_rule(np.tanh, -1.0, 1.0),
    "asinh": _monotone_rule(np.arcsinh),
    "atan": _monotone_rule(np.arctan, -HALF_PI_UP, HALF_PI_UP),
    "erf": _monotone_rule(np.vectorize(math.erf, otypes=[float]), -1.0, 1.0),
    "logistic": _monotone_rule(_logistic, 0.0, 1.0),
    "abs": lambda a, **_: absolute(a),
    "sign": lambda a, **_: Interval(np.sign(a.lower), np.sign(a.upper)),
    "max": lambda a, b, **_: Interval(np.maximum(a.lower, b.lower), np.maximum(a.upper, b.upper)),
    "min": lambda a, b, **_: Interval(np.minimum(a.lower, b.lower), np.minimum(a.upper, b.upper)),
    "select_n": lambda selector, *cases, **_: _select(selector, cases),
    "copy": lambda a, **_: a,
    "gt": lambda a, b, **_: _greater(a, b),
    "ge": lambda a, b, **_: _greater(a, b),
    "lt": lambda a, b, **_: _greater(b, a),
    "le": lambda a, b, **_: _greater(b, a),
    "convert_element_type": lambda a, **_: a,
}
DISCONTINUOUS = frozenset(["sign", "gt", "ge", "lt", "le", "select_n", "convert_element_type"])  # not continuous
