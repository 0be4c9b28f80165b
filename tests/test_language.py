"""Names and docstrings use the terms of the field: banned words, imperative summaries. See also test_docstrings."""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FILES = sorted(path for package in ("jaxvibro", "continuation") for path in (ROOT / package).rglob("*.py"))

# Participles and pronouns that say nothing about the thing they name.
BANNED_NAMES = set(
    re.findall(
        r"\w+",
        "along asked begun drawn each felt found given gone held here joined kept late lean made met more moved one"
        " others own passed place places seen shown some spot there told turned way ways what whole",
    )
)
# Public names, columns of files and keys of scene files, which change with the public API.
PUBLIC = {
    "continuation/branch.py": {"place"},
    "continuation/one_parameter.py": {"along"},
    "jaxvibro/explorer/page_calls.py": {"place"},
    "jaxvibro/explorer/page_state.py": {"place"},
    "jaxvibro/branches/branch.py": {"place", "spot"},
    "jaxvibro/branches/branch_file.py": {"held"},
    "jaxvibro/branches/held_branch.py": {"held", "place"},
    "jaxvibro/branches/period_adding.py": {"found"},
    "jaxvibro/design/located_orbit.py": {"_asked", "along"},
    "jaxvibro/design/margin.py": {"others"},
    "jaxvibro/design/place.py": {"place", "met", "what"},
    "jaxvibro/design/search.py": {"met"},
    "jaxvibro/loci/locus.py": {"place", "spot"},
    "jaxvibro/maps/return_map.py": {"found"},
    "jaxvibro/maps/two_tier_strobe.py": {"one"},  # the number
    "jaxvibro/orbits/impact_equations.py": {"one"},  # the number
    "jaxvibro/plot/branch.py": {"one"},
    "jaxvibro/plot/fit.py": {"found"},
    "jaxvibro/plot/fractions.py": {"found"},
    "jaxvibro/plot/held.py": {"held", "one"},
    "jaxvibro/plot/locus.py": {"one"},
    "jaxvibro/plot/orbit.py": {"one"},
    "jaxvibro/plot/spectrum.py": {"found"},
    "jaxvibro/problem/orbit_curve.py": {"place", "spot"},
    "jaxvibro/reproduction/claim.py": {"more"},
    "jaxvibro/reproduction/run.py": {"told"},
    "jaxvibro/scene/wall.py": {"own"},
    "jaxvibro/stores/dask_engine.py": {"each"},
    "jaxvibro/stores/engines.py": {"each"},
    "jaxvibro/stores/study_protocol.py": {"more"},
    "jaxvibro/studies/schema.py": {"along"},
    "jaxvibro/surveys/least_shock.py": {"place"},
    "jaxvibro/surveys/map.py": {"along"},
}
BANNED_PHRASES = re.compile(
    r"\b(told|is asked|asked for|worked out|goes on|gone on|so many|so far|here alone|what is|what was|what are"
    r"|is to be|are to be|lopsided)\b",
    re.IGNORECASE,
)
BANNED_STARTS = {
    "What",
    "Of",
    "Whether",
    "Those",
    "That",
    "How",
    "So",
    "(the",
    "(The",
    "The",
    "A",
    "An",
    "None",
    "Where",
    "Which",
}


def functions(tree):
    return [node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)]


def names(tree):
    """Names of functions, classes, fields, parameters and variables."""
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            found.add(node.name)
        elif isinstance(node, ast.arg):
            found.add(node.arg)
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            found.add(node.id)
    return found


def docstrings(tree):
    """[(node, docstring)] of a module, its classes and its functions."""
    documented = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    nodes = [node for node in ast.walk(tree) if isinstance(node, documented)]
    return [(node, ast.get_docstring(node)) for node in nodes if ast.get_docstring(node)]


def is_property(node):
    return any("property" in ast.unparse(decorator) for decorator in getattr(node, "decorator_list", ()))


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(ROOT)))
def test_names_are_nouns_and_verbs_of_the_field(path):
    banned = {name for name in names(ast.parse(path.read_text())) if name.strip("_").lower() in BANNED_NAMES}
    assert banned <= PUBLIC.get(str(path.relative_to(ROOT)), set())


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(ROOT)))
def test_docstrings_are_plain(path):
    path_names = {"told"} & PUBLIC.get(str(path.relative_to(ROOT)), set())
    phrases = {
        match.group() for _, text in docstrings(ast.parse(path.read_text())) for match in BANNED_PHRASES.finditer(text)
    }
    assert phrases - path_names == set()


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(ROOT)))
def test_summaries_of_functions_are_imperative(path):
    summaries = {
        node.name: text.split("\n")[0]
        for node, text in docstrings(ast.parse(path.read_text()))
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and not is_property(node)
    }
    wrong = {name: text for name, text in summaries.items() if text.split()[0] in BANNED_STARTS}
    assert wrong == {}


def test_banned_words_are_noticed():
    tree = ast.parse('def f(asked):\n    """What is told."""\n    found = asked\n')
    assert {name for name in names(tree) if name in BANNED_NAMES} == {"asked", "found"}
    assert BANNED_PHRASES.search(docstrings(tree)[0][1])
