"""References of soft draws, computed once: a folder keeps one line of JSON a seed, numbers as decimal strings.

A line counts only for the very draw that it was made for. After a change of the reference itself, remove the folder.
"""

import json
from collections import Counter
from decimal import Decimal, localcontext
from multiprocessing import get_context
from pathlib import Path
from typing import NamedTuple

from flint import ctx

from . import soft_draws
from .draws import Draw
from .search import Discard
from .soft import strobe

DIGITS, BATCH = 40, 50
FILE = "soft.jsonl"
PLAIN = ("norm", "product", "sharp", "compact", "scale", "least_minimum", "least_exit", "held", "counts")


class Kept(NamedTuple):
    """A seed, its draw and what of its `soft.Record` is compared; x, v, times, speeds and jacobian are
    Decimals."""

    seed: int
    draw: Draw
    x: Decimal
    v: Decimal
    times: list
    sides: list
    speeds: list
    exits: list
    jacobian: list
    norm: float
    product: float
    sharp: float
    compact: float
    scale: float
    least_minimum: float
    least_exit: float
    held: int
    counts: list

    @property
    def count(self):
        """How many impacts and entries there are."""
        return len(self.times)


def fair(count, folder=None, workers=1, seed=0):
    """(the first `count` Kept of the seeds from one on, a Counter of the reasons why others were refused)."""
    lines = read(folder)
    found, refused = [], Counter()
    with get_context("spawn").Pool(workers) if workers > 1 else Alone() as pool:
        while len(found) < count:
            seeds = range(seed, seed + workers * BATCH)
            draws = {one: soft_draws.draw(one) for one in seeds}
            missing = [one for one in seeds if lines.get(one, {}).get("draw") != repr(draws[one])]
            new = pool.map(line, missing, chunksize=5)
            write(folder, new)
            lines.update((each["seed"], each) for each in new)
            for one in seeds:
                if len(found) == count:
                    break
                if "refused" in lines[one]:
                    refused[lines[one]["refused"]] += 1
                else:
                    found.append(kept(draws[one], lines[one]))
            seed = seeds.stop
    return found, refused


class Alone:
    """A pool of no processes."""

    def map(self, function, values, chunksize=1):
        """The function's results."""
        return [function(value) for value in values]

    def __enter__(self):
        return self

    def __exit__(self, *error):
        return False


def line(seed):
    """What is kept of a seed: its draw, and its record or the reason why it is refused."""
    draw = soft_draws.draw(seed)
    row = {"seed": seed, "draw": repr(draw)}
    try:
        record = strobe(*draw)
    except Discard as reason:
        return row | {"refused": str(reason)}
    row |= {"x": digits(record.x), "v": digits(record.v), "sides": record.sides}
    row |= {"times": [digits(each) for each in record.times], "speeds": [digits(each) for each in record.speeds]}
    row["exits"] = [[digits(time), side] for time, side in record.exits]
    row["jacobian"] = [[digits(each) for each in entries] for entries in record.jacobian]
    row |= {name: getattr(record, name) for name in PLAIN}
    return json.loads(json.dumps(row))  # what a folder would give


def digits(ball):
    """The midpoint of a ball in decimals."""
    with ctx.workprec(4000):
        return ball.mid().str(DIGITS, radius=False)


def kept(draw, row):
    """The Kept of a line."""
    row = {name: value for name, value in row.items() if name != "draw"}
    for name in ("x", "v"):
        row[name] = Decimal(row[name])
    for name in ("times", "speeds"):
        row[name] = [Decimal(each) for each in row[name]]
    row["exits"] = [(Decimal(time), side) for time, side in row["exits"]]
    row["jacobian"] = [[Decimal(each) for each in entries] for entries in row["jacobian"]]
    return Kept(draw=draw, **row)


def less(decimal, number):
    """decimal - number, a float, as exactly as the digits allow."""
    with localcontext(prec=2 * DIGITS):
        return float(decimal - Decimal(float(number)))


def read(folder):
    """{seed: line} of a folder, the last one of a seed."""
    path = Path(folder) / FILE if folder else None
    if path is None or not path.exists():
        return {}
    rows = map(json.loads, path.read_text().splitlines())
    return {row["seed"]: row for row in rows}


def write(folder, rows):
    """Add lines to a folder's file."""
    if folder and rows:
        Path(folder).mkdir(parents=True, exist_ok=True)
        with (Path(folder) / FILE).open("a") as file:
            file.writelines(json.dumps(row) + "\n" for row in rows)
