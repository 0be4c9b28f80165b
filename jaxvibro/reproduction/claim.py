"""A claim of the paper beside what was computed: the verdict follows from the numbers alone."""

import math
from dataclasses import dataclass, replace
from decimal import Decimal

AGREES = "agrees to its digits"
DIFFERS = "differs"
HOLDS = "holds"  # a claim in words
CANNOT_HOLD = "cannot hold"
UNDECIDED = "undecided"  # the error bar, or what stays unresolved, reaches over an edge of what is claimed


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
            return UNDECIDED if self.more else CANNOT_HOLD
        lower, upper = self.value - self.error, self.value + self.error + self.more
        if self.low <= lower and upper <= self.high:
            return AGREES if self.printed else HOLDS
        if upper < self.low or lower > self.high:
            return DIFFERS if self.printed else CANNOT_HOLD
        return UNDECIDED

    @property
    def is_right(self) -> bool:
        """Whether it agrees or holds."""
        return self.verdict in (AGREES, HOLDS)


def number_claim(figure, text, printed, result, reason=""):
    """The `Claim` that a number is what is printed, to half a unit of its last digit; result: (value, error)."""
    printed_value = Decimal(printed)
    half_unit = 0.5 * 10.0 ** printed_value.as_tuple().exponent
    return Claim(
        figure,
        text,
        printed,
        float(printed_value) - half_unit,
        float(printed_value) + half_unit,
        *result,
        reason + _truncation_note(printed_value, result[0]),
    )


def _truncation_note(printed_value, value):
    """What is to be said of a number whose digits are right but cut off in place of rounded."""
    digit_unit = 10.0 ** printed_value.as_tuple().exponent
    is_truncated = digit_unit * 0.5 < value - float(printed_value) < digit_unit
    return f" The digits printed are those of {value:.6g}, cut off and not rounded." if is_truncated else ""


def statement_claim(figure, text, result, low=-math.inf, high=math.inf, reason="", excess=0.0):
    """The `Claim` in words that a number lies between two; result: (value, error)."""
    return Claim(figure, text, "", low, high, *result, reason, excess)


def own_claim(figure, text, result, low=-math.inf, high=math.inf, reason="", excess=0.0):
    """The same of our own, that stands apart from the paper's."""
    return replace(statement_claim(figure, text, result, low, high, reason, excess), ours=True)


def computed_text(claim):
    """What was computed for a claim, with its error bar."""
    return value_text(claim.value, claim.error) + (", perhaps more" if claim.more else "")


def value_text(value, error):
    """A value with its error bar: as many digits as it bears, twelve at most."""
    if math.isnan(value):
        return "none"
    if error == 0.0 and float(value).is_integer():
        return f"{int(value)} (exact)"
    digits = 12 if error == 0.0 else min(12, max(1, 2 + _decimal_order(value) - _decimal_order(error)))
    return f"{value:.{digits}g} ± {error:.1g}"


def _decimal_order(value):
    return math.floor(math.log10(abs(value))) if value else 0
