"""Pages that repeat what the code says: the conventions' codes, the public names."""

import re
from pathlib import Path

import jaxvibro as jv
from jaxvibro.scene.codes import Contact, Status

DOCS = Path(__file__).parents[1] / "docs"


def first_sentence(name):
    """The first paragraph of a public name's docstring, on one line."""
    return " ".join(getattr(jv, name).__doc__.split("\n\n")[0].split())


def test_the_codes_are_those_of_the_conventions():
    text = (DOCS / "conventions.md").read_text()
    statuses, contacts = (part.split("\n\n")[0] for part in re.split(r"`Impacts.status`|`State.contact`", text)[1:])
    assert re.findall(r"^\| (\d) \| (\w+)", statuses, re.M) == [(str(int(one)), one.name) for one in Status]
    kept = [one for one in Contact if one <= Contact.WITHIN]
    assert re.findall(r"^\| (-\d, \d) \| (\w+)", contacts, re.M) == [(f"-{one:d}, {one:d}", one.name) for one in kept]


def test_every_public_name_is_told():
    rows = re.findall(r"^\| `(\w+)` \| (.+) \|$", (DOCS / "api.md").read_text(), re.M)
    public = [name for name in jv.__all__ if name not in ("__version__", "plot")]
    assert rows == [(name, first_sentence(name).replace("|", "\\|")) for name in public]
