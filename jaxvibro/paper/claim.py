"""A claim of the paper beside what was computed: the verdict follows from the numbers alone."""

import math
from dataclasses import dataclass
from decimal import Decimal

AGREES = "agrees to its digits"
DIFFERS = "differs"
FALSE = "cannot hold"
OPEN = "undecided"  # the error bar reaches over an edge of what is claimed


@dataclass(frozen=True)
class Claim:
    """A claim: it is right where the computed value lies between two numbers.

    figure: of the paper; text: what is claimed; printed: its number as printed, "" for a claim in words; low, high:
    what the value may be; value, error: what was computed, nan where there is nothing of the kind; reason: of a
    difference.
    """

    figure: str
    text: str
    printed: str
    low: float
    high: float
    value: float
    error: float
    reason: str = ""

    @property
    def verdict(self):
        """One of four: the claim agrees, differs, cannot hold (in words, or of what does not exist), is undecided."""
        if math.isnan(self.value):
            return FALSE
        if self.low <= self.value - self.error and self.value + self.error <= self.high:
            return AGREES
        if self.value + self.error < self.low or self.value - self.error > self.high:
            return DIFFERS if self.printed else FALSE
        return OPEN


def number(figure, text, printed, found, reason=""):
    """The `Claim` that a number is what is printed, to half a unit of its last digit; found: (value, error)."""
    exact = Decimal(printed)
    half = 0.5 * 10.0 ** exact.as_tuple().exponent
    return Claim(
        figure, text, printed, float(exact) - half, float(exact) + half, *found, reason + _cut(exact, found[0])
    )


def _cut(exact, value):
    """What is to be said of a number whose digits are right but cut off in place of rounded."""
    unit = 10.0 ** exact.as_tuple().exponent
    cut = unit * 0.5 < value - float(exact) < unit
    return f" The digits printed are those of {value:.6g}, cut off and not rounded." if cut else ""


def statement(figure, text, found, low=-math.inf, high=math.inf, reason=""):
    """The `Claim` in words that a number lies between two; found: (value, error)."""
    return Claim(figure, text, "", low, high, *found, reason)


def told(value, error):
    """A value with its error bar: as many digits as it bears, twelve at most."""
    if math.isnan(value):
        return "none"
    if error == 0.0 and float(value).is_integer():
        return f"{int(value)} (exact)"
    digits = 12 if error == 0.0 else min(12, max(1, 2 + _order(value) - _order(error)))
    return f"{value:.{digits}g} ± {error:.1g}"


def _order(value):
    return math.floor(math.log10(abs(value))) if value else 0
