"""The tools of the site: the reference, signatures, links, and notebooks; and the site is built without a warning."""

import os
import re
import subprocess
import sys
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import pytest
from jaxtyping import ArrayLike, Float, Real

import continuation
import jaxvibro as jv
from docs.site import autodoc, notebooks, pages, reference

from .sources import ROOT


def test_every_public_name_and_record_is_in_the_reference():
    text = "\n".join(reference.pages().values())
    directives = re.findall(r"^\.\. auto(?:function|class|exception):: ([\w.]+)$", text, re.MULTILINE)
    tables = re.findall(r"^   ~([\w.]+)$", text, re.MULTILINE)
    public = {f"jaxvibro.{name}" for name in jv._HOMES} | {f"jaxvibro.plot.{name}" for name in jv.plot.__all__}
    public |= {f"continuation.{name}" for name in continuation.__all__}
    assert sorted(directives) == sorted(tables) and len(set(directives)) == len(directives)
    assert public <= set(directives) and "jaxvibro.branches.branch.Special" in directives
    assert {"jaxvibro.Branch.table", "jaxvibro.Branch.points", "jaxvibro.Scene.dissipative"} <= reference.DOCUMENTED
    assert f"\n\n   {reference.EXAMPLES.splitlines()[0]}\n" in text


@pytest.mark.parametrize(
    "name, module, dotted",
    [
        ("follow", "jaxvibro", "jaxvibro.follow"),
        ("jv.follow", "jaxvibro.plot", "jaxvibro.follow"),
        ("branch", "jaxvibro.plot", "jaxvibro.plot.branch"),
        ("jv.plot.branch", "jaxvibro", "jaxvibro.plot.branch"),
        ("Branch", "jaxvibro.branches.branch", "jaxvibro.Branch"),
        ("Branch", "continuation", "continuation.Branch"),
        ("co.trace", "jaxvibro", "continuation.trace"),
        ("Branch.table", "jaxvibro", "jaxvibro.Branch.table"),
        ("Special.normal_form", "jaxvibro", "jaxvibro.branches.branch.Special.normal_form"),
        ("Special", "continuation", "continuation.Special"),
        ("fold", "jaxvibro", None),
        ("fit.md", "jaxvibro", None),
    ],
)
def test_short_names_lead_to_the_objects_of_their_package(name, module, dotted):
    assert reference.target(name, module) == dotted


def test_a_signature_is_the_one_that_the_source_writes():
    def call(orbit: jv.Orbit, gaps: Real[ArrayLike, "..."] = 0.0, *, stop: str = "") -> Float[np.ndarray, "*lanes"]:
        """Call."""

    text, returns = autodoc.signature(None, "function", "call", call, {}, "(orbit, gaps)", "")
    assert text == "(orbit: jv.Orbit, gaps: Real[ArrayLike, '...']=0.0, *, stop: str='')"
    assert returns == "Float[np.ndarray, '*lanes']"


def test_a_class_has_a_signature_if_users_construct_it(monkeypatch):
    @dataclass
    class Given:
        """Given.

        Parameters
        ----------
        position : float
            Position.
        """

        position: float
        names: dict[str, float] = field(default_factory=dict)
        static: int = field(default=1, metadata={"static": True})

    class Returned(NamedTuple):
        """Returned."""

        position: float

    monkeypatch.setattr(reference, "own_classes", lambda value: [value])
    text = autodoc.signature(None, "class", "Given", Given, {}, "", "")[0]
    assert text == "(position: float, names: dict[str, float] = dict(), static: int = 1)"
    assert autodoc.signature(None, "class", "Returned", Returned, {}, "(position)", "") == ("", "")
    assert autodoc.skip(None, "class", "position", Returned.position, False, {}) is True


def test_parameters_are_code_and_types_stand_beside_attributes():
    lines = ["See `orbit` and `Branch` of ``orbit``."]
    autodoc.docstring(None, "function", "follow", lambda orbit: orbit, {}, lines)
    assert lines == ["See ``orbit`` and `Branch` of ``orbit``."]
    lines = [".. attribute:: first, last", "", "   Indices.", "", "   :type: int", ""]
    autodoc.attributes(None, "class", "Segment", object, {}, lines)
    assert lines[:5] == [".. attribute:: first", 15 * " " + "last", "   :type: int", "", "   Indices."]


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


def test_the_site_is_built_without_a_warning(tmp_path):
    pages.write(tmp_path / "pages")
    build = [sys.executable, "-m", "sphinx", "--fail-on-warning", "--keep-going", "--quiet"]
    build += ["-c", str(ROOT / "docs" / "site"), str(tmp_path / "pages"), str(tmp_path / "html")]
    env = {name: value for name, value in os.environ.items() if name != "COVERAGE_PROCESS_START"}  # not recorded
    ended = subprocess.run(build, capture_output=True, text=True, timeout=300, env=env)
    assert (ended.returncode, ended.stderr) == (0, "")
    html = "".join(path.read_text() for path in (tmp_path / "html").rglob("*.html"))
    assert not re.search(r"(?:src|<link[^>]*href)=\"https?:", html)  # the files of a page lie beside it
    assert 'id="jaxvibro.Branch.table"' in html and "<math" in html
