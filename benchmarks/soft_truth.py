"""The true ends and itineraries between soft walls, in ball arithmetic."""

import numpy as np

from benchmarks.soft_work import held
from benchmarks.truth import Truth
from benchmarks.work import CAP, GAMMA, OMEGA, blank
from tests.reference.scene import Scene, Soft
from tests.reference.search import Discard
from tests.reference.soft import strobe


def find(states, stiffness):
    """Truth for (n, 3) states x, x', A; not judged: what `tests.reference.soft` refuses, more than CAP entries."""
    ends, sides, _ = blank(states)
    judged = np.ones(len(states), dtype=bool)
    left, right = (Soft(place, stiffness, held(stiffness)) for place in (-1.0, 1.0))
    for lane, (x, v, amplitude) in enumerate(states):
        try:
            record = strobe(Scene(GAMMA, OMEGA, amplitude, left, right), x, v)
        except Discard:
            judged[lane] = False
            continue
        if record.count > CAP:
            judged[lane] = False
            continue
        ends[lane] = float(record.x), float(record.v)
        sides[lane, : record.count] = record.sides
    return Truth(ends, sides, judged)
