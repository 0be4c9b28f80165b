"""Compare a claim of the paper with a computed value; the verdict follows from the numbers alone."""

import math
from dataclasses import dataclass, replace
from decimal import Decimal

AGREES = "agrees to its digits"
DIFFERS = "differs"
HOLDS = "holds"  # verdict on a claim in words
CANNOT_HOLD = "cannot hold"
UNDECIDED = "undecided"  # the error bar or unresolved states extend beyond the claimed range


@dataclass(frozen=True)
class Claim:
    """Claim of the paper, which is right if the computed value lies between two numbers.

    Attributes
    ----------
    figure : str
        Figure or equation of the paper.
    text : str
        Claim in words.
    printed : str
        Printed number; "" for a claim in words.
    low : float
        Lower bound of admissible values.
    high : float
        Upper bound of admissible values.
    value : float
        Computed value; nan if the object of the claim does not exist.
    error : float
        Error bar of the value.
    reason : str
        Explanation of a difference.
    more : float
        Amount by which the value may be larger because of unresolved initial states.
    ours : bool
        True for an additional claim that is not in the paper.
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
        """Verdict of the claim.

        A number agrees or differs, and a claim in words holds or cannot hold. A claim about something that does not
        exist cannot hold. All others are undecided.
        """
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
        """True if the claim agrees or holds."""
        return self.verdict in (AGREES, HOLDS)


def number_claim(figure, text, printed, result, reason=""):
    """Return the `Claim` that a number equals the printed one, within half a unit of its last digit.

    `result` is (value, error).
    """
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
    """Return the note on a printed number whose digits are truncated in place of rounded; "" for others."""
    digit_unit = 10.0 ** printed_value.as_tuple().exponent
    is_truncated = digit_unit * 0.5 < value - float(printed_value) < digit_unit
    return f" The printed digits are those of {value:.6g}, cut off and not rounded." if is_truncated else ""


def statement_claim(figure, text, result, low=-math.inf, high=math.inf, reason="", excess=0.0):
    """Return the `Claim` in words that a number lies between two bounds; `result` is (value, error)."""
    return Claim(figure, text, "", low, high, *result, reason, excess)


def own_claim(figure, text, result, low=-math.inf, high=math.inf, reason="", excess=0.0):
    """Return an additional `Claim` that is not in the paper."""
    return replace(statement_claim(figure, text, result, low, high, reason, excess), ours=True)


def computed_text(claim):
    """Return the computed value of a claim with its error bar as text."""
    return value_text(claim.value, claim.error) + (", perhaps more" if claim.more else "")


def value_text(value, error):
    """Return a value with its error bar, to the digits that the error justifies and at most twelve."""
    if math.isnan(value):
        return "none"
    if error == 0.0 and float(value).is_integer():
        return f"{int(value)} (exact)"
    digits = 12 if error == 0.0 else min(12, max(1, 2 + _decimal_order(value) - _decimal_order(error)))
    return f"{value:.{digits}g} ± {error:.1g}"


def _decimal_order(value):
    return math.floor(math.log10(abs(value))) if value else 0
