"""Measures our strobe and the others between soft walls."""

from functools import partial

import numpy as np

from benchmarks import chart, harness, page, sides, soft_rigid, truth
from benchmarks.rows import Row, Topic
from benchmarks.sides import OURS
from benchmarks.work import CAP, GAMMA, OMEGA, RESTITUTION, SHARE, STIFFNESSES, draw, words

JUDGED = 1024
ROUNDS = 3
FAR = 1e-2  # An end this far off, where no itinerary is told, is a contact missed and not the error of a step.
STIFF, LEVELS = STIFFNESSES[-1], (1e-6, 1e-11)
TITLE = (
    f"Strobe between soft walls at -1 and 1: omega {OMEGA}, gamma {GAMMA}, gamma2 such that a contact leaves "
    f"R = {RESTITUTION}, A in [0, 6]"
)


def compare(states, rounds, size):
    """{stiffness: rows (side, timing, verdict)}, ours first."""
    panels = {}
    for stiffness in STIFFNESSES:
        print(f"stiffness {stiffness:g}")
        us, others = sides.soft(stiffness, size)
        timings = harness.measure(us, others, states, rounds)
        true = truth.find(states[: size.states(JUDGED)], stiffness)
        panels[stiffness] = [(side, t, truth.judge(t.ends, t.sides, true, FAR)) for side, t in timings.items()]
    return panels


def fastest(rows, level, but=()):
    """The fastest rival with every itinerary right and 99 % of ends within a level; None where there is none."""
    fair = [row for row in rows if row[0].method not in (OURS, *but) and not row[2].wrong and row[2].high <= level]
    return min(fair, key=lambda row: row[1].ratio[0], default=None)


def rows(panels, ratios):
    """What is asked."""
    most, (stiffness, damping) = soft_rigid.worst(ratios)
    where = f"at k2 = {words(stiffness)}, gamma2 = {damping:.3g}"
    found = [Row("soft strobe, same batch, the slowest", "over rigid strobe", 2.5).of(most, where)]
    heyoka = [method for method in sides.SOFT if method.startswith("heyoka")]
    for level in LEVELS:
        for but, beside, bound in (([], "", 100), (heyoka, " but heyoka", None)):
            rival = fastest(panels[STIFF], level, but)
            what = f"k2 = {words(STIFF)}: fastest rival{beside} with 99 % of errors below {level:g}"
            row = Row(what, "over ours", bound, least=True)
            if rival:
                row = row.of(rival[1].own / rival[1].ours, f"{rival[0].method} {rival[0].setting}")
            found.append(row if rival else row._replace(remark="no rival is as exact"))
    for stiffness, judged in panels.items():
        (_, timing, verdict), *others = judged
        least = min(others, key=lambda row: row[2].median)
        what = f"k2 = {words(stiffness)}: our median error"
        said = f"the least of a rival {least[2].median:.1e}, {least[0].method}"
        found.append(Row(what, "dimensionless").of(verdict.median, said))
        found.append(Row(f"k2 = {words(stiffness)}: ours", "ns per map").of(timing.own))
    return found


def table(panels):
    """One line a method and setting: for each stiffness the time over ours, the error, and what went wrong."""
    head = ["method", "setting", "states"]
    for name in map(words, panels):
        head += [f"k2 = {name}: over ours", "error: median, 99 %", "wrong, no end"]
    lines = []
    for one in zip(*panels.values(), strict=True):
        side = one[0][0]
        lines.append((side.method, side.setting, f"{side.states:,}", *map(cells, one)))
    return page.table(head, lines)


def cells(row):
    """The three cells of a row."""
    _, timing, verdict = row
    lost = np.isnan(timing.ends[:JUDGED]).any(axis=1).sum()
    wrong = f"**{verdict.wrong}**, {lost}" if verdict.wrong or lost else "0"
    return f"{page.spread(timing.ratio)} | {verdict.median:.1e}, {verdict.high:.1e} | {wrong}"


def notes(rounds, panels):
    """What a reader must know to read the table."""
    judged = ", ".join(f"{rows[0][2].judged:,}" for rows in panels.values())
    return (
        f"gamma2 = z sqrt(1 + k2), z = {SHARE:.4f}: a contact leaves R = {RESTITUTION} of the speed. Every rival timed "
        f"in turn with ours, {rounds} rounds on one core; medians and quartiles of the processor time; compiling is "
        f"left out. Ours maps {sides.BESIDE:,} states beside them, and {soft_rigid.STATES:,} beside the rigid "
        "strobe; all are given the first states of the same draw.",
        f"Errors, of x and x' as they are, against ball arithmetic on the first {JUDGED:,} states or as many as the "
        f"rival is given; judged are {judged} of them, the others have an entry slower than 1e-2.",
        "Wrong: another itinerary (sides of the entries in order), or no end as the integrator gave up or had "
        f"{CAP} entries; the second number counts those without an end, judged or not. {sides.PLAIN} tells "
        f"no itinerary: an end off by more than {FAR:g} is wrong. What is wrong is left out of the errors.",
    )


def measure(size):
    """The `Topic`."""
    rounds, states = size.rounds(ROUNDS), draw(size.states(soft_rigid.STATES))
    ratios = soft_rigid.compare(states, rounds)
    panels = compare(states, rounds, size)
    what = "Error against time per map between soft walls, for each method"
    pictures = {"soft_walls.png": (what, partial(chart.save_panels, panels=panels, title=TITLE))}
    tables = soft_rigid.table(ratios), table(panels)
    return Topic("soft walls", rows(panels, ratios), tables, notes(rounds, panels), pictures)
