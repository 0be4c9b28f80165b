"""Measures our strobe and others under a force that is no spring: Duffing's oscillator between rigid walls."""

from functools import partial

import numpy as np

from benchmarks import chart, harness, page, rigid, sides, truth
from benchmarks.rows import Row, Topic
from benchmarks.sides import BY_SOLVER, OURS
from benchmarks.work import CUBIC, GAMMA, OMEGA, RESTITUTION, draw

JUDGED, ROUNDS = 1024, 7
FAR = 1e-2  # an end this far off, where no itinerary is told, is an impact missed and not the error of a step
TITLE = (
    f"Strobe of Duffing's oscillator: omega {OMEGA}, gamma {GAMMA}, cubic {CUBIC}, R {RESTITUTION}, A in [0, 6], walls "
    "at -1 and 1"
)
# name of a row, the methods it is of, times ours at least
RIVALS = (
    ("diffrax with Event, the fastest", ("diffrax Tsit5", "diffrax Dopri8"), 20),
    ("SciPy DOP853", ("SciPy DOP853",), 500),
    ("heyoka, batch", ("heyoka, batch",), 2.5),
)
UNLIKE = "none of ours is as exact"


def measure(size):
    """The `Topic`."""
    rounds, states = size.rounds(ROUNDS), draw(size.states(sides.MANY))
    timings = harness.measure(*sides.duffing(size), states, rounds)
    print("reference by Taylor series in 30 digits")
    true = truth.duffing(states[: size.states(JUDGED)])
    judged = [(side, t, truth.judge(t.ends, t.sides, true, FAR)) for side, t in timings.items()]
    judged = sorted(judged, key=lambda row: row[0].method == OURS and -float(row[0].setting.split()[1]))
    what = "Error against time per map of Duffing's oscillator, for each method"
    pictures = {"own_force.png": (what, partial(chart.save, rows=judged, title=TITLE))}
    table = page.table(rigid.HEAD, [rigid.cells(*each) for each in judged])
    return Topic("own force", rows(judged), (table,), notes(rounds, true.judged), pictures)


def as_exact(judged, error):
    """The timing of the cheapest of ours whose median error is at most so much; None where there is none."""
    found = [(t, side) for side, t, verdict in judged if side.method == OURS and verdict.median <= error]
    return min(found, key=lambda each: np.median(each[0].own / each[0].ours), default=None)


def over(judged, method):
    """[(times over ours at equal error, of each round; setting; ours)] of the settings of a method where one of ours is
    as exact."""
    found = []
    for side, timing, verdict in judged:
        mine = as_exact(judged, verdict.median) if side.method == method else None
        if mine:
            ratio = timing.own / timing.ours / np.median(mine[0].own / mine[0].ours)
            found.append((ratio, f"{side.method} {side.setting}, error {verdict.median:.1e}; ours {mine[1].setting}"))
    return found


def rows(judged):
    """What is asked: of each rival the setting at which it does best."""
    found = []
    for name, methods, bound in RIVALS:
        row = Row(f"{name}, at equal median error", "over ours", bound, least=True)
        settings = [each for method in methods for each in over(judged, method)]
        best = min(settings, key=lambda each: np.median(each[0]), default=None)
        found.append(row.of(*best) if best else row._replace(remark=UNLIKE))
    return found


def notes(rounds, judged):
    """What a reader must know to read the table."""
    return (
        f"One core, every line timed in turn with ours at tolerance 1e-13, {rounds} rounds; medians and quartiles of "
        "the processor time. Compiling is left out; the first call includes it. Ours records nothing, the others the "
        "itinerary.",
        f"{BY_SOLVER}: diffrax's steps behind our own search for impacts, as a force without Taylor series has them.",
        "At equal error: the cheapest of ours whose median error is not larger. Of each rival the row is of the "
        "setting that comes nearest to ours.",
        f"Errors against Taylor series by hand in 30 digits on {judged.sum():,} of the first {judged.size:,} states or "
        "as many as are given: left out are those with an impact slower than 1e-2, a turning point or an end within "
        "1e-8 of a wall.",
        "Wrong itineraries are counted and left out of the errors. Where none is recorded, an end off by more than "
        f"{FAR:g} counts.",
    )
