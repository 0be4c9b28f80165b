"""The house: imports go one way, stand at the top of a file, and files stay short."""

import ast
from pathlib import Path

import pytest

import jaxvibro as jv

ROOT = Path(__file__).parents[1]
FILES = sorted(path for package in ("jaxvibro", "continuation") for path in (ROOT / package).rglob("*.py"))
# A file imports only from its own room and from those before it.
ROOMS = [
    *("scene", "output", "compiled", "stores", "flight", "maps", "orbits", "attractors", "problem", "branches", "loci"),
    *("design", "surveys", "plot", "studies", "explorer", "reproduction"),
]
FACE = ("plot", "reproduction")  # rooms whose own file names what stands in them


def name(path):
    """The dotted name of a file."""
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


NAMES = {name(path) for path in FILES}


def imported(path):
    """The files of both packages that a file imports, as dotted names."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            above = path.relative_to(ROOT).parts[: -node.level] if node.level else ()
            base = ".".join([*above, *([node.module] if node.module else [])])
            found = [f"{base}.{alias.name}" if f"{base}.{alias.name}" in NAMES else base for alias in node.names]
        else:
            continue
        yield from (one for one in found if one.split(".")[0] in ("jaxvibro", "continuation"))


def test_rooms_are_all_there_is():
    folders = {path.parent.name for path in FILES if path.parts[-3] == "jaxvibro"}
    assert folders == set(ROOMS)
    assert {path.name for path in (ROOT / "jaxvibro").glob("*.py")} == {"__init__.py", "__main__.py"}
    assert set(ROOMS) & set(jv.__all__) == {"plot"}


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(ROOT)))
def test_house(path):
    package, *parts = name(path).split(".")
    ours = [one.split(".") for one in imported(path)]
    if package == "continuation":
        assert not [one for one in ours if one[0] == "jaxvibro"]
    elif parts and parts[0] in ROOMS:
        allowed = {*ROOMS[: ROOMS.index(parts[0]) + 1]}
        rooms = {"".join(one[1:2]) for one in ours if one[0] == "jaxvibro"} - {""}
        # The package itself has the version; and the table of public names, which loads `run` when it is due.
        assert rooms <= allowed
        assert path.name != "__init__.py" or parts[0] in FACE or not ours
    inside = [
        one
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.FunctionDef)
        for one in ast.walk(node)
        if isinstance(one, ast.Import | ast.ImportFrom)
    ]
    assert inside == []
    assert lines_of_code(path.read_text()) <= 350


def lines_of_code(text):
    """The number of lines without blank lines, comments and docstrings."""
    documented = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    texts = [node.body[0] for node in ast.walk(ast.parse(text)) if isinstance(node, documented) and node.body]
    texts = [node for node in texts if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)]
    docstrings = {line for node in texts for line in range(node.lineno, node.end_lineno + 1)}
    lines = enumerate(text.splitlines(), 1)
    return sum(bool(line.strip()) and not line.strip().startswith("#") and k not in docstrings for k, line in lines)


def test_lines_of_code_are_counted_without_docstrings_and_comments():
    assert lines_of_code('"""Module.\n\nText."""\n\n# A comment.\ndef f():\n    """Text."""\n    return 1\n') == 2


def test_no_circles():
    """Files can be put in a row in which each imports from those before it alone."""
    wait = {name(path): set(imported(path)) - {name(path)} for path in FILES}
    wait["jaxvibro"] = set()  # its table loads a name's home when the name is asked for
    while free := {one for one, needs in wait.items() if not needs & wait.keys()}:
        wait = {one: needs for one, needs in wait.items() if one not in free}
    assert not wait


def test_continuation_alone_loads_no_solver():
    """One file flies with diffrax, and no other of the package loads that file."""
    files = [path for path in FILES if name(path).startswith("continuation.")]
    flying = [path.stem for path in files if "diffrax" in {one.split(".")[0] for one in every_import(path)}]
    assert flying == ["shooting"]
    assert not [path for path in FILES if "continuation.shooting" in imported(path)]


def every_import(path):
    """What a file imports by its whole name."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and not node.level:
            yield str(node.module)


def test_editors_read_the_names_that_are_loaded_when_asked_for():
    stub = ast.parse((ROOT / "jaxvibro" / "__init__.pyi").read_text())
    homes = {
        alias.asname: node.module for node in stub.body if isinstance(node, ast.ImportFrom) for alias in node.names
    }
    assert homes == {"plot": None, **jv._HOMES}
