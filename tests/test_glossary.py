"""The glossary: its words stand in order, once, and where it says."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
ROWS = re.findall(r"^\| ([^|]+) \| (.+) \(`([^`]+)`\) \|$", (ROOT / "docs" / "glossary.md").read_text(), re.MULTILINE)
# Words that had two meanings, or none that a reader would know: no file is called so, and no record.
OLD = {"along", "kept", "left", "told", "look", "brush", "dips", "graze", "carry", "lanes", "piece", "slopes"}


def test_words_stand_once_and_in_order():
    words = [word for word, _, _ in ROWS]
    assert words == sorted(set(words)) and 30 <= len(words) <= 50
    assert len(ROWS) == (ROOT / "docs" / "glossary.md").read_text().count("\n| ") - 1


@pytest.mark.parametrize("word,text,home", ROWS, ids=[row[0] for row in ROWS])
def test_a_word_is_used_where_the_glossary_says(word, text, home):
    source = (ROOT / "jaxvibro" / home).read_text()
    assert re.search(word[:5], source, re.IGNORECASE)
    assert len(text.split()) >= 5


def test_no_file_has_a_word_of_two_meanings():
    names = {path.stem for folder in ("jaxvibro", "continuation") for path in (ROOT / folder).rglob("*.py")}
    assert not names & OLD
