"""The pages: their code runs and prints what they show, links lead somewhere, and facts of the code are those of it."""

import contextlib
import io
import os
import re
import shlex
import subprocess
import sys

import matplotlib.pyplot as plt
import pytest

import jaxvibro as jv
from docs.site import api
from jaxvibro.branches.branch import KIND_NAMES
from jaxvibro.scene.state import Contact, Status
from jaxvibro.studies.command import _make_parser

from . import tiers
from .sources import PAGES, ROOT, page_blocks, table_rows

CODE = [name for name in PAGES if any(language == "python" for language, _, _ in page_blocks(name))]
NOTEBOOKS = sorted(path.name for path in (ROOT / "notebooks").glob("*.py"))
TARGETS = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
NUMBER = r"-?\d+(?:\.\d+)?(?:e-?\d+)?"
LABEL = re.compile(r"[A-Z][A-Z0-9]+(?:, [A-Z][A-Z0-9]+)*")  # monitors have labels of the user


def are_alike(expected, printed):
    """Return whether two texts have the same words, and numbers that differ by roundings at most."""
    numbers = [[float(number) for number in re.findall(NUMBER, text)] for text in (expected, printed)]
    words = [re.sub(NUMBER, "0", text).split() for text in (expected, printed)]
    return words[0] == words[1] and numbers[0] == pytest.approx(numbers[1], rel=1e-8, abs=1e-300)


def run_blocks(blocks, name):
    """Run the Python blocks of a page in order, compare what they print, and return the names that they define."""
    names, printed = {}, ""
    for language, text, before in blocks:
        if language == "python":
            with contextlib.redirect_stdout(io.StringIO()) as out:
                exec(compile(text, name, "exec"), names)
            printed = out.getvalue()
            plt.close("all")
        elif before.strip() == "prints":
            assert are_alike(text, printed), printed
    return names


@pytest.mark.parametrize("name", CODE)
def test_the_blocks_of_a_page_run_in_order_and_print_what_it_shows(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run_blocks(page_blocks(name), name)


def test_the_first_lines_of_the_readme_run():
    first = next(block for block in page_blocks("README.md") if block[0] == "python")
    names = run_blocks([first], "README.md")
    assert names["impacts"].status == 0 and names["orbit"].label == "P111"


@pytest.mark.parametrize("printed, is_right", [("SN 1.500000001e-3", True), ("SN 1.5001e-3", False), ("SN", False)])
def test_texts_are_compared_by_numbers_and_words(printed, is_right):
    with contextlib.nullcontext() if is_right else pytest.raises(AssertionError, match=printed):
        run_blocks([("python", f"print({printed!r})", ""), ("text", "SN  1.5e-3", "prints\n")], "a page")


def test_each_page_with_code_and_each_notebook_has_a_tier():
    """None of them may run on each push."""
    rows = tiers.table()["tests"]["test_pages"]
    listed = re.findall(r"\[(.+?)\]", " ".join(rows["ci"] + rows["release"]))
    assert sorted(listed) == sorted([*CODE, *NOTEBOOKS]) and NOTEBOOKS


@pytest.mark.parametrize("name", NOTEBOOKS)
def test_a_notebook_runs_and_draws(name, tmp_path):
    environment = os.environ | {"MPLBACKEND": "Agg", "PYTHONPATH": str(ROOT)}
    command = [sys.executable, str(ROOT / "notebooks" / name)]
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=900)
    assert done.returncode == 0, done.stderr
    assert list((tmp_path / "out").glob(f"{name[:2]}_*.png"))


def is_command(line):
    """Return whether a line of a page is a target of make, a call of the command line, an export, or empty."""
    words = shlex.split(line, comments=True)
    if words[:1] == ["make"]:
        return set(words[1:]) <= TARGETS
    if words and words[0].endswith("jaxvibro"):
        with contextlib.redirect_stderr(io.StringIO()), contextlib.suppress(SystemExit):
            return bool(_make_parser().parse_args(words[1:]))
    return words[:1] in ([], ["export"])


def test_commands_in_the_pages_exist():
    texts = [text for name in PAGES for language, text, _ in page_blocks(name) if language == "sh"]
    lines = "\n".join(texts).splitlines()
    assert len(lines) > 10 and [line for line in lines if not is_command(line)] == []
    assert not any(map(is_command, ("make no-target", "jaxvibro walk scene.toml", "rm -r out")))


