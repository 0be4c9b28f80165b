"""The form of the source files: order of imports, length, names, docstrings, and names that no interpreter checks.

Each rule is a function from a source file to its problems. See also test_docstrings and test_types.
"""

import ast
import builtins
import re
from collections import defaultdict

import pytest

import jaxvibro as jv
from continuation import hostcall

from .sources import FUNCTIONS, MODULES, ROOT, Source, offenders, walk, words

# A file imports only from its own folder and from those before it.
FOLDERS = [
    *("scene", "output", "compiled", "stores", "flight", "contact", "maps", "orbits", "attractors", "problem"),
    *("branches", "loci", "design", "surveys", "plot", "studies", "explorer", "reproduction"),
]
EXPORTING = ("plot", "reproduction")  # folders whose __init__ names their public functions
MOST_LINES = 350
FORMER_NAMES = ROOT / "docs" / "former_names.md"

# Participles and pronouns that say nothing about the thing they name.
BANNED_NAMES = words(
    "along asked begun drawn each felt found given gone held here joined kept late lean made met more moved one others"
    " own passed place places seen shown some spot there told turned way ways what whole"
)
# Banned names, and the files in which they are public names, columns of files, keys of scene files, or the number 1.
PUBLIC_NAMES = {
    "_asked": words("design/located"),
    "along": words("continuation/one_parameter design/located studies/schema surveys/map"),
    "each": words("stores/dask_engine stores/engines"),
    "found": words("branches/scenario maps/return_map plot/fit plot/fractions plot/spectrum"),
    "held": words("branches/branch_file branches/held_branch plot/held"),
    "met": words("design/place design/search"),
    "more": words("reproduction/claim stores/study"),
    "one": words("orbits/impact_equations plot/branch plot/held plot/locus plot/orbit"),
    "others": words("design/margin_result"),
    "own": words("scene/scene"),
    "place": words(
        "branches/branch continuation/branch design/place explorer/page_calls "
        "explorer/page_state loci/locus problem/orbit_curve surveys/least_shock"
    ),
    "spot": words("branches/branch loci/locus problem/orbit_curve"),
    "told": words("reproduction/run"),
    "what": words("design/place"),
}
BANNED_PHRASES = re.compile(
    r"\b(told|is asked|asked for|worked out|goes on|gone on|so many|so far|here alone|what is|what was|what are"
    r"|is to be|are to be|lopsided)\b",
    re.IGNORECASE,
)
BANNED_STARTS = words("What Of Whether Those That How So (the (The The A An None Where Which")
# Words of two meanings, which name no file.
AMBIGUOUS = words("along kept left told look brush dips graze carry lanes piece slopes")
QUOTED = re.compile(r"(?<!`)`([A-Za-z_][\w.]*)`(?!`)")
# Functions and modules that run what they read, and the files that may use them: functions that are sent to workers,
# programs whose digest and owner have been verified.
UNSAFE = words("cloudpickle dill eval exec joblib marshal pickle shelve")
UNSAFE_USES = {
    "jaxvibro/stores/dask_engine.py": {"cloudpickle"},
    "continuation/hostcall/program_writer.py": {"exec", "marshal"},
}


def imports_against_the_order(source):
    """A folder imports from itself and the folders before it, continuation nothing of jaxvibro.

    The package itself has the version, and the table of public names, which loads a name when it is used.
    """
    modules = [module.split(".") for module in source.needed_modules]
    folders = {(parts[1:] or [""])[0] for parts in modules if parts[0] == "jaxvibro"}
    if source.folder is None:
        return [f"imports jaxvibro.{folder}" for folder in folders]
    if source.folder not in FOLDERS:
        return []
    if source.file.endswith("__init__.py") and source.folder not in EXPORTING and modules:
        return ["an __init__ imports"]
    return [f"imports {name}" for name in folders - {"", *FOLDERS[: FOLDERS.index(source.folder) + 1]}]


def imports_within_functions(source):
    functions = walk(source.tree, FUNCTIONS)
    return {f"imports in {node.name}" for node in functions if any(walk(node, ast.Import | ast.ImportFrom))}


def unsafe_uses(source):
    """No file unpickles or evaluates what it reads: a scene, a result and a file of the cache are data."""
    used = {dotted.split(".")[0] for _, dotted in source.imports}
    used |= {node.func.id for node in walk(source.tree, ast.Call) if isinstance(node.func, ast.Name)}
    return [f"uses {name}" for name in used & UNSAFE - UNSAFE_USES.get(source.file, set())]


def lines_of_code(source):
    """Return the number of lines without blank lines, comments and docstrings."""
    first = [node.body[0] for node, _ in source.docstrings]
    docstrings = {line for node in first for line in range(node.lineno, node.end_lineno + 1)}
    lines = enumerate(map(str.strip, source.text.splitlines()), 1)
    return sum(bool(line) and not line.startswith("#") and k not in docstrings for k, line in lines)


