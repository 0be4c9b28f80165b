"""A claim of the paper beside what was computed: the verdict follows from the numbers alone."""

import math
from dataclasses import dataclass, replace
from decimal import Decimal

AGREES = "agrees to its digits"
DIFFERS = "differs"
HOLDS = "holds"  # a claim in words
FALSE = "cannot hold"
OPEN = "undecided"  # the error bar, or what stays unresolved, reaches over an edge of what is claimed


@dataclass(frozen=True)
class Claim:
    """A claim: it is right where the computed value lies between two numbers.

    figure: of the paper; text: what is claimed; printed: its number as printed, "" for a claim in words; low, high:
    what the value may be; value, error: what was computed, nan where there is nothing of the kind; more: how much
    larger it may be for what stays unresolved; reason: of a difference; ours: whether the claim is our own, beside the
    paper's.
    """

    figure: str
    text: str
    printed: str
    low: float
    high: float
    value: float
    error: float
    reason: str = ""
    more: float = 0.0
    ours: bool = False

    @property
    def verdict(self) -> str:
        """A number agrees or differs, words hold or not; what does not exist cannot hold; else it is undecided."""
        if math.isnan(self.value):
            return OPEN if self.more else FALSE
        least, most = self.value - self.error, self.value + self.error + self.more
        if self.low <= least and most <= self.high:
            return AGREES if self.printed else HOLDS
        if most < self.low or least > self.high:
            return DIFFERS if self.printed else FALSE
        return OPEN

    @property
    def is_right(self) -> bool:
        """Whether it agrees or holds."""
        return self.verdict in (AGREES, HOLDS)


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


def statement(figure, text, found, low=-math.inf, high=math.inf, reason="", more=0.0):
    """The `Claim` in words that a number lies between two; found: (value, error)."""
    return Claim(figure, text, "", low, high, *found, reason, more)


def own(figure, text, found, low=-math.inf, high=math.inf, reason="", more=0.0):
    """The same of our own, that stands apart from the paper's."""
    return replace(statement(figure, text, found, low, high, reason, more), ours=True)


def judged(claim):
    """What was computed for a claim, with its error bar."""
    return told(claim.value, claim.error) + (", perhaps more" if claim.more else "")


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
