"""Draw a sample of names or of docstrings and sentences: `python -m tests.readers.draw names|texts COUNT SEED`.

Prints JSON. Names: files, functions, records, parameters and variables of both packages, with the file and the
function they stand in; public names, their parameters and their attributes are left out, as they change with the public
API. Texts: docstrings of the packages, and sentences of the pages, the README and the notebooks.
"""

import ast
import json
import random
import re
import sys
from pathlib import Path

import continuation
import jaxvibro as jv
from tests.sources import FUNCTIONS, MODULES, PAGES, ROOT

PUBLIC = {*jv._HOMES, *jv.plot.__all__, *continuation.__all__}


def names():
    """Return every name once per file and function: [{kind, file, function, name}]."""
    rows = []
    for source in MODULES.values():
        if not source.file.endswith("__init__.py"):
            rows.append(("file", source.file, "", Path(source.file).stem))
        rows += names_below(source.tree, source.file, "")
    keys = ("kind", "file", "function", "name")
    return [dict(zip(keys, row, strict=True)) for row in dict.fromkeys(rows)]


def names_below(node, file, function):
    """Yield the names of a syntax tree, in order."""
    for child in ast.iter_child_nodes(node):
        inner, name = function, getattr(child, "name", "")
        if isinstance(child, FUNCTIONS | ast.ClassDef):
            inner = f"{function}.{name}".strip(".")
        if isinstance(child, FUNCTIONS) and name not in PUBLIC:
            if not name.startswith("__"):
                yield "function", file, function, name
            arguments = (*child.args.posonlyargs, *child.args.args, *child.args.kwonlyargs)
            yield from (("parameter", file, inner, each.arg) for each in arguments if each.arg not in ("self", "cls"))
        elif isinstance(child, ast.ClassDef) and name not in PUBLIC:
            yield "record", file, function, name
        elif isinstance(child, ast.Name) and isinstance(child.ctx, ast.Store) and function and child.id != "_":
            yield "variable", file, function, child.id
        yield from names_below(child, file, inner)


def texts():
    """Return docstrings and sentences: [{kind, file, text}]."""
    rows = []
    for source in MODULES.values():
        for node, text in source.docstrings:
            rows.append({"kind": "docstring", "file": f"{source.file}:{getattr(node, 'name', '')}", "text": text})
    for path in (ROOT / page for page in ("README.md", "CONTRIBUTING.md", *PAGES[1:])):
        prose = re.sub(r"(?ms)^```.*?^```|^\|.*?$|^#.*?$|\$\$.*?\$\$", "", path.read_text())
        for sentence in re.split(r"(?<=[.?!])\s+(?=[A-Z])", " ".join(prose.split())):
            if len(sentence.split()) >= 5:
                rows.append({"kind": "sentence", "file": str(path.relative_to(ROOT)), "text": sentence})
    return rows


def main(kind, count, seed):
    """Print a sample: names evenly over kinds, texts evenly over docstrings and sentences."""
    rows, rng = {"names": names, "texts": texts}[kind](), random.Random(int(seed))
    groups = {}
    for row in rows:
        groups.setdefault(row["kind"], []).append(row)
    share = -(-int(count) // len(groups))
    drawn = [row for group in groups.values() for row in rng.sample(group, min(share, len(group)))]
    print(json.dumps(drawn[: int(count)], indent=1))


if __name__ == "__main__":
    main(*sys.argv[1:])
