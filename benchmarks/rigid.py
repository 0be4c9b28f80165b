"""Measures our strobe and others between rigid walls: error against cost."""

from functools import partial

from benchmarks import chart, harness, page, sides, truth
from benchmarks.rows import Row, Topic
from benchmarks.work import CAP, GAMMA, OMEGA, RESTITUTION, draw

JUDGED, ROUNDS = 2048, 7
TITLE = f"Strobe of random states: omega {OMEGA}, gamma {GAMMA}, R {RESTITUTION}, A in [0, 6], walls at -1 and 1"
# (method, setting or None for the fastest, times ours with nothing recorded at least, with four impacts)
RIVALS = (
    ("heyoka, batch", None, 30, 25),
    ("diffrax Tsit5", "tol 1e-09", 500, 420),
    ("SciPy DOP853", "tol 1e-09", 8000, 6500),
)
HEAD = (
    *("method", "setting", "ns per map (quartiles)", "over ours (quartiles)", "wrong itineraries"),
    *("error: median", "99 %", "worst", "first call, s", "states"),
)


def measure(yardstick, size):
    """The `Topic`. yardstick: its strobe, or None."""
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
    """The timing of a method at a setting, or at its fastest."""
    found = [t for side, t in timings.items() if side.method == method and setting in (None, side.setting)]
    return min(found, key=lambda timing: timing.cost[0])


def rows(timings):
    """What is asked: the rivals over ours, round by round; with impacts recorded too, which were timed beside ours."""
    few = pick(timings, sides.OURS, sides.recording(4))
    slower, found = few.own / few.ours, []
    for method, setting, nothing, four in RIVALS:
        rival, name = pick(timings, method, setting), f"{method}, {setting or 'its fastest setting'}"
        ratio = rival.own / rival.ours
        found.append(Row(name, "over ours, nothing recorded", nothing, least=True).of(ratio))
        found.append(Row(name, "over ours, 4 impacts recorded", four, least=True).of(ratio / slower))
    lanes = pick(timings, sides.VMAP, None)
    return [*found, Row("a user's own jit of a vmap", "over ours, nothing recorded").of(lanes.own / lanes.ours)]


def cells(side, timing, verdict):
    """One line of the table; wrong itineraries in bold."""
    wrong = f"**{verdict.wrong}** of {verdict.judged}" if verdict.wrong else f"0 of {verdict.judged}"
    errors = (f"{error:.1e}" for error in (verdict.median, verdict.high, verdict.worst))
    cost, ratio = page.spread(timing.cost), page.spread(timing.ratio)
    return side.method, side.setting, cost, ratio, wrong, *errors, f"{timing.first:.2f}", f"{side.states:,}"


def notes(rounds, judged):
    """What a reader must know to read the table."""
    return (
        f"One core, every rival timed in turn with ours with nothing recorded, {rounds} rounds; medians and quartiles "
        "of the processor time. Compiling is left out; the first call includes it.",
        f"The rivals record the itinerary (sides, times), {CAP} impacts at most, as ours does in its last "
        "line; in the picture ours from left to right: nothing, 4, and so many impacts recorded.",
        f"Errors against ball arithmetic on {judged.sum():,} of the first {judged.size:,} states: left out "
        "are those with an impact slower than 1e-2 (all chatter), a turning point within 1e-8 of a wall or an impact "
        "within 1e-9 of the end.",
        "Wrong itineraries are counted and left out of the errors. Where none is recorded, an end off by more than "
        f"{truth.FAR:g} counts.",
    )
