"""Pages that repeat facts of the code: the codes in the conventions, the list of public names."""

import re
from pathlib import Path

import jaxvibro as jv
from docs.site import api
from jaxvibro.scene.codes import Contact, Status

DOCS = Path(__file__).parents[1] / "docs"


def test_the_codes_are_those_of_the_conventions():
    text = (DOCS / "conventions.md").read_text()
    statuses, contacts = (
        part.split("\n\n")[0] for part in re.split(r"\| `Impacts.status`|\| `State.contact`", text)[1:]
    )
    assert re.findall(r"^\| (\d) \| (\w+)", statuses, re.M) == [(str(int(one)), one.name) for one in Status]
    kept = [one for one in Contact if one <= Contact.WITHIN]
    assert re.findall(r"^\| (-\d, \d) \| (\w+)", contacts, re.M) == [(f"-{one:d}, {one:d}", one.name) for one in kept]


def test_the_list_of_public_names_has_the_first_lines_of_the_docstrings():
    assert api.PAGE.read_text() == api.text(), "write it anew: python -m docs.site.api"


def test_every_public_name_is_listed_once():
    rows = re.findall(r"^\| `(\w+)` \| .+ \|$", api.text(), re.M)
    assert sorted(rows) == sorted(name for name in jv.__all__ if name not in ("__version__", "plot"))


def slug(heading):
    """The anchor that the site gives to a heading."""
    return re.sub(r"[^\w\- ]", "", heading.replace("`", "").lower()).replace(" ", "-")


def test_each_task_names_a_page_and_a_heading():
    rows = re.findall(r"^\| (.+?) \| \[.+\]\(([\w.]+)(?:#([\w-]+))?\).* \|$", (DOCS / "tasks.md").read_text(), re.M)
    assert len(rows) == 20
    for _, page, anchor in rows:
        headings = {slug(heading) for heading in re.findall(r"^#+ (.+)$", (DOCS / page).read_text(), re.M)}
        assert not anchor or anchor in headings, (page, anchor)
