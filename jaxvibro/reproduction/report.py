"""The report: every figure, and every claim beside what was computed: a page that needs no other file, and a text."""

import base64
import html

from .claim import judged

HEAD = ("figure", "claim", "printed", "computed", "verdict", "reason")
INTRODUCTION = (
    "Cheng and Xu, Periodic Motions, Bifurcation, and Hysteresis of the Vibro-Impact System, Mechanics Based Design of "
    "Structures and Machines 35(2), 2007, 179-203: figures and claims, recomputed. A verdict follows from the numbers "
    "beside it: a printed number agrees where the computed one lies within half a unit of its last digit; a claim in "
    "words holds where the number that it speaks of lies where it says. What the paper says is as our copy reads, a "
    "scan, and in our own words."
)
TITLES = (("The paper's claims", False), ("Our own rows", True))
STYLE = """
body { font: 16px/1.5 sans-serif; max-width: 60em; margin: 2em auto; padding: 0 1em; color: #111; background: #fff; }
img { max-width: 100%; }
figure { margin: 2em 0; }
figcaption { color: #444; }
table { border-collapse: collapse; font-size: 14px; }
th, td { text-align: left; vertical-align: top; padding: 0.3em 0.6em; border-top: 1px solid #ccc; }
td.verdict { font-weight: bold; white-space: nowrap; }
"""


def rows(claims):
    """The claims as rows of texts, see HEAD; a reason only where the claim is not right."""
    return [
        (one.figure, one.text, one.printed, judged(one), one.verdict, "" if one.is_right else one.reason.strip())
        for one in claims
    ]


def counts(claims):
    """How many claims got which verdict, in a sentence on the paper's and one on our own."""
    parts = [(told, [one.verdict for one in claims if one.ours == ours]) for told, ours in TITLES]
    return " ".join(
        f"{told}: {len(found)} ({', '.join(f'{kind}: {found.count(kind)}' for kind in dict.fromkeys(found))})."
        for told, found in parts
        if found
    )


def _tables(claims):
    """(title, claims) of each table that has any."""
    parts = [(title, [one for one in claims if one.ours == ours]) for title, ours in TITLES]
    return [(title, found) for title, found in parts if found]


def page(parts):
    """The report as HTML. parts: (title, `panels.Drawn`) of each job."""
    claims = [claim for _, one in parts for claim in one.claims]
    tables = [_table(title, found) for title, found in _tables(claims)]
    figures = [_figure(title, one) for title, one in parts if one.picture]
    return "\n".join(
        [
            '<!doctype html>\n<html lang="en">\n<meta charset="utf-8">\n<title>The paper, recomputed</title>',
            f"<style>{STYLE}</style>\n<h1>The paper, recomputed</h1>\n<p>{html.escape(INTRODUCTION)}</p>",
            *tables,
            "<h2>Figures</h2>",
            *figures,
            "</html>\n",
        ]
    )


def _table(title, claims):
    cells = [_row("th", HEAD), *(_row("td", row) for row in rows(claims))]
    head = f"<h2>{html.escape(title)}</h2>\n<p>{html.escape(counts(claims))}</p>"
    return "\n".join([head, "<table>", *cells, "</table>"])


def _row(kind, texts):
    marks = [f' class="{name}"' if name == "verdict" else "" for name in HEAD]
    return (
        "<tr>" + "".join(f"<{kind}{m}>{html.escape(t)}</{kind}>" for m, t in zip(marks, texts, strict=True)) + "</tr>"
    )


def _figure(title, one):
    picture = base64.b64encode(one.picture).decode()
    title, caption = html.escape(title), html.escape(one.caption)
    image = f'<img alt="{title}" src="data:image/png;base64,{picture}">'
    return f"<figure>\n<h3>{title}</h3>\n{image}\n<figcaption>{caption}</figcaption>\n</figure>"


def text(parts):
    """The report as Markdown. parts: (title, name of the picture's file or None, `panels.Drawn`) of each job."""
    claims = [claim for *_, one in parts for claim in one.claims]
    lines = ["# The paper, recomputed", "", INTRODUCTION]
    for title, found in _tables(claims):
        lines += ["", f"## {title}", "", counts(found), "", _line(HEAD), _line(["---"] * len(HEAD))]
        lines += map(_line, rows(found))
    lines += ["", "## Figures"]
    for title, name, one in parts:
        if name:
            lines += ["", f"### {title}", "", f"![{title}]({name})", "", one.caption]
    return "\n".join(lines) + "\n"


def _line(texts):
    return "| " + " | ".join(each.replace("|", "\\|") for each in texts) + " |"
