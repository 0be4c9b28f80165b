"""Interval arithmetic, rounded outwards: what is told of a result holds for all real numbers in the intervals given.

Numbers are lanes. 0 times what is unbounded is 0, as no number is infinite. Where an operation is not known anything
may come of it; a root or a logarithm is of what is not negative, as a force is a real number where the mass may be.
What is told of a comparison holds but where both are equal.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

ULPS = 8.0  # by so many a function of NumPy's may be off, of its size
FAR = 1e6  # beyond, sin and cos may be anything between -1 and 1
SLACK = 1e-9  # from a peak of sin and cos: as near it counts as in the interval


class Interval(NamedTuple):
    """All real numbers from low to high, which are lanes or numbers."""

    low: Any
    high: Any


ENTIRE = Interval(-np.inf, np.inf)
FLAG = Interval(0.0, 1.0)


def of(number):
    """The interval of one number, or of each of many."""
    return Interval(number, number)


def hull(intervals):
    """All from the least to the largest of some intervals."""
    lows, highs = zip(*intervals, strict=True)
    low, high = lows[0], highs[0]
    for other in lows[1:]:
        low = np.minimum(low, other)
    for other in highs[1:]:
        high = np.maximum(high, other)
    return Interval(low, high)


def _down(value, exact):
    return np.where(exact, value, np.nextafter(value, -np.inf))


def _up(value, exact):
    return np.where(exact, value, np.nextafter(value, np.inf))


def plus(a, b):
    with np.errstate(over="ignore"):
        low, high = np.add(a.low, b.low), np.add(a.high, b.high)
    clean = [(one == 0) | (two == 0) | (end == 0) for one, two, end in ((a.low, b.low, low), (a.high, b.high, high))]
    return Interval(_down(low, clean[0]), _up(high, clean[1]))


def minus(a, b):
    return plus(a, negative(b))


def negative(a):
    return Interval(-a.high, -a.low)


def times(a, b):
    ends = []
    for one in a:
        for two in b:
            with np.errstate(invalid="ignore", over="ignore"):
                value = np.where((one == 0) | (two == 0), 0.0, np.multiply(one, two))
            exact = (one == 0) | (two == 0) | (np.abs(one) == 1) | (np.abs(two) == 1)
            ends.append(Interval(_down(value, exact), _up(value, exact)))
    return hull(ends)


def inverse(a):
    """1 / a."""
    low, high = np.asarray(a.low, float), np.asarray(a.high, float)
    with np.errstate(divide="ignore", over="ignore"):
        first, last = 1.0 / np.where(high == 0, -0.0, high), 1.0 / np.where(low == 0, 0.0, low)
    across = (low < 0) & (high > 0) | (low == 0) & (high == 0)
    first = _down(first, (np.abs(high) == 1) | np.isinf(high))
    last = _up(last, (np.abs(low) == 1) | np.isinf(low))
    return Interval(np.where(across, -np.inf, first), np.where(across, np.inf, last))


def over(a, b):
    return times(a, inverse(b))


def size(a):
    """abs a."""
    least = np.where((a.low <= 0) & (a.high >= 0), 0.0, np.minimum(np.abs(a.low), np.abs(a.high)))
    return Interval(least, np.maximum(np.abs(a.low), np.abs(a.high)))


def whole_power(a, exponent):
    """a to a whole number."""
    if exponent < 0:
        return inverse(whole_power(a, -exponent))
    if exponent == 0:
        return of(1.0)
    return _rising(lambda u: u**exponent)(size(a) if exponent % 2 == 0 else a)


def power(a, b):
    """a^b; of what may be negative only to a power that is the same whole number in all lanes."""
    once = np.unique(np.stack(np.broadcast_arrays(*b)))
    if once.size == 1 and float(once[0]).is_integer() and abs(once[0]) < 2**31:
        return whole_power(a, int(once[0]))
    found, sure = _exp(times(b, _log(a))), np.asarray(a.low) >= 0
    return Interval(np.where(sure, found.low, -np.inf), np.where(sure, found.high, np.inf))


def _rising(function, least=-np.inf, largest=np.inf, start=-np.inf):
    """The rule of a function that grows: between these values, from a start on."""

    def rule(a, **_):
        with np.errstate(all="ignore"):
            low, high = (_padded(function, np.maximum(end, start), sign) for end, sign in zip(a, (-1, 1), strict=True))
        return Interval(np.clip(low, least, largest), np.clip(high, least, largest))

    return rule


def _padded(function, end, sign):
    """The value at an end, moved outwards by what NumPy may be off: not where it is 0 or 1 at 0, 1 or without bound."""
    value, last = np.asarray(function(np.asarray(end, float))), np.finfo(float).max
    exact = ((value == 0) | (np.abs(value) == 1)) & ((value == end) | np.isinf(end)) | (np.isinf(value) & np.isinf(end))
    within = np.clip(value, -last, last)
    return np.where(exact | (value == sign * np.inf), value, within + sign * ULPS * np.spacing(np.abs(within)))


def _turning(function, peak, trough):
    """The rule of sin or cos, whose peaks and troughs are at these phases."""

    def rule(a, **_):
        low, high = (np.clip(np.asarray(end, float), -2.0 * FAR, 2.0 * FAR) for end in a)
        ends = function(low), function(high)
        found = []
        for place, sign in ((trough, -1.0), (peak, 1.0)):
            turn = 2.0 * np.pi * np.ceil((low - place - SLACK) / (2.0 * np.pi)) + place
            best = np.maximum(*(sign * end for end in ends)) + ULPS * np.finfo(float).eps
            inside = (turn <= high + SLACK) | (np.abs(low) > FAR) | (np.abs(high) > FAR)
            found.append(sign * np.where(inside, 1.0, np.minimum(best, 1.0)))
        return Interval(*found)

    return rule


def _above(a, b):
    """Whether a > b within, 1 or 0, whatever it is where both are equal."""
    over, under = a.low >= b.high, a.high <= b.low
    return Interval(np.where(over & ~under, 1.0, 0.0), np.where(under & ~over, 0.0, 1.0))


def _chosen(which, cases):
    """One of some cases, by a flag where there are two."""
    low, high = hull(cases)
    for flag, case in ((which.high == 0, cases[0]), (which.low == 1, cases[1])) if len(cases) == 2 else ():
        low, high = np.where(flag, case.low, low), np.where(flag, case.high, high)
    return Interval(low, high)


def _logistic(u):
    return 1.0 / (1.0 + np.exp(-u))


_exp, _log = _rising(np.exp, 0.0), _rising(np.log, start=0.0)
_root, _even = _rising(np.sqrt, 0.0, start=0.0), _rising(np.cosh, 1.0)
RIGHT = np.nextafter(np.pi / 2.0, 2.0)
RULES: dict[str, Callable[..., Interval]] = {  # of an operation's inputs, and its parameters by name
    "add": lambda a, b, **_: plus(a, b),
    "add_any": lambda a, b, **_: plus(a, b),
    "sub": lambda a, b, **_: minus(a, b),
    "mul": lambda a, b, **_: times(a, b),
    "div": lambda a, b, **_: over(a, b),
    "neg": lambda a, **_: negative(a),
    "square": lambda a, **_: whole_power(a, 2),
    "integer_pow": lambda a, y, **_: whole_power(a, y),
    "pow": lambda a, b, **_: power(a, b),
    "sqrt": _root,
    "rsqrt": lambda a, **_: inverse(_root(a)),
    "cbrt": _rising(np.cbrt),
    "exp": _exp,
    "exp2": _rising(np.exp2, 0.0),
    "expm1": _rising(np.expm1, -1.0),
    "log": _log,
    "log1p": _rising(np.log1p, start=-1.0),
    "sin": _turning(np.sin, np.pi / 2.0, -np.pi / 2.0),
    "cos": _turning(np.cos, 0.0, np.pi),
    "sinh": _rising(np.sinh),
    "cosh": lambda a, **_: _even(size(a)),
    "tanh": _rising(np.tanh, -1.0, 1.0),
    "asinh": _rising(np.arcsinh),
    "atan": _rising(np.arctan, -RIGHT, RIGHT),
    "erf": _rising(np.vectorize(math.erf, otypes=[float]), -1.0, 1.0),
    "logistic": _rising(_logistic, 0.0, 1.0),
    "abs": lambda a, **_: size(a),
    "sign": lambda a, **_: Interval(np.sign(a.low), np.sign(a.high)),
    "max": lambda a, b, **_: Interval(np.maximum(a.low, b.low), np.maximum(a.high, b.high)),
    "min": lambda a, b, **_: Interval(np.minimum(a.low, b.low), np.minimum(a.high, b.high)),
    "select_n": lambda which, *cases, **_: _chosen(which, cases),
    "copy": lambda a, **_: a,
    "gt": lambda a, b, **_: _above(a, b),
    "ge": lambda a, b, **_: _above(a, b),
    "lt": lambda a, b, **_: _above(b, a),
    "le": lambda a, b, **_: _above(b, a),
    "convert_element_type": lambda a, **_: a,
}
JUMPS = frozenset(["sign", "gt", "ge", "lt", "le", "select_n", "convert_element_type"])  # not continuous
