"""Count the private names that tests import: `python -m tests.private_imports [FOLDER]` prints how many a file has.

A name is private if it comes from a module of the package and the package does not export it. An import of a module
counts once, and each attribute of such a module that the file uses counts as well, as does a name in a text, such as
the "jaxvibro.stores.store.run" of a replacement by pytest.
"""

import ast
import re
import sys
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).parents[1]
PACKAGES = "jaxvibro", "continuation"
IN_TEXT = re.compile(r"(jaxvibro|continuation)(\.[a-z]\w*)+\.\w+")


def private_names(path):
    """Return the private names that a file imports, each once."""
    tree, names, modules = ast.parse(path.read_text("utf-8")), set(), {}
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.level == 0 and node.module.split(".")[0] in PACKAGES:
            for alias in node.names:
                if node.module in PACKAGES and not is_module(f"{node.module}.{alias.name}"):
                    continue
                names.add(f"{node.module}.{alias.name}")
                if is_module(f"{node.module}.{alias.name}"):
                    modules[alias.asname or alias.name] = f"{node.module}.{alias.name}"
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names if alias.name.startswith(tuple(f"{one}." for one in PACKAGES))}
        if isinstance(node, ast.Constant) and is_private_text(node.value):
            names.add(node.value)
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in modules:
            names.add(f"{modules[node.value.id]}.{node.attr}")
    return names


def is_private_text(value):
    """Return whether a constant is a text that names something in a module of the packages."""
    is_name = isinstance(value, str) and IN_TEXT.fullmatch(value)
    return is_name and is_module(value.rpartition(".")[0]) and not is_module(value)


def is_module(name):
    """Return whether a dotted name is a module or a package of the project."""
    place = ROOT.joinpath(*name.split("."))
    return place.with_suffix(".py").exists() or (place / "__init__.py").exists()


def main(folder=ROOT / "tests"):
    """Print the files with the most private names, and the sum."""
    counts = Counter({path: len(private_names(path)) for path in sorted(Path(folder).rglob("*.py"))})
    for path, count in counts.most_common(20):
        print(f"{count:4d} {path.name}")
    print(f"{sum(counts.values()):4d} in all")


if __name__ == "__main__":
    main(*sys.argv[1:])
