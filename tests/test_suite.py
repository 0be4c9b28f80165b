"""The suite itself: its tables name tests that exist, and a failing draw is kept."""

import ast
import json
from functools import cache
from pathlib import Path

import pytest

from . import tiers
from .kinds import KINDS, LANES, draw_rows

FOLDER = Path(__file__).parent
FORMER = [line.split("\t") for line in (FOLDER / "former_tests.tsv").read_text("utf-8").splitlines()[1:]]


@cache
def names_of_tests(module):
    """Return the names of the tests of a module."""
    path = FOLDER.joinpath(*module.split(".")).with_suffix(".py")
    tree = ast.parse(path.read_text("utf-8")) if path.exists() else ast.Module([], [])
    return {node.name for node in tree.body if isinstance(node, ast.FunctionDef) and node.name.startswith("test_")}


def test_the_table_of_tiers_names_tests_that_exist():
    rows = tiers.table()["tests"]
    listed = [(module, name) for module, row in rows.items() for names in row.values() for name in names]
    assert [row for row in listed if row[1].partition("[")[0] not in names_of_tests(row[0])] == []
    assert len(listed) == len(set(listed))


def test_each_property_has_its_draws_and_each_row_its_property():
    rows = {(folder, name) for folder, row in tiers.table().items() if folder != "tests" for name in row}
    files = {path.stem.removeprefix("test_") for path in (FOLDER / "properties").glob("test_*.py")}
    known = {
        (folder, name.removeprefix("test_")) for folder in files for name in names_of_tests(f"properties.test_{folder}")
    }
    assert rows <= known
    assert all(len(numbers) == 3 for folder, name in rows for numbers in numbers_of(tiers.table()[folder][name]))


def numbers_of(row):
    """Return the numbers of draws of a row."""
    return [row["draws"], *row.get("of", {}).values()]


def test_each_former_test_is_replaced_by_one_that_exists():
    replaced = {name for row in FORMER for name in row[2].split("; ")}
    replaced = {name for name in replaced if not name.startswith("(")}  # a reason why none is needed
    assert [name for name in replaced if name.partition("::")[2] not in names_of_tests(name.partition("::")[0])] == []


def test_a_failing_draw_is_kept_and_tried_first(tmp_path, monkeypatch):
    monkeypatch.setattr(tiers, "EXAMPLES", tmp_path / "examples.json")
    seen = []

    @tiers.of_numbers
    def test_small(kind, number):
        seen.append(number)
        assert number != 2

    with pytest.raises(AssertionError):
        test_small("one_wall", 5)
    with pytest.raises(AssertionError):
        test_small("one_wall", 1)
    assert seen == [0, 1, 2, 0, 2] and json.loads((tmp_path / "examples.json").read_text()) == {
        "test_small[one_wall]": [2]
    }

    @tiers.of_batches
    def test_slow(kind, scene, state):
        assert abs(state.v).max() < 3.0

    with pytest.raises(AssertionError):
        test_slow("one_wall", 50)
    (rows,) = json.loads((tmp_path / "examples.json").read_text())["test_slow[one_wall]"]
    _, state = KINDS["one_wall"].batch(rows)
    assert abs(state.v).max() == 3.0  # shrunk to the least failure
    with pytest.raises(AssertionError):
        test_slow("one_wall", 1)


def test_draws_are_reproducible_and_of_one_shape():
    assert (draw_rows(3) == draw_rows(3)).all() and (draw_rows(3) != draw_rows(4)).any()
    for kind in KINDS.values():
        scene, state = kind.draw(0)
        assert scene.shape == state.x.shape == (LANES,), kind.name
        single, start = kind.draw_single(0)
        assert single.shape == () and isinstance(start.x, float), kind.name
