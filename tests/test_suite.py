"""The suite itself: its tables name tests that exist, and a failing draw is kept."""

import json
from pathlib import Path

import pytest

from . import tiers
from .kinds import KINDS, LANES, NUMBERS, draw_rows
from .sources import names_of_tests

FOLDER = Path(__file__).parent
FORMER = [line.split("\t") for line in (FOLDER / "former_tests.tsv").read_text("utf-8").splitlines()[1:]]


def test_the_table_of_tiers_names_tests_that_exist():
    rows = tiers.table()["tests"]
    listed = [(module, name) for module, row in rows.items() for names in row.values() for name in names]
    assert [row for row in listed if row[1].partition("[")[0] not in names_of_tests(row[0])] == []
    assert len(listed) == len(set(listed))


def test_each_property_has_its_draws_some_of_them_in_ci_and_each_row_its_property():
    rows = {
        (folder, name): row
        for folder, own in tiers.table().items()
        for name, row in own.items()
        if folder != "tests" and name not in ("kinds", "push")
    }
    for place, row in rows.items():
        numbers = dict.fromkeys(row.get("kinds", ["others"]), row["draws"]) | row.get("of", {})
        assert all(len(each) == 3 for each in numbers.values()) and any(each[1] for each in numbers.values()), place
    files = {path.stem.removeprefix("test_") for path in (FOLDER / "properties").glob("test_*.py")}
    names = {folder: names_of_tests(f"properties.test_{folder}") for folder in files}
    assert rows.keys() <= {(folder, name.removeprefix("test_")) for folder, own in names.items() for name in own}


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

    for draws in (5, 1):
        with pytest.raises(AssertionError):
            test_small("one_wall", draws)
    assert seen == [0, 1, 2, 0, 2] and json.loads(tiers.EXAMPLES.read_text()) == {"suite.small[one_wall]": [2]}

    @tiers.of_batches
    def test_slow(kind, scene, state):
        assert abs(state.v).max() < 3.0

    for draws in (50, 1):
        with pytest.raises(AssertionError):
            test_slow("one_wall", draws)
    (rows,) = json.loads(tiers.EXAMPLES.read_text())["suite.slow[one_wall]"]
    row = dict(zip(NUMBERS, rows[0], strict=True))
    assert rows == [rows[0]] * LANES and row["amplitude"] == row["share"] == 0.0
    assert abs(row["v"]) >= 3.0 and row["v"] == round(row["v"])


def test_draws_are_reproducible_and_of_one_shape():
    for draw in (draw_rows, tiers.batch_rows):
        assert (draw(2) == draw(2)).all() and (draw(2) != draw(3)).any()
    for kind in KINDS.values():
        scene, state = kind.draw(0)
        assert scene.shape == state.x.shape == (LANES,), kind.name
        single, start = kind.draw_single(0)
        assert single.shape == () and isinstance(start.x, float), kind.name
