"""Measure this package and others between rigid walls: error against cost."""

from functools import partial

from benchmarks import chart, harness, page, sides, truth
from benchmarks.rows import Row, Topic
from benchmarks.work import CAP, GAMMA, OMEGA, RESTITUTION, draw

JUDGED, ROUNDS = 2048, 7
TITLE = f"Strobe of random states: omega {OMEGA}, gamma {GAMMA}, R {RESTITUTION}, A in [0, 6], walls at -1 and 1"
# (method, setting or None for the fastest, smallest required relative time without record, with four impacts recorded)
RIVALS = (
    ("heyoka, batch", None, 30, 25),
    ("diffrax Tsit5", "tol 1e-09", 500, 420),
    ("SciPy DOP853", "tol 1e-09", 8000, 6500),
)
HEAD = (
    *("method", "setting", "ns per map (quartiles)", "relative to jaxvibro (quartiles)", "wrong itineraries"),
    *("error: median", "99 %", "maximum", "first call (s)", "states"),
)


def measure(yardstick, size):
    """Measure this part and return its `Topic`; `yardstick` is the hand-written kernel's map, or None."""
    rounds, states = size.rounds(ROUNDS), draw(size.states(sides.STATES))
    us, others = sides.rigid(yardstick, size)
    timings = harness.measure(us, others, states, rounds)
    print("reference in ball arithmetic")
    true = truth.find(states[: size.states(JUDGED)])
    judged = [(side, t, truth.judge(t.ends, t.sides, true)) for side, t in timings.items()]
    picture = "Error against time per map, for each method", partial(chart.save, rows=judged, title=TITLE)
    table = page.table(HEAD, [cells(*each) for each in judged])
    return Topic("map", rows(timings), (table,), notes(rounds, true.judged), {"benchmarks.png": picture})


def pick(timings, method, setting):
    """Return the timing of a method at a setting, or at its fastest."""
    found = [t for side, t in timings.items() if side.method == method and setting in (None, side.setting)]
    return min(found, key=lambda timing: timing.cost[0])


def rows(timings):
    """Return the required rows: time of the rivals over this package, round by round, also with recorded impacts."""
    few = pick(timings, sides.OURS, sides.recording(4))
    slower, found = few.own / few.ours, []
    for method, setting, nothing, four in RIVALS:
        rival, name = pick(timings, method, setting), f"{method}, {setting or 'fastest setting'}"
        ratio = rival.own / rival.ours
        found.append(Row(name, "relative to jaxvibro, no impacts recorded", nothing, least=True).of(ratio))
        found.append(Row(name, "relative to jaxvibro, 4 impacts recorded", four, least=True).of(ratio / slower))
    lanes = pick(timings, sides.VMAP, None)
    return [
        *found,
        Row("jit(vmap) of a single strobe", "relative to jaxvibro, no impacts recorded").of(lanes.own / lanes.ours),
    ]


def cells(side, timing, verdict):
    """Return one line of the table; wrong itineraries in bold."""
    wrong = f"**{verdict.wrong}** of {verdict.judged}" if verdict.wrong else f"0 of {verdict.judged}"
    errors = (f"{error:.1e}" for error in (verdict.median, verdict.high, verdict.worst))
    cost, ratio = page.spread(timing.cost), page.spread(timing.ratio)
    return side.method, side.setting, cost, ratio, wrong, *errors, f"{timing.first:.2f}", f"{side.states:,}"


def notes(rounds, judged):
    """Return the notes to the table."""
    return (
        f"One core; medians and quartiles of the processor time over {rounds} rounds. The runs of every other method "
        "alternate with runs of jaxvibro without recorded impacts. Only the time of the first call includes "
        "compilation.",
        f"The other methods record the itinerary (walls and times) of up to {CAP} impacts, as jaxvibro does in its "
        f"last row. In the picture, jaxvibro appears with 0, 4 and {CAP} recorded impacts from left to right.",
        f"Errors are measured against ball arithmetic on {judged.sum():,} of the first {judged.size:,} states. "
        "The other states have an impact slower than 1e-2 (as in every chatter), a turning point within 1e-8 of a "
        "wall, or an impact within 1e-9 of the end.",
        "Wrong itineraries are counted and excluded from the errors. If a method records no itinerary, an end state "
        f"off by more than {truth.FAR:g} counts as wrong.",
    )
