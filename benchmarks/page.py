"""The page of results: only what is between two marks is written anew, the rest is kept as people wrote it."""

import os
import pathlib

PARTS = ("measured", "soft walls measured")


def marks(part):
    """The marks between which a part of the page stands."""
    return f"<!-- {part}: begin (written by `make bench`, do not edit) -->", f"<!-- {part}: end -->"


EMPTY = "\n".join(["# Benchmarks\n", *("{}\n{}\n".format(*marks(part)) for part in PARTS)])
HEAD = (
    "| method | setting | ns per map (quartiles) | over ours (quartiles) | wrong itineraries "
    "| error: median | 99 % | worst | first call, s | states |\n" + "| --- " * 10 + "|"
)


def short(value):
    """A number to three digits, with thousands apart."""
    return f"{value:,.0f}" if value >= 100 else f"{value:.3g}"


def spread(values):
    """Median and quartiles as text."""
    median, low, high = map(short, values)
    return f"{median} ({low} to {high})"


def row(side, timing, verdict):
    """One line of the table; wrong itineraries in bold."""
    wrong = f"**{verdict.wrong}** of {verdict.judged}" if verdict.wrong else f"0 of {verdict.judged}"
    errors = " | ".join(f"{error:.1e}" for error in (verdict.median, verdict.high, verdict.worst))
    return (
        f"| {side.method} | {side.setting} | {spread(timing.cost)} | {spread(timing.ratio)} | {wrong} | {errors} "
        f"| {timing.first:.2f} | {side.states:,} |"
    )


def asked_table(asked):
    """Lines (what, asked, measured) as a table."""
    head = "| what | asked | measured (quartiles) |\n| --- | --- | --- |"
    return "\n".join([head, *(f"| {what} | {bound} | {measured} |" for what, bound, measured in asked)])


def table(rows):
    """Rows (side, timing, verdict) as a table."""
    return "\n".join([HEAD, *(row(*entry) for entry in rows)])


def body(picture, machine, asked, tables, notes):
    """A measured part of the page, in Markdown. picture: (what it shows, its file); machine, notes: lines."""
    parts = ("![{}]({})".format(*picture), listed(machine), asked_table(asked), *tables, listed(notes))
    return "\n\n".join(parts)


def listed(lines):
    """Lines as a list."""
    return "\n".join(f"- {line}" for line in lines)


def write(path, text, part):
    """Put text between the marks of a part of the page at path, or of a new page; written beside, then renamed.

    Raises ValueError where the page is there and has lost those marks: nothing is overwritten then.
    """
    begin, end = marks(part)
    path = pathlib.Path(path)
    page = path.read_text(encoding="utf-8") if path.exists() else EMPTY
    if page.count(begin) != 1 or page.count(end) != 1:
        raise ValueError(f"{path}: the marks {begin!r} and {end!r} must each be there once")
    head, rest = page.split(begin)
    tail = rest.split(end)[1]
    beside = path.with_suffix(".part.md")
    beside.write_text(f"{head}{begin}\n\n{text}\n\n{end}{tail}", encoding="utf-8")
    os.replace(beside, path)