def too_many_lines(source):
    count = lines_of_code(source)
    return [f"{count} lines of code"] if count > MOST_LINES else []


def public_names(source):
    """Return the banned names that a file may use."""
    path = source.file.removesuffix(".py").removeprefix("jaxvibro/")
    return {name for name, files in PUBLIC_NAMES.items() if path in files}


def banned_names(source):
    """Functions, classes, fields, parameters, variables and files have no banned name."""
    names = {node.name for node in walk(source.tree, FUNCTIONS | ast.ClassDef)}
    names |= {node.arg for node in walk(source.tree, ast.arg)}
    names |= {node.id for node in walk(source.tree, ast.Name) if isinstance(node.ctx, ast.Store)}
    banned = {name for name in names if name.strip("_").lower() in BANNED_NAMES}
    stem = source.file.rpartition("/")[2].removesuffix(".py")
    return banned - public_names(source) | ({stem} & AMBIGUOUS)


def banned_phrases(source):
    phrases = {match.group() for _, text in source.docstrings for match in BANNED_PHRASES.finditer(text)}
    return phrases - public_names(source)


def summaries_that_are_not_imperative(source):
    for node, text in source.docstrings:
        is_property = any("property" in ast.unparse(each) for each in getattr(node, "decorator_list", ()))
        if isinstance(node, FUNCTIONS) and not is_property and text.split()[0] in BANNED_STARTS:
            yield f"{node.name}: {text.splitlines()[0]}"


def headings_within_lines(source):
    """A heading of a docstring is a line of its own."""
    return [text for _, text in source.docstrings if re.search(r"\w -{3,}( |$)", text)]


def bound_names(tree):
    """Yield the names that a module defines, assigns, imports, takes or uses, and its short texts."""
    yield from (node.name for node in walk(tree, FUNCTIONS | ast.ClassDef))
    yield from (node.arg for node in walk(tree, ast.arg))
    yield from (node.id for node in walk(tree, ast.Name))
    yield from (node.attr for node in walk(tree, ast.Attribute))
    yield from (alias.asname or alias.name for node in walk(tree, ast.Import | ast.ImportFrom) for alias in node.names)
    yield from (node.value for node in walk(tree, ast.Constant) if isinstance(node.value, str) and len(node.value) < 40)


BOUND = {module: set(bound_names(source.tree)) for module, source in MODULES.items()}
NAMES_BY_STEM = defaultdict(set)
for _module, _names in BOUND.items():
    NAMES_BY_STEM[MODULES[_module].file.rpartition("/")[2].removesuffix(".py")] |= _names
FOLDER_NAMES = {name for module in MODULES for name in module.split(".")}
KNOWN = {*dir(builtins), *NAMES_BY_STEM, *FOLDER_NAMES, "py"}.union(*BOUND.values())


def references_to_nothing(source):
    """A quoted name in a docstring names something in the packages."""
    for reference in {name for _, text in source.docstrings for name in QUOTED.findall(text)}:
        *modules, last = reference.split(".")
        in_module = not modules or last == "py" or last in NAMES_BY_STEM.get(modules[-1], {last})
        if not KNOWN.issuperset(reference.split(".")) or not in_module:
            yield reference


def defined_names(tree):
    """Yield the names at the top level of a module."""
    for node in tree.body:
        if isinstance(node, FUNCTIONS | ast.ClassDef):
            yield node.name
        else:
            yield from (name.id for name in walk(node, ast.Name))
            yield from (alias.asname or alias.name for alias in getattr(node, "names", ()))


DEFINED = {module: set(defined_names(source.tree)) for module, source in MODULES.items()}
DEFINED["jaxvibro"] |= set(jv.__all__)  # loaded when they are used


def attributes_that_modules_lack(source):
    """An attribute of an imported module exists."""
    imported = {name: dotted for name, dotted in source.imports if dotted in MODULES}
    for node in walk(source.tree, ast.Attribute):
        dotted = imported.get(getattr(node.value, "id", ""))
        if dotted and node.attr not in DEFINED[dotted] and not node.attr.startswith("__"):
            yield f"{ast.unparse(node)}: not in {dotted}"


