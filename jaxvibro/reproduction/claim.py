"""Compare claims of the paper with computed values; each verdict follows from the numbers alone."""

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
    """Claim, which is right if the computed value lies between two bounds.

    Attributes
    ----------
    figure : str
        Figure or equation of the paper.
    text : str
        Claim in words.
    printed : str
        Number as printed in the paper; "" for a claim in words.
    low : float
        Lower bound of the values for which the claim is right.
    high : float
        Upper bound of the values for which the claim is right.
    value : float
        Computed value; nan if the object of the claim does not exist.
    error : float
        Error bar of the value.
    reason : str
        Explanation of a difference from the paper.
    more : float
        Amount by which the true value may exceed `value` because of unresolved initial states.
    ours : bool
        True for an additional claim, which is not in the paper.
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

        A printed number agrees or differs. A claim in words holds or cannot hold. A claim about an object that does not
        exist cannot hold. A claim is undecided if the error bar or the unresolved states do not allow a verdict.
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


def number_claim(figure_label, claim_text, printed_number, value_and_error, reason=""):
    """Return the `Claim` that a computed number equals a printed number within half a unit of the last digit.

    `value_and_error` is the computed number as (value, error).
    """
    printed_value = Decimal(printed_number)
    half_last_digit = 0.5 * 10.0 ** printed_value.as_tuple().exponent
    return Claim(
        figure_label,
        claim_text,
        printed_number,
        float(printed_value) - half_last_digit,
        float(printed_value) + half_last_digit,
        *value_and_error,
        reason + _truncation_note(printed_value, value_and_error[0]),
    )


def _truncation_note(printed_value, computed_value):
    """Return a note if the printed digits are those of the computed number truncated, not rounded; else ""."""
    last_digit_unit = 10.0 ** printed_value.as_tuple().exponent
    is_truncated = last_digit_unit * 0.5 < computed_value - float(printed_value) < last_digit_unit
    return f" The printed digits are those of {computed_value:.6g}, cut off and not rounded." if is_truncated else ""


def statement_claim(
    figure_label, claim_text, value_and_error, low=-math.inf, high=math.inf, reason="", unresolved_allowance=0.0
):
    """Return the `Claim` in words that a computed number lies between two bounds.

    `value_and_error` is the computed number as (value, error). `unresolved_allowance` becomes the field `more` of the
    claim.
    """
    return Claim(figure_label, claim_text, "", low, high, *value_and_error, reason, unresolved_allowance)


def additional_claim(
    figure_label, claim_text, value_and_error, low=-math.inf, high=math.inf, reason="", unresolved_allowance=0.0
):
    """Return an additional `Claim`, which is not in the paper; the parameters are those of `statement_claim`."""
    return replace(
        statement_claim(figure_label, claim_text, value_and_error, low, high, reason, unresolved_allowance), ours=True
    )


def computed_value_text(claim):
    """Format the computed value of a claim with its error bar."""
    return value_error_text(claim.value, claim.error) + (", perhaps more" if claim.more else "")


def value_error_text(value, error):
    """Format a value with its error bar, to the digits that the error justifies and at most twelve."""
    if math.isnan(value):
        return "none"
    if error == 0.0 and float(value).is_integer():
        return f"{int(value)} (exact)"
    n_digits = 12 if error == 0.0 else min(12, max(1, 2 + _order_of_magnitude(value) - _order_of_magnitude(error)))
    return f"{value:.{n_digits}g} ± {error:.1g}"


def _order_of_magnitude(value):
    return math.floor(math.log10(abs(value))) if value else 0
