"""The page of results: only what is between two marks is written anew, the rest is kept as people wrote it."""

import os
import pathlib

# each part's name and, on a new page, its heading
PARTS = {
    "machine": "Where and when",
    "map": "The map, and other methods",
    "yardstick": "The map, and a hand-written kernel",
    "scenes": "What a scene needs",
    "derivatives": "Derivatives",
    "orbits": "Orbits",
    "branches": "Branches",
    "loci": "Loci",
    "first answers": "First answers",
    "soft walls": "Soft walls",
    "own force": "A force of one's own",
}
UNASKED = "(to be printed)"
COMMAND = "make bench"


def marks(part, command=COMMAND):
    """The marks between which a part of the page stands."""
    return f"<!-- {part}: begin (written by `{command}`, do not edit) -->", f"<!-- {part}: end -->"


def blank(title="Benchmarks", headings=PARTS, command=COMMAND):
    """A page without results. headings: {part: heading}; command: what writes it."""
    parts = ("## {}\n\n{}\n{}\n".format(heading, *marks(part, command)) for part, heading in headings.items())
    return "\n".join([f"# {title}\n", *parts])


def short(value):
    """A number to three digits, with thousands apart."""
    return f"{value:,.0f}" if abs(value) >= 100 else f"{value:.3g}"


def spread(values):
    """Median and quartiles as text, the median alone where they are the same."""
    median, low, high = map(short, values)
    return median if median == low == high else f"{median} ({low} to {high})"


def bound(row):
    """What is asked of a row, as text."""
    return UNASKED if row.asked is None else f"at {'least' if row.least else 'most'} {row.asked:,g}"


def asked_table(rows):
    """Rows as a table, in bold where what is asked is not kept."""
    lines = []
    for row in rows:
        number = "not measured" if row.found is None else spread(row.found)
        number = f"**{number}**" if row.kept is False else number
        lines.append((row.what, row.unit, bound(row), f"{number}, {row.remark}" if row.remark else number))
    return table(("what", "unit", "asked", "measured (quartiles)"), lines)


def table(head, lines):
    """Markdown of a head and lines of cells."""
    return "\n".join(f"| {' | '.join(map(str, cells))} |" for cells in (head, ["---"] * len(head), *lines))


def listed(lines):
    """Lines as a list."""
    return "\n".join(f"- {line}" for line in lines)


def body(topic):
    """A `Topic` in Markdown."""
    shown = [f"![{what}]({file})" for file, (what, _) in topic.pictures.items()]
    parts = *shown, asked_table(topic.rows) if topic.rows else "", *topic.tables, listed(topic.notes)
    return "\n\n".join(filter(None, parts))


def write(path, texts, new=None, command=COMMAND):
    """Put texts {part: Markdown} between the marks of the page at path, or of a new one; written beside, then renamed.
    new: that of another command than `make bench`.

    Raises ValueError where the page is there and has lost marks: nothing is overwritten then.
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
