"""Write the pages of the site into a folder for Sphinx: `python -m docs.site.pages FOLDER`.

The folder has the layout of the repository, so that links between pages hold in both. A notebook is a page beside its
script. The pages of the API reference contain directives only; autodoc reads the docstrings.
"""

import re
import shutil
import sys
from pathlib import Path

from . import notebooks, reference

ROOT = Path(__file__).parents[2]
SITE = ROOT / "docs" / "site"


def write(folder):
    """Write all pages into an empty folder and return the names of the notebooks without outputs."""
    shutil.rmtree(folder, ignore_errors=True)
    for path in [*ROOT.glob("docs/*.md"), ROOT / "CONTRIBUTING.md", ROOT / "CHANGELOG.md"]:
        _put(folder / path.relative_to(ROOT), linked(path.read_text()))
    for path in [*ROOT.glob("docs/*.png"), *ROOT.glob("docs/notebooks/*.png"), *ROOT.glob("scenes/*.toml")]:
        _copy(path, folder / path.relative_to(ROOT))
    for name in ("CITATION.cff", "LICENSE"):
        _copy(ROOT / name, folder / name)
    _put(folder / "index.md", (SITE / "index.md").read_text())
    for name, text in reference.pages().items():
        _put(folder / "reference" / name, text)
    stale = []
    for path in sorted((ROOT / "notebooks").glob("*.py")):
        text, fresh = notebooks.page(path)
        _put(folder / "notebooks" / f"{path.stem}.md", linked(text))
        _copy(path, folder / "notebooks" / path.name)
        stale += [] if fresh else [path.name]
    return stale


def linked(text):
    """Return a page whose links to notebooks lead to their pages and whose public names lead to the reference."""
    parts = re.split(r"(^```.*?^```$)", text, flags=re.DOTALL | re.MULTILINE)
    return "".join(part if part.startswith("```") else _linked(part) for part in parts)


def _linked(text):
    text = re.sub(r"(\]\([^)]*\d\d_\w+)\.py\)", r"\1.md)", text)
    text = re.sub(r"\[[\w/]+\.(?:md|py)\](?=\([^)]*\.md)", "[]", text)  # the page's title replaces the file's name
    return re.sub(r"(?<![\[`])`([\w.]+)(\([^`]*\))?`(?![\]`])", _role, text)


def _role(match):
    dotted, code = reference.target(match.group(1)), match.group(0).strip("`")
    return f"{{py:obj}}`{code} <{dotted}>`" if dotted and "<" not in code else f"`{code}`"


def _put(path, text):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)


def _copy(source, target):
    target.parent.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(source, target)


if __name__ == "__main__":
    for name in write(Path(sys.argv[1])):
        print(f"{name} has no current outputs; run `make notebooks`", file=sys.stderr)
