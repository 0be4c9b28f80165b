"""Evaluate interval arithmetic, rounded outwards: each result holds for all real numbers in the input intervals.

Bounds are numbers or arrays over lanes. The product of 0 and an unbounded interval is 0, because no number is infinite.
Arguments of roots and logarithms are assumed not to be negative, because a force is a real number at every possible
state. The result of a comparison may be wrong for equal operands.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

ERROR_ULPS = 8.0  # bound on the error of a NumPy function, in units in the last place
MAX_TRIG_ARGUMENT = 1e6  # for larger arguments the interval of sin and cos is [-1, 1]
PEAK_SLACK = 1e-9  # distance within which a peak of sin or cos counts as in the interval


class Interval(NamedTuple):
    """Interval of real numbers.

    Attributes
    ----------
    lower : float or ndarray
        Lower bound, a number or an array over lanes.
    upper : float or ndarray
        Upper bound.
    """

    lower: Any
    upper: Any


ENTIRE = Interval(-np.inf, np.inf)
BOOLEAN = Interval(0.0, 1.0)


def point_interval(value):
    """Return the interval of one number, or of each number of an array."""
    return Interval(value, value)


def interval_hull(intervals):
    """Return the smallest interval that contains some intervals."""
    lower_bounds, upper_bounds = zip(*intervals, strict=True)
    lower, upper = lower_bounds[0], upper_bounds[0]
    for bound in lower_bounds[1:]:
        lower = np.minimum(lower, bound)
    for bound in upper_bounds[1:]:
        upper = np.maximum(upper, bound)
    return Interval(lower, upper)


def _round_down(value, is_exact):
    return np.where(is_exact, value, np.nextafter(value, -np.inf))


def _round_up(value, is_exact):
    return np.where(is_exact, value, np.nextafter(value, np.inf))


def add(left_interval, right_interval):
    with np.errstate(over="ignore"):
        lower, upper = (
            np.add(left_interval.lower, right_interval.lower),
            np.add(left_interval.upper, right_interval.upper),
        )
    is_exact = [
        (left_bound == 0) | (right_bound == 0) | (bound_sum == 0)
        for left_bound, right_bound, bound_sum in (
            (left_interval.lower, right_interval.lower, lower),
            (left_interval.upper, right_interval.upper, upper),
        )
    ]
    return Interval(_round_down(lower, is_exact[0]), _round_up(upper, is_exact[1]))


def subtract(left_interval, right_interval):
    return add(left_interval, negate(right_interval))


def negate(interval):
    return Interval(-interval.upper, -interval.lower)


def multiply(left_interval, right_interval):
    bound_products = []
    for left_bound in left_interval:
        for right_bound in right_interval:
            with np.errstate(invalid="ignore", over="ignore"):
                value = np.where((left_bound == 0) | (right_bound == 0), 0.0, np.multiply(left_bound, right_bound))
            is_exact = (left_bound == 0) | (right_bound == 0) | (np.abs(left_bound) == 1) | (np.abs(right_bound) == 1)
            bound_products.append(Interval(_round_down(value, is_exact), _round_up(value, is_exact)))
    return interval_hull(bound_products)


def reciprocal(interval):
    """Return the interval of ``1 / a`` for a in an interval."""
    lower, upper = np.asarray(interval.lower, float), np.asarray(interval.upper, float)
    with np.errstate(divide="ignore", over="ignore"):
        reciprocal_lower, reciprocal_upper = (
            1.0 / np.where(upper == 0, -0.0, upper),
            1.0 / np.where(lower == 0, 0.0, lower),
        )
    contains_zero = (lower < 0) & (upper > 0) | (lower == 0) & (upper == 0)
    reciprocal_lower = _round_down(reciprocal_lower, (np.abs(upper) == 1) | np.isinf(upper))
    reciprocal_upper = _round_up(reciprocal_upper, (np.abs(lower) == 1) | np.isinf(lower))
    return Interval(
        np.where(contains_zero, -np.inf, reciprocal_lower), np.where(contains_zero, np.inf, reciprocal_upper)
    )


def divide(numerator, denominator):
    return multiply(numerator, reciprocal(denominator))


def absolute(interval):
    """Return the interval of ``|a|`` for a in an interval."""
    lower = np.where(
        (interval.lower <= 0) & (interval.upper >= 0), 0.0, np.minimum(np.abs(interval.lower), np.abs(interval.upper))
    )
    return Interval(lower, np.maximum(np.abs(interval.lower), np.abs(interval.upper)))


def integer_power(base_interval, exponent):
    """Return the interval of ``a^exponent`` for a in an interval and an integer exponent."""
    if exponent < 0:
        return reciprocal(integer_power(base_interval, -exponent))
    if exponent == 0:
        return point_interval(1.0)
    return _make_monotone_rule(lambda u: u**exponent)(absolute(base_interval) if exponent % 2 == 0 else base_interval)


def power(base_interval, exponent_interval):
    """Return the interval of ``a^b``; unbounded for a base that may be negative, unless b is one known integer."""
    distinct_exponents = np.unique(np.stack(np.broadcast_arrays(*exponent_interval)))
    if (
        distinct_exponents.size == 1
        and float(distinct_exponents[0]).is_integer()
        and abs(distinct_exponents[0]) < 2**31
    ):
        return integer_power(base_interval, int(distinct_exponents[0]))
    result_interval, is_base_nonnegative = (
        _exp_rule(multiply(exponent_interval, _log_rule(base_interval))),
        np.asarray(base_interval.lower) >= 0,
    )
    return Interval(
        np.where(is_base_nonnegative, result_interval.lower, -np.inf),
        np.where(is_base_nonnegative, result_interval.upper, np.inf),
    )


def _make_monotone_rule(function, range_minimum=-np.inf, range_maximum=np.inf, domain_start=-np.inf):
    """Return the interval rule of an increasing function with a given range and a given start of its domain."""

    def apply_rule(interval, **_):
        with np.errstate(all="ignore"):
            lower, upper = (
                _round_value_outwards(function, np.maximum(bound, domain_start), outward_sign)
                for bound, outward_sign in zip(interval, (-1, 1), strict=True)
            )
        return Interval(np.clip(lower, range_minimum, range_maximum), np.clip(upper, range_minimum, range_maximum))

    return apply_rule


def _round_value_outwards(function, argument_bound, outward_sign):
    """Return a function value at a bound, moved outwards by the NumPy error bound; exact values are unchanged."""
    value, max_float = np.asarray(function(np.asarray(argument_bound, float))), np.finfo(float).max
    is_exact = ((value == 0) | (np.abs(value) == 1)) & ((value == argument_bound) | np.isinf(argument_bound)) | (
        np.isinf(value) & np.isinf(argument_bound)
    )
    finite_value = np.clip(value, -max_float, max_float)
    return np.where(
        is_exact | (value == outward_sign * np.inf),
        value,
        finite_value + outward_sign * ERROR_ULPS * np.spacing(np.abs(finite_value)),
    )


def _make_trig_rule(function, peak_phase, trough_phase):
    """Return the interval rule of sin or cos from the phases of its peaks and troughs."""

    def apply_rule(interval, **_):
        lower, upper = (
            np.clip(np.asarray(bound, float), -2.0 * MAX_TRIG_ARGUMENT, 2.0 * MAX_TRIG_ARGUMENT) for bound in interval
        )
        values_at_bounds = function(lower), function(upper)
        bounds = []
        for extremum_phase, extremum_sign in ((trough_phase, -1.0), (peak_phase, 1.0)):
            extremum_argument = (
                2.0 * np.pi * np.ceil((lower - extremum_phase - PEAK_SLACK) / (2.0 * np.pi)) + extremum_phase
            )
            extreme_at_bounds = (
                np.maximum(*(extremum_sign * bound for bound in values_at_bounds)) + ERROR_ULPS * np.finfo(float).eps
            )
            has_extremum = (
                (extremum_argument <= upper + PEAK_SLACK)
                | (np.abs(lower) > MAX_TRIG_ARGUMENT)
                | (np.abs(upper) > MAX_TRIG_ARGUMENT)
            )
            bounds.append(extremum_sign * np.where(has_extremum, 1.0, np.minimum(extreme_at_bounds, 1.0)))
        return Interval(*bounds)

    return apply_rule


def _compare_greater(left_interval, right_interval):
    """Return a > b as an interval within [0, 1]; the result for equal numbers is arbitrary."""
    is_always_greater, is_never_greater = (
        left_interval.lower >= right_interval.upper,
        left_interval.upper <= right_interval.lower,
    )
    return Interval(
        np.where(is_always_greater & ~is_never_greater, 1.0, 0.0),
        np.where(is_never_greater & ~is_always_greater, 0.0, 1.0),
    )


def _select_interval(selector_interval, case_intervals):
    """Return the hull of the cases, or the selected one of two cases in lanes in which the selector is certain."""
    lower, upper = interval_hull(case_intervals)
    for is_certainly_selected, case_interval in (
        ((selector_interval.upper == 0, case_intervals[0]), (selector_interval.lower == 1, case_intervals[1]))
        if len(case_intervals) == 2
        else ()
    ):
        lower, upper = (
            np.where(is_certainly_selected, case_interval.lower, lower),
            np.where(is_certainly_selected, case_interval.upper, upper),
        )
    return Interval(lower, upper)


def _logistic(argument):
    return 1.0 / (1.0 + np.exp(-argument))


_exp_rule, _log_rule = _make_monotone_rule(np.exp, 0.0), _make_monotone_rule(np.log, domain_start=0.0)
_sqrt_rule, _cosh_rule = _make_monotone_rule(np.sqrt, 0.0, domain_start=0.0), _make_monotone_rule(np.cosh, 1.0)
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
    "cbrt": _make_monotone_rule(np.cbrt),
    "exp": _exp_rule,
    "exp2": _make_monotone_rule(np.exp2, 0.0),
    "expm1": _make_monotone_rule(np.expm1, -1.0),
    "log": _log_rule,
    "log1p": _make_monotone_rule(np.log1p, domain_start=-1.0),
    "sin": _make_trig_rule(np.sin, np.pi / 2.0, -np.pi / 2.0),
    "cos": _make_trig_rule(np.cos, 0.0, np.pi),
    "sinh": _make_monotone_rule(np.sinh),
    "cosh": lambda a, **_: _cosh_rule(absolute(a)),
    "tanh": _make_monotone_rule(np.tanh, -1.0, 1.0),
    "asinh": _make_monotone_rule(np.arcsinh),
    "atan": _make_monotone_rule(np.arctan, -HALF_PI_UP, HALF_PI_UP),
    "erf": _make_monotone_rule(np.vectorize(math.erf, otypes=[float]), -1.0, 1.0),
    "logistic": _make_monotone_rule(_logistic, 0.0, 1.0),
    "abs": lambda a, **_: absolute(a),
    "sign": lambda a, **_: Interval(np.sign(a.lower), np.sign(a.upper)),
    "max": lambda a, b, **_: Interval(np.maximum(a.lower, b.lower), np.maximum(a.upper, b.upper)),
    "min": lambda a, b, **_: Interval(np.minimum(a.lower, b.lower), np.minimum(a.upper, b.upper)),
    "select_n": lambda selector, *cases, **_: _select_interval(selector, cases),
    "copy": lambda a, **_: a,
    "gt": lambda a, b, **_: _compare_greater(a, b),
    "ge": lambda a, b, **_: _compare_greater(a, b),
    "lt": lambda a, b, **_: _compare_greater(b, a),
    "le": lambda a, b, **_: _compare_greater(b, a),
    "convert_element_type": lambda a, **_: a,
}
DISCONTINUOUS = frozenset(["sign", "gt", "ge", "lt", "le", "select_n", "convert_element_type"])  # not continuous
