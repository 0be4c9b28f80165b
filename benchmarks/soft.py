"""Measures our strobe and the others between soft walls, and writes that part of the page and its picture."""

import numpy as np

from benchmarks import chart, harness, machine, page, sides, soft_rigid, truth
from benchmarks.sides import OURS
from benchmarks.work import CAP, GAMMA, OMEGA, RESTITUTION, SHARE, STIFFNESSES, draw, words

JUDGED = sides.SOFT["heyoka, batch"].states
ROUNDS = 5
FAR = 1e-2  # An end this far off, where no itinerary is told, is a contact missed and not the error of a step.
STIFF, LEVELS = STIFFNESSES[-1], (1e-6, 1e-11)
PICTURE = "soft_walls.png"
TITLE = (
    f"Strobe between soft walls at -1 and 1: omega {OMEGA}, gamma {GAMMA}, gamma2 such that a contact leaves "
    f"R = {RESTITUTION}, A in [0, 6]"
)


def compare(states, rounds, share):
    """{stiffness: rows (side, timing, verdict)}, ours first."""
    panels = {}
    for stiffness in STIFFNESSES:
        print(f"stiffness {stiffness:g}")
        us, others = sides.soft(stiffness, share)
        timings = harness.measure(us, others, states, rounds)
        true = truth.find(states[: JUDGED // share], stiffness)
        panels[stiffness] = [(side, t, truth.judge(t.ends, t.sides, true, FAR)) for side, t in timings.items()]
    return panels


def fastest(rows, level, but=()):
    """The fastest rival with every itinerary right and 99 % of ends within a level; None where there is none."""
    fair = [row for row in rows if row[0].method not in (OURS, *but) and not row[2].wrong and row[2].high <= level]
    return min(fair, key=lambda row: row[1].ratio[0], default=None)


def asked(panels, ratios):
    """Lines (what, asked, measured)."""
    most, (stiffness, damping) = soft_rigid.worst(ratios)
    where = f", at k2 = {words(stiffness)}, gamma2 = {damping:.3g}"
    lines = [("soft strobe over rigid strobe, same batch, the largest", "at most 2.5", page.spread(most) + where)]
    heyoka = [method for method in sides.SOFT if method.startswith("heyoka")]
    for level in LEVELS:
        for but, beside, bound in (([], "", "at least 100"), (heyoka, " but heyoka", "(to be printed)")):
            found = fastest(panels[STIFF], level, but)
            what = f"k2 = {words(STIFF)}: fastest rival{beside} with 99 % of errors below {level:g}, over ours"
            measured = f"{page.spread(found[1].ratio)}, {found[0].method} {found[0].setting}" if found else "none"
            lines.append((what, bound, measured))
    for stiffness, rows in panels.items():
        (_, timing, verdict), *others = rows
        least = min(others, key=lambda row: row[2].median)
        what = f"k2 = {words(stiffness)}: our median error; the least of a rival"
        lines.append((what, "(to be printed)", f"{verdict.median:.1e}; {least[2].median:.1e}, {least[0].method}"))
        lines.append((f"k2 = {words(stiffness)}: ours, ns per map", "(to be printed)", page.spread(timing.cost)))
    return lines


def table(panels):
    """One line a method and setting: for each stiffness the time over ours, the error, and what went wrong."""
    each = "k2 = {}: over ours | error: median, 99 % | wrong, no end"
    head = ["method", "setting", "states", *(each.format(words(stiffness)) for stiffness in panels)]
    lines = [f"| {' | '.join(head)} |", "| --- " * (3 + 3 * len(panels)) + "|"]
    for rows in zip(*panels.values(), strict=True):
        side = rows[0][0]
        lines.append(f"| {side.method} | {side.setting} | {side.states:,} | {' | '.join(map(cells, rows))} |")
    return "\n".join(lines)


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


def main(quick, out):
    """Measure and write the part of out/benchmarks.md and out/soft_walls.png."""
    share, rounds = (16, 2) if quick else (1, ROUNDS)
    states = draw(soft_rigid.STATES // share)
    ratios = soft_rigid.compare(states, rounds)
    panels = compare(states, rounds, share)
    chart.save_panels(out / PICTURE, panels, TITLE)
    picture = "Error against time per map between soft walls, for each method", PICTURE
    tables = soft_rigid.table(ratios), table(panels)
    text = page.body(picture, machine.describe(), asked(panels, ratios), tables, notes(rounds, panels))
    page.write(out / "benchmarks.md", text, "soft walls measured")
    print(f"{text}\n\nwritten: {out / 'benchmarks.md'}, {out / PICTURE}")
