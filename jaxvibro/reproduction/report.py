"""Write the report of all figures and claims as a self-contained HTML page and as Markdown."""

import base64
import html

from .claim import computed_text

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
    """Return the claims as rows of texts in the order of `COLUMN_TITLES`; only wrong claims have a reason."""
    return [
        (
            claim.figure,
            claim.text,
            claim.printed,
            computed_text(claim),
            claim.verdict,
            "" if claim.is_right else claim.reason.strip(),
        )
        for claim in claims
    ]


def verdict_counts(claims):
    """Return the number of claims with each verdict, as a sentence on the paper and one on the additional claims."""
    parts = [(title, [claim.verdict for claim in claims if claim.ours == ours]) for title, ours in TABLE_TITLES]
    return " ".join(
        f"{title}: {len(verdicts)}"
        f" ({', '.join(f'{verdict}: {verdicts.count(verdict)}' for verdict in dict.fromkeys(verdicts))})."
        for title, verdicts in parts
        if verdicts
    )


def _claim_tables(claims):
    """Return (title, claims) of each table that is not empty."""
    parts = [(title, [claim for claim in claims if claim.ours == ours]) for title, ours in TABLE_TITLES]
    return [(title, table_claims) for title, table_claims in parts if table_claims]


def html_page(entries):
    """Return the report as HTML, from (title, `panels.FigureResult`) of each job."""
    claims = [claim for _, result in entries for claim in result.claims]
    tables = [_html_table(title, table_claims) for title, table_claims in _claim_tables(claims)]
    figures = [_html_figure(title, result) for title, result in entries if result.picture]
    return "\n".join(
        [
            '<!doctype html>\n<html lang="en">\n<meta charset="utf-8">\n<title>The paper, recomputed</title>',
            f"<style>{CSS}</style>\n<h1>The paper, recomputed</h1>\n<p>{html.escape(INTRODUCTION)}</p>",
            *tables,
            "<h2>Figures</h2>",
            *figures,
            "</html>\n",
        ]
    )


def _html_table(title, claims):
    html_rows = [_html_row("th", COLUMN_TITLES), *(_html_row("td", row) for row in claim_rows(claims))]
    heading = f"<h2>{html.escape(title)}</h2>\n<p>{html.escape(verdict_counts(claims))}</p>"
    return "\n".join([heading, "<table>", *html_rows, "</table>"])


def _html_row(tag, cells):
    attributes = [f' class="{column}"' if column == "verdict" else "" for column in COLUMN_TITLES]
    return (
        "<tr>"
        + "".join(
            f"<{tag}{attribute}>{html.escape(cell)}</{tag}>" for attribute, cell in zip(attributes, cells, strict=True)
        )
        + "</tr>"
    )


def _html_figure(title, result):
    picture = base64.b64encode(result.picture).decode()
    title, caption = html.escape(title), html.escape(result.caption)
    image = f'<img alt="{title}" src="data:image/png;base64,{picture}">'
    return f"<figure>\n<h3>{title}</h3>\n{image}\n<figcaption>{caption}</figcaption>\n</figure>"


def markdown_text(entries):
    """Return the report as Markdown, from (title, image file or None, `panels.FigureResult`) of each job."""
    claims = [claim for *_, result in entries for claim in result.claims]
    lines = ["# The paper, recomputed", "", INTRODUCTION]
    for title, table_claims in _claim_tables(claims):
        lines += [
            "",
            f"## {title}",
            "",
            verdict_counts(table_claims),
            "",
            _markdown_row(COLUMN_TITLES),
            _markdown_row(["---"] * len(COLUMN_TITLES)),
        ]
        lines += map(_markdown_row, claim_rows(table_claims))
    lines += ["", "## Figures"]
    for title, picture_name, result in entries:
        if picture_name:
            lines += ["", f"### {title}", "", f"![{title}]({picture_name})", "", result.caption]
    return "\n".join(lines) + "\n"


def _markdown_row(cells):
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"
