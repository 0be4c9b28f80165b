"""Write docs/api.md, the list of public names with the first lines of their docstrings: `python -m docs.site.api`."""

import inspect
from pathlib import Path

from . import reference

PAGE = Path(__file__).parents[1] / "api.md"

HEAD = """\
# Public names

Public names by subject, each with the first lines of its docstring. `help(jv.follow)` shows the rest: parameters,
units, errors, examples. Names without a prefix belong to `import jaxvibro as jv`. [conventions.md](conventions.md)
states the conventions for signs, units and orders. `python -m docs.site.api` writes this page from the docstrings.
"""


def summary(dotted):
    """Return the first paragraph of a docstring on one line."""
    text = inspect.getdoc(reference.load(dotted)) or ""
    return " ".join(text.split("\n\n")[0].split())


def text():
    """Return the text of the page."""
    parts = [HEAD]
    for page, public in reference.names().items():
        rows = [f"| `{dotted.removeprefix('jaxvibro.')}` | {_cell(summary(dotted))} |\n" for dotted in public]
        parts.append(f"## {reference.SUBJECTS[page]}\n\n| name | summary |\n|---|---|\n{''.join(rows)}")
    return "\n".join(parts)


def _cell(line):
    return line.replace("|", "\\|")


if __name__ == "__main__":
    PAGE.write_text(text())
