"""The terms of the glossary are in order, the files that it names use them, and its labels are those of the code."""

import re
from pathlib import Path

import pytest

from jaxvibro.branches.branch import KIND_NAMES

ROOT = Path(__file__).parents[1]
# Ambiguous words, which name no file.
AMBIGUOUS = {"along", "kept", "left", "told", "look", "brush", "dips", "graze", "carry", "lanes", "piece", "slopes"}
LABEL = re.compile(r"[A-Z][A-Z0-9]+(?:, [A-Z][A-Z0-9]+)*")  # monitors have labels of the user


def rows(heading):
    """Return the rows of the table below a heading: [cells]."""
    text = (ROOT / "docs" / "glossary.md").read_text()
    (section,) = re.findall(rf"^## {heading}\n(.*?)(?=^## |\Z)", text, re.MULTILINE | re.DOTALL)
    lines = re.findall(r"^\| (.+)\|$", section, re.MULTILINE)
    return [[cell.strip() for cell in line.split("|")] for line in lines[1:]]


TERMS = rows("Terms")


def test_terms_are_unique_and_in_alphabetical_order():
    terms = [term for term, *_ in TERMS]
    assert len(terms) >= 30 and terms == sorted(set(terms))


@pytest.mark.parametrize("term, meaning, code", TERMS, ids=[row[0] for row in TERMS])
def test_the_file_of_a_term_uses_it(term, meaning, code):
    assert re.fullmatch(r"`[\w/]+\.py`", code) and len(meaning.split()) >= 5
    source = (ROOT / "jaxvibro" / code.strip("`")).read_text()
    assert [word for word in term.split() if not re.search(word[:5], source, re.IGNORECASE)] == []


def test_the_labels_of_special_points_are_those_of_the_code():
    labels = [label for first, *_ in rows("Special points") if LABEL.fullmatch(first) for label in first.split(", ")]
    assert len(labels) == len(set(labels)) and set(labels) == set(KIND_NAMES)
    (meaning,) = [meaning for term, meaning, _ in TERMS if term == "special point"]
    assert set(re.findall(r"[A-Z][A-Z0-9]+", meaning)) == set(KIND_NAMES)


def test_tables_have_a_cell_for_each_column():
    columns = {"Terms": 3, "Notation for orbits": 5, "Special points": 5}
    assert all(len(row) == count for heading, count in columns.items() for row in rows(heading))


def test_no_file_has_an_ambiguous_name():
    names = {path.stem for folder in ("jaxvibro", "continuation") for path in (ROOT / folder).rglob("*.py")}
    assert not names & AMBIGUOUS