def slug(heading):
    """Return the anchor that the site gives to a heading."""
    return re.sub(r"[^\w\- ]", "", heading.replace("`", "").lower()).replace(" ", "-")


def dead_links(page, text):
    """Return the links of a page to files or headings that do not exist."""
    for file, anchor in re.findall(r"\]\((?!https?:)([^)#]*)(?:#([^)]*))?\)", text):
        path = (ROOT / page).parent / file if file else ROOT / page
        linked = path.read_text("utf-8") if anchor and path.suffix == ".md" and path.exists() else ""
        anchors = [slug(heading) for heading in re.findall(r"^#+ (.+)$", linked, re.M)]
        if not path.exists() or (anchor and path.suffix == ".md" and anchor not in anchors):
            yield f"{page}: {file}#{anchor}"


def test_links_lead_to_files_and_headings():
    pages = [*PAGES, "CONTRIBUTING.md", "CHANGELOG.md"]
    assert [link for page in pages for link in dead_links(page, (ROOT / page).read_text("utf-8"))] == []
    text = "[a](no.md) [b](fit.md#no-heading) [c](fit.md) [d](https://a.b/c)"
    assert list(dead_links("docs/a.md", text)) == ["docs/a.md: no.md#", "docs/a.md: fit.md#no-heading"]


def test_each_task_names_a_page():
    text = (ROOT / "docs" / "tasks.md").read_text("utf-8")
    assert len(re.findall(r"^\| (.+?) \| \[.+\]\(([\w.]+)(?:#([\w-]+))?\).* \|$", text, re.M)) == 20


def test_the_codes_are_those_of_the_conventions():
    text = (ROOT / "docs" / "conventions.md").read_text("utf-8")
    tables = re.split(r"\| `Impacts.status`|\| `State.contact`", text)[1:]
    statuses, contacts = (table.split("\n\n")[0] for table in tables)
    assert re.findall(r"^\| (\d) \| (\w+)", statuses, re.M) == [(f"{code:d}", code.name) for code in Status]
    expected = [(f"-{code:d}, {code:d}", code.name) for code in Contact if code <= Contact.WITHIN]
    assert re.findall(r"^\| (-\d, \d) \| (\w+)", contacts, re.M) == expected


def test_the_list_of_public_names_is_that_of_the_docstrings():
    text = api.PAGE.read_text("utf-8")
    assert text == api.text(), "write it again: python -m docs.site.api"
    rows = re.findall(r"^\| `(\w+)` \| .+ \|$", text, re.M)
    assert sorted(rows) == sorted(name for name in jv.__all__ if name not in ("__version__", "plot"))


def wrong_terms(rows):
    """Return the rows (term, meaning, file) of the glossary whose file does not use the term, or without a meaning."""
    for term, meaning, code in rows:
        path = ROOT / "jaxvibro" / code.strip("`")
        source = path.read_text("utf-8") if re.fullmatch(r"`[\w/]+\.py`", code) and path.exists() else ""
        if len(meaning.split()) < 5 or not all(re.search(word[:5], source, re.IGNORECASE) for word in term.split()):
            yield term


def test_the_terms_of_the_glossary_are_in_order_and_used_in_their_files():
    rows = table_rows("docs/glossary.md", "Terms")
    terms = [term for term, *_ in rows]
    assert len(terms) >= 30 and terms == sorted(set(terms)) and list(wrong_terms(rows)) == []
    meaning = "a b c d e"
    wrong = [("margin", meaning, "`scene/scene.py`"), ("map", meaning, "`no.py`"), ("wall", "map", "`scene/scene.py`")]
    assert list(wrong_terms(wrong)) == ["margin", "map", "wall"]


def test_the_glossary_has_the_labels_of_the_code_and_complete_tables():
    columns = {"Terms": 3, "Notation for orbits": 5, "Special points": 5}
    tables = {heading: table_rows("docs/glossary.md", heading) for heading in columns}
    assert {heading: {len(row) for row in rows} for heading, rows in tables.items()} == {
        heading: {count} for heading, count in columns.items()
    }
    firsts = [row[0] for row in tables["Special points"]]
    labels = [label for first in firsts if LABEL.fullmatch(first) for label in first.split(", ")]
    assert len(labels) == len(set(labels)) and set(labels) == set(KIND_NAMES)
    (meaning,) = [meaning for term, meaning, _ in tables["Terms"] if term == "special point"]
    assert set(re.findall(r"[A-Z][A-Z0-9]+", meaning)) == set(KIND_NAMES)
