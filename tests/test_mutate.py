"""The list of broken guards: each reads in one place as it says, and the tests that are to notice are there."""

import ast
from collections import Counter
from pathlib import Path

import pytest

from tests import mutate

ROOT = Path(__file__).parents[1]
MUTANTS = mutate.mutants()
SIZES = {"flight": 8, "maps": 8, "orbits": 8, "branches": 8, "loci": 8}


def test_there_are_enough_in_each_room():
    rooms = Counter(one.room for one in MUTANTS)
    assert sum(rooms.values()) >= 80
    assert {room: rooms[room] >= least for room, least in SIZES.items()} == dict.fromkeys(SIZES, True)
    assert len({(one.file, one.text, one.becomes) for one in MUTANTS}) == len(MUTANTS)
    assert len({(one.room, one.name) for one in MUTANTS}) == len(MUTANTS)
    assert sum(not one.survives for one in MUTANTS) >= mutate.ENOUGH * len(MUTANTS)


@pytest.mark.parametrize("one", MUTANTS, ids=lambda one: f"{one.room}-{one.name}".replace(" ", "-"))
def test_its_guard_is_there_and_its_tests_are(one):
    path = ROOT / one.file
    room = "continuation" if one.file.startswith("continuation/") else path.parent.name
    assert room == one.room
    ast.parse(mutate.broken(one, path.read_text("utf-8")))
    assert one.guard and one.tests
    for test in one.tests:
        file, name = test.split("::")
        tree = ast.parse((ROOT / file).read_text("utf-8"))
        names = [each for each in tree.body if isinstance(each, ast.FunctionDef) and each.name == name.split("[")[0]]
        marks = {ast.unparse(mark) for each in names for mark in each.decorator_list}
        assert len(names) == 1 and not marks & {"pytest.mark.slow", "pytest.mark.long"}


def test_a_guard_that_reads_otherwise_is_an_error():
    (one,) = MUTANTS[:1]
    for source in ("", one.text + one.text):
        with pytest.raises(ValueError, match=f"has its text {source.count(one.text)} times"):
            mutate.broken(one, source)
