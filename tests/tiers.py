"""Which tests run when, and of how many draws: the table `tests/tiers.toml`, and decorators of properties.

A property is a test that holds for random scenes of each kind (`tests/kinds.py`). Draws are reproducible. A failing
draw is written to `tests/examples.json`; commit it with the correction, and it is tried first from then on.
"""

import json
import os
import tomllib
from dataclasses import dataclass
from functools import cache, wraps
from pathlib import Path

import numpy as np

from .kinds import GRID, KINDS, NUMBERS, draw_rows

FOLDER = Path(__file__).parent
TABLE, EXAMPLES = FOLDER / "tiers.toml", FOLDER / "examples.json"
TIERS = ("push", "ci", "release")


@dataclass(frozen=True)
class Draws:
    """A property of a kind: its name, and the number of draws in each tier."""

    folder: str
    name: str
    kind: str
    numbers: tuple[int, int, int]

    def in_tier(self, tier):
        """Return the number of draws in a tier, 0 if it adds none to the tier before; None: the first that draws."""
        if tier is None:
            return next(number for number in self.numbers if number)
        place = TIERS.index(tier)
        before = self.numbers[place - 1] if place else 0
        return self.numbers[place] if self.numbers[place] > before else 0


@cache
def table():
    """Return the table: {folder: {property: {"draws": ..., "kinds": ..., "of": ...}}}, and the tiers of other tests."""
    return tomllib.loads(TABLE.read_text("utf-8"))


@cache
def draws_of(folder, name, names=tuple(KINDS)):
    """Return the Draws of a property, one for each of its kinds; names: of all kinds there are."""
    try:
        row = table()[folder][name]
    except KeyError:
        raise KeyError(f"tests/tiers.toml must have a row [{folder}.{name}]") from None
    kinds = row.get("kinds", table()[folder].get("kinds", names))
    rows = {kind: _in_one_tier(table()[folder].get("push"), kind, row["draws"]) for kind in kinds} | row.get("of", {})
    if unknown := rows.keys() - set(names):
        raise KeyError(f"tests/tiers.toml: [{folder}.{name}] names unknown kinds {sorted(unknown)}")
    return [Draws(folder, name, kind, tuple(numbers)) for kind, numbers in rows.items()]


def _in_one_tier(pushed, kind, numbers):
    """Return the numbers of draws of a kind, either on each push or in CI, if a folder lists the kinds of a push."""
    push, ci, release = numbers
    if pushed is None or not push:
        return numbers
    return [push, push, release] if kind in pushed else [0, ci, release]


def tier_of(module, name):
    """Return the first tier in which a test that is no property runs; name: with its parameters in brackets."""
    row = table()["tests"].get(module, {})
    listed = [tier for tier in ("ci", "release") if {name, name.partition("[")[0]} & set(row.get(tier, ()))]
    return listed[0] if listed else "push"


def kinds_of(check):
    """Return the kinds of a property: those of its module if it defines some of its own, else those of scenes."""
    return check.__globals__.get("OWN_KINDS", KINDS)


def examples_of(check, kind):
    """Return the draws of a property and a kind that once failed."""
    return _kept_examples().get(f"{_folder_and_name(check)}[{kind}]", [])


def keep_example(check, kind, draw):
    """Add a failing draw to the permanent examples, one line for each property and kind."""
    kept = _kept_examples()
    rows = kept.setdefault(f"{_folder_and_name(check)}[{kind}]", [])
    if draw not in rows:
        rows.append(draw)
        lines = ",\n".join(f"{json.dumps(name)}: {json.dumps(kept[name])}" for name in sorted(kept))
        partial = EXAMPLES.with_suffix(f".{os.getpid()}")
        partial.write_text(f"{{\n{lines}\n}}\n", "utf-8")
        partial.rename(EXAMPLES)


def _kept_examples():
    return json.loads(EXAMPLES.read_text("utf-8")) if EXAMPLES.exists() else {}


def _folder_and_name(check):
    return f"{check.__module__.rpartition('.test_')[2]}.{check.__name__.removeprefix('test_')}"


def of_batches(check):
    """Make a property of check(kind, scene, state): the draws are numbered, and one that fails is simplified."""
    kinds = kinds_of(check)

    @wraps(check)
    def test(kind, draws):
        def fails(rows):
            try:
                check(kinds[kind], *kinds[kind].batch(rows))
            except Exception:
                return True
            return False

        numbers = range(first_draw(), first_draw() + draws)
        for rows in [*examples_of(check, kind), *map(batch_rows, numbers)]:
            if fails(rows):
                simple = simplified(np.array(rows), fails)
                keep_example(check, kind, simple.tolist())
                check(kinds[kind], *kinds[kind].batch(simple))

    return _as_property(test, kinds)


def batch_rows(number):
    """Return the rows of a numbered batch; in every third, some numbers are divided by powers of two."""
    rows, rng = draw_rows(number), np.random.default_rng([21, number])
    small = (rng.random(rows.shape) < 0.3) & (number % 3 == 2)
    low, high = np.floor(GRID * np.array([rule[:2] for rule in NUMBERS.values()])).T / GRID
    shrunk = np.round(GRID * rows * 0.5 ** rng.integers(1, 20, rows.shape)) / GRID
    return np.where(small, np.clip(shrunk, low, high), rows)


def simplified(rows, fails):
    """Return rows that fail as well: one scene in all lanes if that is enough, with simple numbers."""
    same = (np.repeat(rows[k : k + 1], len(rows), 0) for k in range(len(rows)))
    rows = next(filter(fails, same), rows)
    for column, (low, high, often) in enumerate(NUMBERS.values()):
        rounded = [np.round(rows[0, column] * parts) / parts for parts in (1, 8, 128)]
        for value in (*often, max(0.0, np.floor(GRID * low) / GRID), *rounded):
            candidate = rows.copy()
            candidate[:, column] = value
            if (value in often or low - 1.0 / GRID <= value <= high) and fails(candidate):
                rows = candidate
                break
    return rows


def of_numbers(check):
    """Make a property of check(kind, number): the draws are numbered from 0, which suits expensive ones."""

    kinds = kinds_of(check)

    @wraps(check)
    def test(kind, draws):
        for number in sorted({*examples_of(check, kind), *range(first_draw(), first_draw() + draws)}):
            try:
                check(kinds[kind], number)
            except Exception as error:
                keep_example(check, kind, number)
                error.add_note(f"draw {number} of {check.__name__}[{kind}]")
                raise

    return _as_property(test, kinds)


def first_draw():
    """Return the number of the first draw: a part of a release run starts later."""
    return int(os.environ.get("FIRST_DRAW", "0"))


def _as_property(test, kinds):
    """Give a property the arguments that pytest fills in."""
    del test.__wrapped__
    test.is_property, test.kinds = True, kinds
    return test


def generator(kind, number):
    """Return a random generator of a draw."""
    return np.random.default_rng([20, *kind.name.encode(), number])
