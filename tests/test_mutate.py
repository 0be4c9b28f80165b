"""The lists of mutants: their texts and tests exist, and drawn ones change the code and depend on the seed alone."""

import ast
from collections import Counter

import pytest

from . import drawn_mutants, mutate, tiers
from .sources import names_of_tests

ROOT = mutate.ROOT
MUTANTS = mutate.listed_mutants()
LEAST = {"flight": 8, "maps": 8, "orbits": 8, "branches": 8, "loci": 8}


def test_each_folder_has_enough_mutants():
    folders = Counter(mutant.folder for mutant in MUTANTS)
    assert folders.total() >= 80 and {name for name, least in LEAST.items() if folders[name] < least} == set()
    assert len({(mutant.file, mutant.text, mutant.becomes) for mutant in MUTANTS}) == len(MUTANTS)
    assert len({(mutant.folder, mutant.name) for mutant in MUTANTS}) == len(MUTANTS)
    assert sum(not mutant.survives for mutant in MUTANTS) >= mutate.ENOUGH * len(MUTANTS)


def lacking_test(node):
    """Return whether a node id is that of no test, or of one that runs before a release alone."""
    file, _, name = node.partition("::")
    module = file.removeprefix("tests/").removesuffix(".py").replace("/", ".")
    names = names_of_tests(module)
    return names.count(name.partition("[")[0]) != 1 or tiers.tier_of(module, name) == "release"


def test_each_mutant_applies_and_has_tests():
    wrong = []
    for mutant in MUTANTS:
        path = ROOT / mutant.file
        ast.parse(mutate.mutated(mutant, path.read_text("utf-8")))
        folder = "continuation" if mutant.file.startswith("continuation/") else path.parent.name
        if folder != mutant.folder or not mutant.guard or not mutant.tests or any(map(lacking_test, mutant.tests)):
            wrong.append(f"{mutant.folder}: {mutant.name}")
    assert wrong == []
    assert lacking_test("tests/test_mutate.py::test_no_such_name") and lacking_test("tests/no_such_file.py::test_a")


@pytest.mark.parametrize("source, line, count", [("", 0, 0), ("a = 1\na = 1\n", 0, 2), ("b = 1\na = 1\n", 1, 0)])
def test_a_text_that_does_not_occur_once_is_an_error(source, line, count):
    mutant = mutate.Mutant("maps", "sign", "a.py", "a = 1\n", "a = 2\n", line=line)
    with pytest.raises(ValueError, match=f"has its text {count} times"):
        mutate.mutated(mutant, source)


def test_every_kind_of_expression_is_mutated():
    source = (
        'def f(x: int | None = 1):\n    """A + b."""\n    if x < 2:\n        return not x\n    return x + -y * 2.0\n'
    )
    mutants = drawn_mutants.mutants_of(source)
    lines = {kind: {becomes.strip() for _, _, becomes in rows} for kind, rows in mutants.items()}
    assert lines == {
        "comparison": {"if (x <= 2):", "if (x >= 2):"},
        "constant": {"def f(x: int | None = 2):", "if x < 3:", "return x + -y * 4.0"},
        "negation": {"return x"},
        "operator": {"return (x - -y * 2.0)", "return x + (-y / 2.0)", "return x + y * 2.0"},
        "dropped term": {"return x", "return (-y * 2.0)", "return x + (-y)", "return x + 2.0"},
    }


def test_drawn_mutants_change_the_code_of_every_folder_and_depend_on_the_seed_alone():
    every = drawn_mutants.package_folders()
    folders = {name: every[name] for name in ("scene", "compiled", "output")}
    drawn = drawn_mutants.draw(8, 3, folders)
    assert sorted(map(len, drawn.values())) == [2, 3, 3] and drawn == drawn_mutants.draw(8, 3, folders)
    assert drawn != drawn_mutants.draw(8, 4, folders)
    for folder, tables in drawn.items():
        for table in tables:
            source = (ROOT / table["file"]).read_text("utf-8")
            mutant = mutate.Mutant(folder, "0", **table)
            assert ast.dump(ast.parse(mutate.mutated(mutant, source))) != ast.dump(ast.parse(source))
            assert mutate.stages(mutant)[-1] == ["--tier", "push", "tests"]


def test_each_folder_has_test_files():
    table = mutate.read_table(mutate.FOLDERS)
    assert table.keys() == drawn_mutants.package_folders().keys()
    assert [name for names in table.values() for name in names if not names_of_tests(name)] == []
