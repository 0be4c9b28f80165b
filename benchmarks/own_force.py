"""Measure this package and others under a nonlinear force: Duffing's oscillator between rigid walls."""

from functools import partial

import numpy as np

from benchmarks import chart, harness, page, rigid, sides, truth
from benchmarks.rows import Row, Topic
from benchmarks.sides import BY_SOLVER, OURS
from benchmarks.work import CUBIC, GAMMA, OMEGA, RESTITUTION, draw

JUDGED, ROUNDS = 1024, 7
FAR = 1e-2  # without an itinerary, an error of the end beyond this is a missed impact and not the error of a step
TITLE = (
    f"Strobe of Duffing's oscillator: omega {OMEGA}, gamma {GAMMA}, cubic {CUBIC}, R {RESTITUTION}, A in [0, 6], walls "
    "at -1 and 1"
)
# Name of a row, its methods, smallest required time relative to this package.
RIVALS = (
    ("diffrax with Event, fastest solver", ("diffrax Tsit5", "diffrax Dopri8"), 20),
    ("SciPy DOP853", ("SciPy DOP853",), 500),
    ("heyoka, batch", ("heyoka, batch",), 2.5),
)
UNLIKE = "no setting of jaxvibro is as accurate"


def measure(size):
    """Measure this part and return its `Topic`."""
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
    """Return the fastest timing of this package with a median error of at most `error`; None if there is none."""
    found = [(t, side) for side, t, verdict in judged if side.method == OURS and verdict.median <= error]
    return min(found, key=lambda each: np.median(each[0].own / each[0].ours), default=None)


def over(judged, method):
    """Compare the settings of a method with settings of this package that are at least as accurate.

    Returns [(times over this package at equal error, of each round; setting; this package)].
    """
    found = []
    for side, timing, verdict in judged:
        mine = as_exact(judged, verdict.median) if side.method == method else None
        if mine:
            ratio = timing.own / timing.ours / np.median(mine[0].own / mine[0].ours)
            found.append(
                (ratio, f"{side.method} {side.setting}, error {verdict.median:.1e}; jaxvibro {mine[1].setting}")
            )
    return found


def rows(judged):
    """Return the required rows: of each rival the best setting."""
    found = []
    for name, methods, bound in RIVALS:
        row = Row(f"{name}, at equal median error", "relative to jaxvibro", bound, least=True)
        settings = [each for method in methods for each in over(judged, method)]
        best = min(settings, key=lambda each: np.median(each[0]), default=None)
        found.append(row.of(*best) if best else row._replace(remark=UNLIKE))
    return found


def notes(rounds, judged):
    """Return the notes to the table."""
    return (
        f"One core; medians and quartiles of the processor time over {rounds} rounds. The runs of each row "
        "alternate with runs of jaxvibro at tolerance 1e-13. Only the time of the first call includes compilation.",
        "jaxvibro records no impacts; the other methods record the itinerary.",
        f"{BY_SOLVER}: steps of diffrax with the event detection of jaxvibro, as for a force without a Taylor series.",
        "At equal median error: the reference is the cheapest setting of jaxvibro whose median error is not larger. "
        "For each other method the row shows the setting with the smallest ratio.",
        f"Errors are measured against hand-coded Taylor series in 30 digits on {judged.sum():,} of the first "
        f"{judged.size:,} states, or on as many as a method receives. The other states have an impact slower "
        "than 1e-2, or a turning point or an end within 1e-8 of a wall.",
        "Wrong itineraries are counted and excluded from the errors. If a method records no itinerary, an end state "
        f"off by more than {FAR:g} counts as wrong.",
    )
