"""Measures all sides and writes the page and the picture. `benchmarks.run` starts it on one core."""

import argparse
import os
import pathlib

import jax

import jaxvibro
from benchmarks import branches, chart, derived, harness, machine, ours, page, sides, soft, truth
from benchmarks.work import CAP, GAMMA, OMEGA, RESTITUTION, draw

JUDGED = 4096
ROUNDS = 7
REPEATS = 2001
TITLE = f"Strobe of random states: omega {OMEGA}, gamma {GAMMA}, R {RESTITUTION}, A in [0, 6], walls at -1 and 1"


def pick(timings, method, setting=None):
    """The timing of a method at a setting, or at its fastest."""
    found = [t for side, t in timings.items() if side.method == method and setting in (None, side.setting)]
    return min(found, key=lambda timing: timing.cost[0]) if found else None


def compare(us, timings, single):
    """Lines (what, asked, measured) for the figures that were asked for; single: from measure_single."""
    (compiled, jitted), (_, plain) = single
    yard = pick(timings, sides.YARDSTICK)
    over = page.spread(harness.spread(yard.ours / yard.own)) if yard else "not measured"
    compiling = timings[us].first - 1e-9 * us.states * timings[us].cost[0]
    lines = [
        ("ours over the yardstick", "at most 8", over),
        ("heyoka in batches, its fastest setting, over ours", "at least 10", pick(timings, "heyoka, batch").ratio),
        ("diffrax Tsit5 1e-9 over ours", "at least 200", pick(timings, "diffrax Tsit5", "tol 1e-09").ratio),
        ("SciPy DOP853 1e-9 over ours", "at least 3,000", pick(timings, "SciPy DOP853", "tol 1e-09").ratio),
        ("a user's own vmap over ours", "(to be printed)", pick(timings, sides.VMAP).ratio),
        ("one state, warm jitted call, microseconds", "at most 30", jitted),
        ("one state, warm call without a jit, microseconds", "(to be printed)", plain),
        ("compile, batch: first call less a warm one, s", "at most 1.5", f"{compiling:.2f}"),
        ("compile, one state: first call, s", "at most 1.5", f"{compiled:.2f}"),
    ]
    return [(what, bound, value if isinstance(value, str) else page.spread(value)) for what, bound, value in lines]


def measure_single(state):
    """Of one state, by the user's jit of strobe and by strobe itself: seconds of the first call, and latency."""
    found = []
    for call in (jax.jit(jaxvibro.strobe), jaxvibro.strobe):
        start = ours.prepare_single(state, call)
        found.append((harness.clock(start)[0], harness.latency(start, REPEATS)))
    return found


def notes(yardstick, rounds, judged):
    """What a reader must know to read the table."""
    return (
        f"One core, every rival timed in turn with ours, {rounds} rounds; medians and quartiles of the "
        "processor time. Compiling is left out; the first call includes it.",
        f"The itinerary (sides, times) is recorded by every side but the yardstick. Impact cap of the rivals: {CAP}.",
        f"Errors against ball arithmetic on {judged.sum():,} of the first {judged.size:,} states: left out "
        "are those with an impact slower than 1e-2 (all chatter), a turning point within 1e-8 of a wall or an impact "
        "within 1e-9 of the end.",
        "Wrong itineraries are counted and left out of the errors. The yardstick gives none: an end off by more than "
        f"{truth.FAR:g} counts.",
        f"Yardstick: {yardstick}",
    )


def main(directory, quick, out):
    """Measure and write out/benchmarks.md and out/benchmarks.png."""
    share, rounds = (16, 2) if quick else (1, ROUNDS)
    states = draw(sides.STATES // share)
    single = measure_single(states[0])
    us, others, yardstick = sides.rigid(directory, share)
    print(f"yardstick: {yardstick}")
    timings = harness.measure(us, others, states, rounds)
    print("reference in ball arithmetic")
    true = truth.find(states[: JUDGED // share])
    rows = [(side, t, truth.judge(t.ends, t.sides, true)) for side, t in timings.items()]
    chart.save(out / "benchmarks.png", rows, TITLE)
    lines = notes(yardstick, rounds, true.judged)
    asked = compare(us, timings, single) + derived.compare(states, rounds) + branches.compare(rounds)
    picture = "Error against time per map, for each method", "benchmarks.png"
    text = page.body(picture, machine.describe(), asked, [page.table(rows)], lines)
    page.write(out / "benchmarks.md", text, "measured")
    print(f"{text}\n\nwritten: {out / 'benchmarks.md'}, {out / 'benchmarks.png'}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(prog="python -m benchmarks.run", description="Error against cost of the strobe.")
    parser.add_argument("--limit", metavar="DIR", default=os.environ.get("LIMIT"), help="where the yardstick is kept")
    parser.add_argument("--quick", action="store_true", help="fewer states and rounds, written to out/")
    parser.add_argument("--out", metavar="DIR", help="where to write (docs, or out when quick)")
    parser.add_argument("--soft", action="store_true", help="soft walls alone")
    given = parser.parse_args()
    out = pathlib.Path(given.out or ("out" if given.quick else "docs"))
    out.mkdir(parents=True, exist_ok=True)
    jax.config.update("jax_enable_x64", True)
    if not given.soft:
        main(given.limit, given.quick, out)
    soft.main(given.quick, out)
