"""Measure this package and the others between soft walls."""

from functools import partial

import numpy as np

from benchmarks import chart, harness, page, sides, soft_rigid, truth
from benchmarks.rows import Row, Topic
from benchmarks.sides import OURS
from benchmarks.work import CAP, GAMMA, OMEGA, RESTITUTION, SHARE, STIFFNESSES, draw, words

JUDGED = 1024
ROUNDS = 3
FAR = 1e-2  # without an itinerary, an error of the end beyond this is a missed contact, not the error of a step
STIFF, LEVELS = STIFFNESSES[-1], (1e-6, 1e-11)
TITLE = (
    f"Strobe between soft walls at -1 and 1: omega {OMEGA}, gamma {GAMMA}, gamma2 for an effective restitution "
    f"of {RESTITUTION}, A in [0, 6]"
)


def compare(states, rounds, size):
    """Return {stiffness: rows (side, timing, verdict)}, this package first."""
    panels = {}
    for stiffness in STIFFNESSES:
        print(f"stiffness {stiffness:g}")
        us, others = sides.soft(stiffness, size)
        timings = harness.measure(us, others, states, rounds)
        true = truth.find(states[: size.states(JUDGED)], stiffness)
        panels[stiffness] = [(side, t, truth.judge(t.ends, t.sides, true, FAR)) for side, t in timings.items()]
    return panels


def fastest(rows, level, but=()):
    """Return the fastest rival with every itinerary right and 99 % of ends within a level; None if there is none."""
    fair = [row for row in rows if row[0].method not in (OURS, *but) and not row[2].wrong and row[2].high <= level]
    return min(fair, key=lambda row: row[1].ratio[0], default=None)


def rows(panels, ratios):
    """Return the required rows."""
    most, (stiffness, damping) = soft_rigid.worst(ratios)
    where = f"at k2 = {words(stiffness)}, gamma2 = {damping:.3g}"
    found = [Row("slowest soft strobe, same batch", "relative to the rigid strobe", 2.5).of(most, where)]
    heyoka = [method for method in sides.SOFT if method.startswith("heyoka")]
    for level in LEVELS:
        for but, beside, bound in (([], "", 100), (heyoka, " except heyoka", None)):
            rival = fastest(panels[STIFF], level, but)
            what = f"k2 = {words(STIFF)}: fastest other method{beside} with 99 % of errors below {level:g}"
            row = Row(what, "relative to jaxvibro", bound, least=True)
            if rival:
                row = row.of(rival[1].own / rival[1].ours, f"{rival[0].method} {rival[0].setting}")
            found.append(row if rival else row._replace(remark="no other method is as accurate"))
    for stiffness, judged in panels.items():
        (_, timing, verdict), *others = judged
        least = min(others, key=lambda row: row[2].median)
        what = f"k2 = {words(stiffness)}: median error of jaxvibro"
        said = f"smallest of other methods {least[2].median:.1e}, {least[0].method}"
        found.append(Row(what, "dimensionless").of(verdict.median, said))
        found.append(Row(f"k2 = {words(stiffness)}: jaxvibro", "ns per map").of(timing.own))
    return found


def table(panels):
    """Format one line per method and setting: relative time, error and wrong itineraries for each stiffness."""
    head = ["method", "setting", "states"]
    for name in map(words, panels):
        head += [f"k2 = {name}: relative to jaxvibro", "error: median, 99 %", "wrong, unfinished"]
    lines = []
    for one in zip(*panels.values(), strict=True):
        side = one[0][0]
        lines.append((side.method, side.setting, f"{side.states:,}", *map(cells, one)))
    return page.table(head, lines)


def cells(row):
    """Format the three cells of a row."""
    _, timing, verdict = row
    lost = np.isnan(timing.ends[:JUDGED]).any(axis=1).sum()
    wrong = f"**{verdict.wrong}**, {lost}" if verdict.wrong or lost else "0"
    return f"{page.spread(timing.ratio)} | {verdict.median:.1e}, {verdict.high:.1e} | {wrong}"


def notes(rounds, panels):
    """Return the notes to the table."""
    judged = ", ".join(f"{rows[0][2].judged:,}" for rows in panels.values())
    return (
        f"gamma2 = z sqrt(1 + k2) with z = {SHARE:.4f}, for an effective restitution of {RESTITUTION}.",
        f"One core; medians and quartiles of the processor time over {rounds} rounds, without compilation. The runs "
        "of every other method alternate with runs of jaxvibro.",
        f"jaxvibro maps {sides.BESIDE:,} states in this comparison and {soft_rigid.STATES:,} in the comparison with "
        "the rigid strobe. All methods receive the first states of the same sample.",
        f"Absolute errors of x and x' are measured against ball arithmetic on the first {JUDGED:,} states, or on as "
        f"many as a method receives. In the order of the stiffnesses, {judged} states are evaluated; the "
        "other states have an entry slower than 1e-2.",
        "Wrong: a different itinerary (walls of the entries in order), or no end state because the integrator gave "
        f"up or had {CAP} entries. {sides.PLAIN} reports no itinerary; it is wrong if its end state is off by more "
        f"than {FAR:g}. Wrong results are excluded from the errors.",
        "Unfinished: all results without an end state, evaluated or not.",
    )


def measure(size):
    """Measure this part and return its `Topic`."""
    rounds, states = size.rounds(ROUNDS), draw(size.states(soft_rigid.STATES))
    ratios = soft_rigid.compare(states, rounds)
    panels = compare(states, rounds, size)
    what = "Error against time per map between soft walls, for each method"
    pictures = {"soft_walls.png": (what, partial(chart.save_panels, panels=panels, title=TITLE))}
    tables = soft_rigid.table(ratios), table(panels)
    return Topic("soft walls", rows(panels, ratios), tables, notes(rounds, panels), pictures)
