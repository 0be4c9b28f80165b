"""The site: all public names are in the reference, all blocks of Python in the pages run, and links lead somewhere."""

import contextlib
import io
import re
import shlex
import subprocess
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import pytest

import continuation
import jaxvibro as jv
from docs.site import notebooks, pages, reference
from jaxvibro.studies import command

ROOT = Path(__file__).parents[1]
TEXTS = ["README.md", *sorted(f"docs/{path.name}" for path in (ROOT / "docs").glob("*.md"))]
BLOCK = re.compile(r"^```(\w*)\n(.*?)^```$", re.DOTALL | re.MULTILINE)

LONG = ["branches", "design", "fit", "force", "gradients", "loci", "motions", "resilience", "soft", "units"]
LONGEST = ["README.md", *(f"docs/{name}.md" for name in LONG)]


def blocks(name):
    """The blocks of a page: [(language, text, what stands between it and the one before)]."""
    text, end, found = (ROOT / name).read_text(), 0, []
    for match in BLOCK.finditer(text):
        found.append((*match.groups(), text[end : match.start()]))
        end = match.end()
    return found


def same(told, printed):
    """Whether two texts have the same words, and numbers that differ by roundings at most."""
    return len(told.split()) == len(printed.split()) and all(map(_same, told.split(), printed.split()))


def _same(told, printed):
    numbers = r"-?\d+(?:\.\d+)?(?:e-?\d+)?"
    one, other = re.findall(numbers, told), re.findall(numbers, printed)
    close = [float(a) == pytest.approx(float(b), rel=1e-8, abs=1e-300) for a, b in zip(one, other, strict=False)]
    return len(one) == len(other) and all(close) and re.sub(numbers, "", told) == re.sub(numbers, "", printed)


MARKED = [
    pytest.param(name, marks=pytest.mark.long if name in LONGEST else pytest.mark.slow)
    for name in TEXTS
    if any(language == "python" for language, _, _ in blocks(name))
]


@pytest.mark.parametrize("name", MARKED)
def test_the_blocks_of_a_page_run_in_order_and_print_what_is_told(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names, printed = {}, ""
    for language, text, before in blocks(name):
        if language == "python":
            out = io.StringIO()
            with contextlib.redirect_stdout(out):
                exec(compile(text, name, "exec"), names)
            printed = out.getvalue()
            plt.close("all")
        elif before.strip() == "prints":
            assert same(text, printed), printed


def test_the_first_lines_of_the_readme_run():
    names = {}
    exec(
        compile(next(text for language, text, _ in blocks("README.md") if language == "python"), "README.md", "exec"),
        names,
    )
    plt.close("all")
    assert names["impacts"].status == 0 and names["orbit"].label == "P111"


def test_commands_in_the_pages_are_such():
    targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    shell = [text for name in TEXTS for language, text, _ in blocks(name) if language == "sh"]
    lines = "\n".join(shell).splitlines()
    words = [shlex.split(line, comments=True) for line in lines]
    for called in words:
        if called[:1] == ["make"]:
            assert set(called[1:]) <= targets
        elif called and called[0].endswith("jaxvibro"):
            command._parser().parse_args(called[1:])
        else:
            assert called[:1] in ([], ["export"]), called
    assert len(words) > 10


def test_every_public_name_is_in_the_reference():
    text = "\n".join(reference.pages().values())
    heads = set(re.findall(r"^`+\{py:\w+\} ([\w.]+)", text, re.MULTILINE))
    public = {*jv._HOMES, *(f"plot.{name}" for name in jv.plot.__all__), *continuation.__all__}
    assert public <= heads and {"Branch.table", "Branch.points", "Scene.dissipative", "Special.normal_form"} <= heads


def test_a_name_without_a_docstring_stops_the_reference():
    def nothing():
        pass

    with pytest.raises(reference.Untold, match="nothing"):
        reference._entry("jaxvibro", "nothing", nothing)


def test_arguments_become_a_list_and_public_names_lead_to_theirs():
    told = reference.prose(
        "A `Scene` of x_b.\n\nscene: a `Scene`; left, right: walls. It ends.", ["scene", "left", "right"]
    )
    assert told == (
        "A {py:obj}`Scene <jaxvibro.Scene>` of x\\_b.\n\n"
        "- **scene**: a {py:obj}`Scene <jaxvibro.Scene>`\n- **left, right**: walls. It ends."
    )


def test_a_record_of_continuation_is_not_ours_of_the_same_name():
    page = reference.pages()["continuation.md"]
    assert "<continuation.Branch>" in page and "<jaxvibro.Branch>" not in page


@pytest.mark.parametrize(
    "printed, alike", [("SN 1.500000001e-3, P111", True), ("SN 1.5001e-3, P111", False), ("SN", False)]
)
def test_what_is_printed_is_compared_by_numbers_and_words(printed, alike):
    assert same("SN  1.5e-3, P111", printed) is alike


def test_links_to_notebooks_lead_to_their_pages_and_code_is_left_alone():
    code = "```python\n`jv.follow`\n```\n"
    text = "[one](../notebooks/08_margin_and_design.py) [fit.md](fit.md#samples) `jv.follow(orbit)` `fold` `locus`\n"
    assert pages.linked(text + code) == (
        "[one](../notebooks/08_margin_and_design.md) [](fit.md#samples) {py:obj}`jv.follow(orbit) <jaxvibro.follow>` "
        "`fold` {py:obj}`locus <jaxvibro.locus>`\n" + code
    )


def test_a_notebook_is_shown_with_what_it_printed_while_its_cells_are_the_same(tmp_path, monkeypatch):
    monkeypatch.setattr(notebooks, "KEPT", tmp_path / "kept")
    script = tmp_path / "00_one.py"
    script.write_text("# ---\n# head\n# ---\n\n# %% [markdown]\n# # One\n#\n# Text.\n\n# %%\nx = 2\nprint(x + 1)\n")
    notebooks.run(script)
    text, fresh = notebooks.page(script)
    assert fresh and "# One" in text and "Text." in text and "```text\n3\n```" in text
    script.write_text(script.read_text() + "print(x)\n")
    text, fresh = notebooks.page(script)
    assert not fresh and "```text" not in text and "make notebooks" in text


@pytest.mark.parametrize("page", [*TEXTS, "CONTRIBUTING.md", "CHANGELOG.md"])
def test_links_lead_somewhere(page):
    path = ROOT / page
    links = re.findall(r"\]\((?!https?:)([^)#]+)(?:#[^)]*)?\)", path.read_text())
    assert [link for link in links if not (path.parent / link).exists()] == []


@pytest.mark.slow
def test_the_site_is_built_without_a_warning(tmp_path):
    pages.write(tmp_path / "pages")
    build = [sys.executable, "-m", "sphinx", "--fail-on-warning", "--keep-going", "--quiet"]
    build += ["-c", str(ROOT / "docs" / "site"), str(tmp_path / "pages"), str(tmp_path / "html")]
    ended = subprocess.run(build, capture_output=True, text=True, timeout=300)
    assert (ended.returncode, ended.stderr) == (0, "")
    told = "".join(path.read_text() for path in (tmp_path / "html").rglob("*.html"))
    assert not re.search(r"(?:src|<link[^>]*href)=\"https?:", told)  # what a page itself needs lies beside it
    assert 'id="jaxvibro.Branch.table"' in told and "<math" in told
