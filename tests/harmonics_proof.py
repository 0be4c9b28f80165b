"""Drives of several harmonics held against ball arithmetic: `python -m tests.harmonics_proof 2000 2` prints numbers.

The last number is of the processes that compute the references; one more is the first seed, 0 if not given. What is
static of a scene, its walls and harmonics, is of a few kinds, as each is compiled for; all else is drawn.
"""

import math
import sys
from collections import Counter, defaultdict
from functools import partial
from multiprocessing import get_context
from typing import NamedTuple

import jax
import numpy as np

import jaxvibro as jv
from tests.proof import SLOTS, batch
from tests.reference import orbit, soft, soft_draws
from tests.reference.draws import Draw, start
from tests.reference.scene import Scene, Soft, Term
from tests.reference.search import Discard

WIDE = 16  # lanes at a time
RIGID, SOFT = ("rigid", 0), ("soft", 0)
KINDS = [  # of the walls, as in `soft_draws`, and the harmonics of the drive's further terms
    ((RIGID, RIGID), (3, 0, 1)),
    ((None, RIGID), (0,)),
    ((RIGID, RIGID), (0, 2)),
    ((("rigid", 2), RIGID), (1, 3)),
    ((RIGID, None), (2, 5)),
    ((RIGID, ("rigid", 1)), (0, 3, 4)),
    ((RIGID, RIGID), (0, 1, 2, 3, 7)),
    ((SOFT, RIGID), (3,)),
    ((RIGID, SOFT), (0, 2)),
    ((("soft", 1), SOFT), (0, 3)),
]


class Row(NamedTuple):
    """A draw's errors: of the end and of the least clearance over the bound, whether its itinerary is right, of times
    and speeds."""

    state: float
    right: bool
    times: float
    speeds: float
    clearance: float
    count: int


def draw(seed):
    """(the place of its kind, the Draw) of a seed; gamma up to 1.5, omega 0.2 to 5, A up to 10, other terms as large
    together."""
    rng, place = np.random.default_rng([seed, 7]), seed % len(KINDS)
    kinds, harmonics = KINDS[place]
    gamma = float(rng.choice([0.0, 1.0, rng.uniform(0, 0.2), rng.uniform(0, 1.5)], p=[0.05, 0.05, 0.4, 0.5]))
    omega, amplitude = float(np.exp(rng.uniform(math.log(0.2), math.log(5)))), float(rng.uniform(0, 10))
    gap, low = float(rng.uniform(0.3, 4)), float(rng.uniform(-4, 2))
    if rng.random() < 0.4:
        low = -gap * float(rng.uniform(0.2, 0.8))  # the mass rests between the walls
    walls = [soft_draws.wall(rng, kind, place, gap) for kind, place in zip(kinds, (low, low + gap), strict=True)]
    sizes = rng.normal(0, 5, len(harmonics)) / len(harmonics) ** 0.5
    turns = rng.choice([0.0, 1.0], len(harmonics), p=[0.3, 0.7]) * rng.uniform(0, 2 * math.pi, len(harmonics))
    terms = tuple(Term(float(a), m, float(p)) for a, m, p in zip(sizes, harmonics, turns, strict=True))
    phase = float(rng.choice([0.0, rng.uniform(0, 2 * math.pi)]))
    scene = Scene(gamma, omega, amplitude, *walls, terms)
    return place, Draw(scene, start(scene, rng, phase), float(rng.normal(0, 2)), phase)


def referred(seed):
    """(the kind's place, the Draw, its record or the reason why it is refused) of a seed."""
    place, drawn = draw(seed)
    yields = any(isinstance(wall, Soft) for _, wall in drawn.scene.walls())
    try:
        record = (soft if yields else orbit).strobe(*drawn)
    except Discard as reason:
        return place, drawn, str(reason)
    kept = {name: getattr(record, name) for name in ("sides", "norm", "scale", "least_minimum")}
    balls = {name: [_text(each) for each in getattr(record, name)] for name in ("times", "speeds")}
    return place, drawn, kept | balls | {"x": _text(record.x), "v": _text(record.v)}


def _text(ball):
    return ball.mid().str(40, radius=False)


def less(text, number):
    """A number of forty digits less a double."""
    return float(np.longdouble(text) - np.longdouble(number))


def gather(count, workers=1, seed=0):
    """({place of a kind: [(Draw, record)]} of so many draws, the reasons why others were refused)."""
    found, refused, seeds = defaultdict(list), Counter(), iter(range(seed, seed + 100 * count + 100))
    with get_context("spawn").Pool(workers) as pool:
        for place, drawn, record in pool.imap(referred, seeds, chunksize=4):
            if isinstance(record, str):
                refused[record] += 1
                continue
            found[place].append((drawn, record))
            if sum(map(len, found.values())) == count:
                pool.terminate()
                break
    return found, refused


measured = partial(jv.strobe, slots=SLOTS, clearance=True)


def rows(members, run=measured):
    """The `Row`s of draws of one kind; some at a time, so that what is compiled is the same for any number of them.

    run: how a batch is strobed.
    """
    return [row for first in range(0, len(members), WIDE) for row in _rows(members[first : first + WIDE], run)]


def _rows(members, run):
    drawn, records = zip(*members, strict=True)
    filled = [drawn[k % len(drawn)] for k in range(WIDE)]
    end, impacts = jax.tree.map(np.asarray, run(*batch(filled)))
    found = []
    for k, true in enumerate(records):
        bound, sides = 1e-12 * true["scale"] * (1 + true["norm"]), [int(side) for side in impacts.side[k] if side]
        error = max(abs(less(true["x"], end.x[k])), abs(less(true["v"], end.v[k])))
        right = sides == true["sides"] and impacts.status[k] == 0
        times, speeds = (
            max((abs(less(one, other)) for one, other in zip(true[name], rows[k], strict=False)), default=0.0)
            for name, rows in (("times", impacts.time), ("speeds", impacts.speed))
        )
        least = float(impacts.least_clearance[k])
        close = 0.0 if least == true["least_minimum"] else abs(least - true["least_minimum"]) / bound
        found.append(Row(error / bound, bool(right), times, speeds / bound, close, len(sides)))
    return found


def main(count, workers=1, seed=0):
    """Print what is found over so many draws."""
    found, refused = gather(count, workers, seed)
    print(f"{sum(map(len, found.values()))} scenes; refused: {dict(refused)}", flush=True)
    every = []
    for place in sorted(found):
        own = rows(found[place])
        every += own
        wrong, worst = sum(not row.right for row in own), max(row.state for row in own)
        print(f"{KINDS[place]}: {len(own)} scenes, wrong {wrong}, worst {worst:.3g}", flush=True)
    print(f"impacts {sum(row.count for row in every)}, wrong itineraries {sum(not row.right for row in every)}")
    good = [row for row in every if row.right]
    for name in ("state", "speeds", "clearance"):
        print(f"{name}: worst {max(getattr(row, name) for row in good):.3g} of the bound")
    print(f"times: worst {max(row.times for row in good):.3g}")


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    main(*map(int, sys.argv[1:4]))
