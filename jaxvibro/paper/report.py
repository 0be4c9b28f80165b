"""The report: every figure, and every claim beside what was computed: a page that needs no other file, and a text."""

import base64
import html

from .claim import AGREES, told

HEAD = ("figure", "claim", "printed", "computed", "verdict", "reason")
INTRODUCTION = (
    "Cheng and Xu, Periodic Motions, Bifurcation, and Hysteresis of the Vibro-Impact System, Mechanics Based Design of "
    "Structures and Machines 35(2), 2007, 179-203: figures and claims, recomputed. A verdict follows from the numbers "
    "beside it: a printed number agrees where the computed one lies within half a unit of its last digit."
)
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
        (one.figure, one.text, one.printed, told(one.value, one.error), one.verdict, _reason(one)) for one in claims
    ]


def _reason(one):
    return "" if one.verdict == AGREES else one.reason.strip()


def counts(claims):
    """How many claims got which verdict, in a sentence."""
    verdicts = [one.verdict for one in claims]
    kinds = ", ".join(f"{kind}: {verdicts.count(kind)}" for kind in dict.fromkeys(verdicts))
    return f"{len(claims)} claims; {kinds}."


def page(parts):
    """The report as HTML. parts: (title, `panels.Drawn`) of each job."""
    claims = [claim for _, one in parts for claim in one.claims]
    cells = [_row("th", HEAD), *(_row("td", row) for row in rows(claims))]
    figures = [_figure(title, one) for title, one in parts if one.picture]
    return "\n".join(
        [
            '<!doctype html>\n<html lang="en">\n<meta charset="utf-8">\n<title>The paper, recomputed</title>',
            f"<style>{STYLE}</style>\n<h1>The paper, recomputed</h1>\n<p>{html.escape(INTRODUCTION)}</p>",
            f"<h2>Claims</h2>\n<p>{counts(claims)}</p>\n<table>",
            *cells,
            "</table>\n<h2>Figures</h2>",
            *figures,
            "</html>\n",
        ]
    )


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
    lines = ["# The paper, recomputed", "", INTRODUCTION, "", "## Claims", "", counts(claims), ""]
    lines += [_line(HEAD), _line(["---"] * len(HEAD)), *map(_line, rows(claims)), "", "## Figures"]
    for title, name, one in parts:
        if name:
            lines += ["", f"### {title}", "", f"![{title}]({name})", "", one.caption]
    return "\n".join(lines) + "\n"


def _line(texts):
    return "| " + " | ".join(each.replace("|", "\\|") for each in texts) + " |"
