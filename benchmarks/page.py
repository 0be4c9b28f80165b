"""Write the results between marks of the page; the rest of the page is kept."""

import os
import pathlib

# Name of each part and, on a new page, its heading.
PARTS = {
    "machine": "Machine and date",
    "map": "Stroboscopic map: comparison with other methods",
    "yardstick": "Stroboscopic map: comparison with a hand-written kernel",
    "scenes": "Cost by kind of scene",
    "derivatives": "Derivatives",
    "orbits": "Orbits",
    "branches": "Branches",
    "loci": "Loci",
    "first answers": "First results of a fresh process",
    "soft walls": "Soft walls",
    "own force": "User-defined force",
}
UNASKED = "none"
COMMAND = "make bench"


def marks(part, command=COMMAND):
    """Return the marks around a part of the page."""
    return f"<!-- {part}: begin (written by `{command}`, do not edit) -->", f"<!-- {part}: end -->"


def blank(title="Benchmarks", headings=PARTS, command=COMMAND):
    """Make a page without results; `headings` are {part: heading}, `command` is the command that writes it."""
    parts = ("## {}\n\n{}\n{}\n".format(heading, *marks(part, command)) for part, heading in headings.items())
    return "\n".join([f"# {title}\n", *parts])


def short(value):
    """Format a number to three digits, with separated thousands."""
    return f"{value:,.0f}" if abs(value) >= 100 else f"{value:.3g}"


def spread(values):
    """Format median and quartiles, the median alone if they are equal."""
    median, low, high = map(short, values)
    return median if median == low == high else f"{median} ({low} to {high})"


def bound(row):
    """Format the required bound of a row."""
    return UNASKED if row.asked is None else f"at {'least' if row.least else 'most'} {row.asked:,g}"


def asked_table(rows):
    """Format rows as a table, in bold if a requirement is not met."""
    lines = []
    for row in rows:
        number = "not measured" if row.found is None else spread(row.found)
        number = f"**{number}**" if row.kept is False else number
        lines.append((row.what, row.unit, bound(row), f"{number}, {row.remark}" if row.remark else number))
    return table(("quantity", "unit", "target", "measured (quartiles)"), lines)


def table(head, lines):
    """Format a head and lines of cells as Markdown."""
    return "\n".join(f"| {' | '.join(map(str, cells))} |" for cells in (head, ["---"] * len(head), *lines))


def listed(lines):
    """Format lines as a list."""
    return "\n".join(f"- {line}" for line in lines)


def body(topic):
    """Format a `Topic` as Markdown."""
    shown = [f"![{what}]({file})" for file, (what, _) in topic.pictures.items()]
    parts = *shown, asked_table(topic.rows) if topic.rows else "", *topic.tables, listed(topic.notes)
    return "\n\n".join(filter(None, parts))


def write(path, texts, new=None, command=COMMAND):
    """Write texts {part: Markdown} between the marks of the page at `path`, or of a new page.

    The page is written under a temporary name and renamed.

    `new` is the new page of a command other than `make bench`. Raises ValueError if the page exists and lacks marks;
    nothing is overwritten then.
    """
    path = pathlib.Path(path)
    page = path.read_text(encoding="utf-8") if path.exists() else new or blank()
    for part, text in texts.items():
        begin, end = marks(part, command)
        if page.count(begin) != 1 or page.count(end) != 1:
            raise ValueError(f"{path}: the marks {begin!r} and {end!r} must each be there once")
        head, rest = page.split(begin)
        page = f"{head}{begin}\n\n{text}\n\n{end}{rest.split(end)[1]}"
    beside = path.with_suffix(".part.md")
    beside.write_text(page, encoding="utf-8")
    os.replace(beside, path)
