"""Compare claims of the paper with computed values, and write the report of all figures and claims."""

import base64
import html
import math
from collections import Counter
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


COLUMN_TITLES = ("figure", "claim", "printed", "computed", "verdict", "reason")
INTRODUCTION = (
    "Cheng and Xu, Periodic Motions, Bifurcation, and Hysteresis of the Vibro-Impact System, Mechanics Based Design of "
    "Structures and Machines 35(2), 2007, 179-203: figures and claims, recomputed. A verdict follows from the numbers "
    "beside it: a printed number agrees if the computed one lies within half a unit of its last digit; a claim in "
    "words holds if its number lies in the claimed range. Quotations follow our copy of the paper, a scan, in our own "
    "words."
)
TABLE_TITLES = (("The paper's claims", False), ("Our own rows", True))
CSS = """
body { font: 16px/1.5 sans-serif; max-width: 60em; margin: 2em auto; padding: 0 1em; color: #111; background: #fff; }
img { max-width: 100%; }
figure { margin: 2em 0; }
figcaption { color: #444; }
table { border-collapse: collapse; font-size: 14px; }
th, td { text-align: left; vertical-align: top; padding: 0.3em 0.6em; border-top: 1px solid #ccc; }
td.verdict { font-weight: bold; white-space: nowrap; }
"""


def claim_rows(claims):
    """Return a row of texts for each claim, in the order of `COLUMN_TITLES`; right claims have an empty reason."""
    return [
        (
            claim.figure,
            claim.text,
            claim.printed,
            computed_value_text(claim),
            claim.verdict,
            "" if claim.is_right else claim.reason.strip(),
        )
        for claim in claims
    ]


def verdict_counts_text(claims):
    """Return sentences with the number of claims per verdict: for the paper, and for the additional claims."""
    sentences = []
    for table_title, table_claims in _claims_by_table(claims):
        verdict_counts = Counter(claim.verdict for claim in table_claims)
        counts_text = ", ".join(f"{verdict}: {count}" for verdict, count in verdict_counts.items())
        sentences.append(f"{table_title}: {len(table_claims)} ({counts_text}).")
    return " ".join(sentences)


def _claims_by_table(claims):
    """Return (title, claims) of each table of claims that is not empty."""
    claims_by_title = [
        (table_title, [claim for claim in claims if claim.ours == is_additional])
        for table_title, is_additional in TABLE_TITLES
    ]
    return [(table_title, table_claims) for table_title, table_claims in claims_by_title if table_claims]


def report_html(titled_results):
    """Return the report as HTML; `titled_results` are (title, `figure_panels.FigureResult`) of each job."""
    claims = [claim for _, figure_result in titled_results for claim in figure_result.claims]
    html_tables = [_html_table(title, table_claims) for title, table_claims in _claims_by_table(claims)]
    html_figures = [
        _html_figure(title, figure_result) for title, figure_result in titled_results if figure_result.picture
    ]
    return "\n".join(
        [
            '<!doctype html>\n<html lang="en">\n<meta charset="utf-8">\n<title>The paper, recomputed</title>',
            f"<style>{CSS}</style>\n<h1>The paper, recomputed</h1>\n<p>{html.escape(INTRODUCTION)}</p>",
            *html_tables,
            "<h2>Figures</h2>",
            *html_figures,
            "</html>\n",
        ]
    )


def _html_table(table_title, claims):
    html_rows = [_html_row("th", COLUMN_TITLES), *(_html_row("td", row) for row in claim_rows(claims))]
    html_heading = f"<h2>{html.escape(table_title)}</h2>\n<p>{html.escape(verdict_counts_text(claims))}</p>"
    return "\n".join([html_heading, "<table>", *html_rows, "</table>"])


def _html_row(cell_tag, cell_texts):
    cell_attributes = [
        f' class="{column_title}"' if column_title == "verdict" else "" for column_title in COLUMN_TITLES
    ]
    return (
        "<tr>"
        + "".join(
            f"<{cell_tag}{cell_attribute}>{html.escape(cell_text)}</{cell_tag}>"
            for cell_attribute, cell_text in zip(cell_attributes, cell_texts, strict=True)
        )
        + "</tr>"
    )


def _html_figure(figure_title, figure_result):
    base64_picture = base64.b64encode(figure_result.picture).decode()
    figure_title, caption = html.escape(figure_title), html.escape(figure_result.caption)
    image_element = f'<img alt="{figure_title}" src="data:image/png;base64,{base64_picture}">'
    return f"<figure>\n<h3>{figure_title}</h3>\n{image_element}\n<figcaption>{caption}</figcaption>\n</figure>"


def report_markdown(report_entries):
    """Return the report as Markdown.

    `report_entries` are (title, name of the image file or None, `figure_panels.FigureResult`) of each job.
    """
    claims = [claim for *_, figure_result in report_entries for claim in figure_result.claims]
    markdown_lines = ["# The paper, recomputed", "", INTRODUCTION]
    for title, table_claims in _claims_by_table(claims):
        markdown_lines += [
            "",
            f"## {title}",
            "",
            verdict_counts_text(table_claims),
            "",
            _markdown_row(COLUMN_TITLES),
            _markdown_row(["---"] * len(COLUMN_TITLES)),
        ]
        markdown_lines += map(_markdown_row, claim_rows(table_claims))
    markdown_lines += ["", "## Figures"]
    for title, picture_file_name, figure_result in report_entries:
        if picture_file_name:
            markdown_lines += ["", f"### {title}", "", f"![{title}]({picture_file_name})", "", figure_result.caption]
    return "\n".join(markdown_lines) + "\n"


def _markdown_row(cell_texts):
    return "| " + " | ".join(cell_text.replace("|", "\\|") for cell_text in cell_texts) + " |"
