"""Names that no interpreter checks exist: names in docstrings, and functions of modules that are chosen at run time."""

import ast
import builtins
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FILES = sorted(file for package in ("continuation", "jaxvibro") for file in (ROOT / package).rglob("*.py"))
TREES = {file: ast.parse(file.read_text()) for file in FILES}
MODULES = {".".join(file.relative_to(ROOT).with_suffix("").parts): file for file in FILES}
QUOTED = re.compile(r"(?<!`)`([A-Za-z_][\w.]*)`(?!`)")


def walk(tree, kind):
    return (node for node in ast.walk(tree) if isinstance(node, kind))


def bound_names(tree):
    """Names that a module defines, assigns, imports, takes or uses, and its short texts."""
    yield from (node.name for node in walk(tree, ast.FunctionDef | ast.ClassDef))
    yield from (node.arg for node in walk(tree, ast.arg))
    yield from (node.id for node in walk(tree, ast.Name))
    yield from (node.attr for node in walk(tree, ast.Attribute))
    yield from (alias.asname or alias.name for node in walk(tree, ast.Import | ast.ImportFrom) for alias in node.names)
    yield from (node.value for node in walk(tree, ast.Constant) if isinstance(node.value, str) and len(node.value) < 40)


NAMES_BY_STEM: dict[str, set[str]] = {}
for _file, _tree in TREES.items():
    NAMES_BY_STEM.setdefault(_file.stem, set()).update(bound_names(_tree))
KNOWN = {*dir(builtins), *NAMES_BY_STEM, *(file.parent.name for file in FILES), "py"}.union(*NAMES_BY_STEM.values())


def unknown_references(tree):
    """Quoted names in the docstrings of a module that name nothing in the packages."""
    documented = walk(tree, ast.Module | ast.ClassDef | ast.FunctionDef)
    for reference in QUOTED.findall("\n".join(ast.get_docstring(node) or "" for node in documented)):
        parts = reference.split(".")
        in_module = parts[-1] in NAMES_BY_STEM.get(parts[-2], {parts[-1], "py"}) if len(parts) > 1 else True
        if not KNOWN.issuperset(parts) or not (in_module or parts[-1] == "py"):
            yield reference


@pytest.mark.parametrize("file", FILES, ids=lambda file: str(file.relative_to(ROOT)))
def test_names_in_docstrings_exist(file):
    assert sorted(set(unknown_references(TREES[file]))) == []


def test_headings_of_docstrings_are_lines_of_their_own():
    texts = (ast.get_docstring(node) for tree in TREES.values() for node in walk(tree, ast.FunctionDef | ast.ClassDef))
    assert [text for text in texts if text and re.search(r"\w -{3,}( |$)", text)] == []


def test_a_name_that_does_not_exist_is_noticed():
    tree = ast.parse('"""See `flow_of`, `flow.no_such_function`, `no_such_name` and `impact.py`."""')
    assert sorted(unknown_references(tree)) == ["flow.no_such_function", "no_such_name"]


def imported_modules(module, tree):
    """Modules of the packages that a module imports, by the name that it uses: {name: dotted name}."""
    package, modules = module.split(".")[:-1], {}
    for node in walk(tree, ast.ImportFrom):
        base = package[: len(package) - node.level + 1] if node.level else []
        for alias in node.names:
            dotted = ".".join([*base, *([node.module] if node.module else []), alias.name])
            if dotted in MODULES:
                modules[alias.asname or alias.name] = dotted
    return modules


def chosen_modules(modules, tree):
    """Modules that each function of a module returns, itself or from a table: {function: {dotted name}}."""
    tables = {
        target.id: node.value
        for node in tree.body
        if isinstance(node, ast.Assign) and isinstance(node.value, ast.Dict)
        for target in node.targets
        if isinstance(target, ast.Name)
    }
    for function in walk(tree, ast.FunctionDef):
        values = [node.value for node in walk(function, ast.Return) if node.value is not None]
        values += [
            tables[node.value.id]
            for value in list(values)
            for node in walk(value, ast.Subscript)
            if isinstance(node.value, ast.Name) and node.value.id in tables
        ]
        qualified = {id(node.value) for value in values for node in walk(value, ast.Attribute)}
        names = {node.id for value in values for node in walk(value, ast.Name) if id(node) not in qualified}
        if returned := {modules[name] for name in names & set(modules)}:
            yield function.name, returned


def called_name(node):
    """Name of the function that an expression calls, "" if it is no call."""
    function = node.func if isinstance(node, ast.Call) else None
    return getattr(function, "id", None) or getattr(function, "attr", None) or ""


def defined_names(tree):
    """Names at the top level of a module."""
    top = [node for node in tree.body if not isinstance(node, ast.FunctionDef | ast.ClassDef)]
    yield from (node.name for node in tree.body if isinstance(node, ast.FunctionDef | ast.ClassDef))
    yield from (name.id for node in top for name in walk(node, ast.Name))
    yield from (alias.asname or alias.name for node in top for alias in getattr(node, "names", ()))


DEFINED = {module: set(defined_names(TREES[file])) for module, file in MODULES.items()}
IMPORTED = {module: imported_modules(module, TREES[file]) for module, file in MODULES.items()}
CHOSEN: dict[str, set[str]] = {}
for _module, _file in MODULES.items():
    for _function, _returned in chosen_modules(IMPORTED[_module], TREES[_file]):
        CHOSEN.setdefault(_function, set()).update(_returned)


def missing_attributes(module, tree):
    """Attributes of modules that a module uses and that the module, or one of those that may be chosen, lacks."""
    modules = {name: {dotted} for name, dotted in IMPORTED[module].items()}
    for function in (tree, *walk(tree, ast.FunctionDef)):
        variables = dict(modules)
        for node in walk(function, ast.Assign):
            targets = node.targets[0].elts if isinstance(node.targets[0], ast.Tuple) else node.targets
            values = node.value.elts if isinstance(node.value, ast.Tuple) else [node.value]
            if len(targets) == len(values):
                pairs = zip(targets, values, strict=True)
                variables |= {
                    target.id: CHOSEN[called_name(value)]
                    for target, value in pairs
                    if isinstance(target, ast.Name) and called_name(value) in CHOSEN
                }
        for node in walk(function, ast.Attribute):
            owner = getattr(node.value, "id", "")
            for dotted in CHOSEN.get(called_name(node.value), variables.get(owner, ())):
                if node.attr not in DEFINED[dotted] and not node.attr.startswith("__"):
                    yield f"{ast.unparse(node)}: not in {dotted}"


@pytest.mark.parametrize("module", MODULES)
def test_functions_of_chosen_modules_exist(module):
    assert sorted(set(missing_attributes(module, TREES[MODULES[module]]))) == []


def test_a_function_that_a_chosen_module_lacks_is_noticed():
    tree = ast.parse("def advance(coeffs):\n    flow = flow_of(coeffs)\n    return flow.jet, flow.no_jet")
    assert sorted(set(missing_attributes("jaxvibro.flight.impact", tree))) == [
        "flow.no_jet: not in jaxvibro.flight.force_flow",
        "flow.no_jet: not in jaxvibro.flight.linear_flow",
    ]


def test_the_interfaces_are_those_that_are_chosen_at_run_time():
    families = {frozenset(name.split(".")[-1] for name in modules) for modules in CHOSEN.values() if len(modules) > 1}
    assert {frozenset({"linear_flow", "force_flow"})} <= families and len(families) >= 3