REFERRING = '"""See `flow_of_scene`, `flow.no_function`, `no_name` and `impact.py`."""'
CHOOSING = """from . import impact
def advance(flow):
    return flow.no_jet, impact.no_impact
"""
LACKING = ["impact.no_impact: not in jaxvibro.flight.impact"]
IMPACT = "jaxvibro/flight/impact.py"
BROKEN = [
    (imports_against_the_order, IMPACT, "from ..maps import strobe", ["imports maps"]),
    (imports_against_the_order, IMPACT, "from jaxvibro.maps.strobe import strobe", ["imports maps"]),
    (imports_against_the_order, "jaxvibro/flight/__init__.py", "from . import impact", ["an __init__ imports"]),
    (imports_against_the_order, "continuation/a.py", "from jaxvibro.maps import strobe", ["imports jaxvibro.maps"]),
    (imports_within_functions, IMPACT, "def f():\n    if a:\n        import b", ["imports in f"]),
    (unsafe_uses, IMPACT, "import pickle as storage", ["uses pickle"]),
    (unsafe_uses, IMPACT, "from cloudpickle import dumps\neval(text)", ["uses cloudpickle", "uses eval"]),
    (too_many_lines, IMPACT, '"""A.\n\nB."""\n\n# C.\n' + "a = 1\n" * 351, ["351 lines of code"]),
    (banned_names, "jaxvibro/maps/kept.py", "def f(asked):\n    found = asked", ["asked", "found", "kept"]),
    (banned_names, "jaxvibro/plot/fit.py", "found, _told = 1, 2", ["_told"]),
    (banned_phrases, IMPACT, 'class A:\n    """What is told."""', ["What is", "told"]),
    (summaries_that_are_not_imperative, IMPACT, 'async def f():\n    """The end."""', ["f: The end."]),
    (headings_within_lines, IMPACT, 'def f():\n    """A. Returns ------- end"""', ["A. Returns ------- end"]),
    (references_to_nothing, IMPACT, REFERRING, ["flow.no_function", "no_name"]),
    (attributes_that_modules_lack, "jaxvibro/flight/a.py", CHOOSING, LACKING),
]
RULES = dict.fromkeys(rule for rule, *_ in BROKEN)


@pytest.mark.parametrize("rule", RULES)
def test_all_sources_keep_a_rule(rule):
    assert sorted(set(offenders(rule))) == []


@pytest.mark.parametrize("rule, file, text, problems", BROKEN)
def test_a_source_that_breaks_a_rule_is_noticed(rule, file, text, problems):
    assert sorted(set(rule(Source(file, text)))) == problems


def test_every_exemption_is_needed():
    used = [name for module, source in MODULES.items() for name in public_names(source) & BOUND[module]]
    assert len(used) == sum(map(len, PUBLIC_NAMES.values()))


def test_the_folders_are_all_that_the_package_has():
    assert {source.folder for source in MODULES.values() if source.folder} == set(FOLDERS)
    assert {path.name for path in (ROOT / "jaxvibro").glob("*.py")} == {"__init__.py", "__main__.py"}
    assert set(FOLDERS) & set(jv.__all__) == {"plot"}


def test_imports_have_no_cycle():
    """The files can be ordered so that each imports from those before it only."""
    waiting = {module: source.needed_modules - {module} for module, source in MODULES.items()}
    waiting["jaxvibro"] = set()  # its table loads a module when a name is used
    while free := {module for module, needed in waiting.items() if not needed & waiting.keys()}:
        waiting = {module: needed for module, needed in waiting.items() if module not in free}
    assert waiting == {}


def test_continuation_loads_a_solver_in_one_file_that_no_other_file_imports():
    sources = [source for source in MODULES.values() if source.folder is None]
    importing = [s.module for s in sources if any(name.split(".")[0] == "diffrax" for _, name in s.imports)]
    assert importing == ["continuation.shooting"]
    assert [s.module for s in MODULES.values() if "continuation.shooting" in s.needed_modules] == []


def test_the_evaluation_of_traced_functions_has_one_door():
    """Its files import nothing else of both packages, and other files import only its public names."""
    inside = {module for module in MODULES if module.startswith("continuation.hostcall")}
    assert {name for module in inside for name in MODULES[module].needed_modules} <= inside
    used = {dotted for module in MODULES.keys() - inside for _, dotted in MODULES[module].imports}
    names = {name for name in used if name.startswith("continuation.hostcall")}
    assert names <= {f"continuation.hostcall.{name}" for name in hostcall.__all__}


def assigned_names(source):
    """Yield the functions, classes and variables of a file."""
    yield from (node.name for node in walk(source.tree, FUNCTIONS | ast.ClassDef))
    yield from (node.id for node in walk(source.tree, ast.Name) if isinstance(node.ctx, ast.Store))


def test_each_present_name_of_a_former_name_exists():
    names_by_file = {source.file: set(assigned_names(source)) for source in MODULES.values()}
    rows = [re.findall("`([^`]+)`", line) for line in FORMER_NAMES.read_text().splitlines() if line.startswith("| `")]
    assert len(rows) > 1500 and {len(row) for row in rows} == {2, 3}
    for row in rows:
        file = row[1] if len(row) == 2 else row[0]
        names = names_by_file.get(file if file.startswith("continuation/") else f"jaxvibro/{file}")
        assert names is not None and (len(row) == 2 or row[2] in names), row


def test_the_stub_has_the_names_that_are_loaded_when_they_are_used():
    stub = ast.parse((ROOT / "jaxvibro" / "__init__.pyi").read_text())
    homes = {
        alias.asname: node.module for node in stub.body if isinstance(node, ast.ImportFrom) for alias in node.names
    }
    assert homes == {"plot": None, **jv._HOMES}
