"""Measure the time to first results of a process without compiled code, and of one with a filled compilation cache."""

import json
import tempfile
from functools import partial

from benchmarks import fresh, pictures
from benchmarks.rows import Row, Topic

ROUNDS = 3
COLD, FILLING, WARM = "nothing compiled, no cache", "nothing compiled, filling the cache", "filled cache"
README = "readme"
# Requests in the order in which one process runs them, and required seconds: without and with a filled cache.
ASKED = {
    README: (
        ("strobe", 1, 0.4),
        ("find_orbit", 1.5, 0.6),
        ("branch table", 2.5, 1),
        ("switch", 3, 1.3),
        ("locus", 4, 2),
    ),
    "attractors": (("find_attractors", 5, 1.5),),
    "soft": (("soft walls: branch table", 8, None), ("soft walls: locus", 15, None)),
}
NOTES = (
    "Processor time of a process after `import jax`, including the import of jaxvibro. Python's bytecode files exist.",
    "The README lines run in one process, in this order, and their times are cumulative. `find_attractors` has a "
    "separate process, and so have the lines between soft walls (k2 = 400, gamma2 = 2).",
    "Runs that fill a cache use the compile cache of jax in a new folder; writing it takes the additional time. The "
    "filled cache is the one that `jaxvibro warm` creates. Lines that `warm` does not cover were run once before.",
)


def measure(size):
    """Measure this part and return its `Topic`."""
    rounds = 1 if size.quick else ROUNDS
    asked = {README: ASKED[README]} if size.quick else ASKED
    found = {COLD: [], FILLING: [], WARM: []}
    for what, answers in asked.items():
        if what == README:
            told(what)  # compiles Python's files
        seconds = {COLD: [told(what) for _ in range(rounds)], WARM: of_full_cache(what, rounds, size)}
        if what == README:
            seconds[FILLING] = [of_empty_cache(what) for _ in range(rounds)]
        for state, runs in seconds.items():
            for name, most, less in answers:
                bound = {COLD: most, WARM: less}.get(state)
                found[state].append(Row(name, f"seconds; {state}", bound).of([run[name] for run in runs]))
    title = "First results, cumulative: the README lines, and two other processes"
    drawn = partial(pictures.bars, groups=found, unit="processor time after import jax (s)", title=title)
    what = "Seconds to the first results of a fresh process, with nothing compiled and with a filled compile cache"
    return Topic(
        "first answers",
        [row for rows in found.values() for row in rows],
        notes=NOTES,
        pictures={"first_answers.png": (what, drawn)},
    )


def told(what, **environment):
    """Run a process and return {request: seconds}."""
    seconds = dict(json.loads(fresh.ask("benchmarks.fresh", what, **environment)))
    print(f"  {what}: {', '.join(f'{name} {spent:.2f}' for name, spent in seconds.items())}")
    return seconds


def of_empty_cache(what):
    """Return the seconds of a process that fills a cache."""
    with tempfile.TemporaryDirectory() as folder:
        return told(what, JAX_COMPILATION_CACHE_DIR=folder)


def of_full_cache(what, rounds, size):
    """Return the seconds of processes that use a filled cache."""
    with tempfile.TemporaryDirectory() as folder:
        settings = {"JAX_COMPILATION_CACHE_DIR": folder}
        if what == README and not size.quick:
            lines = fresh.ask("jaxvibro", "warm", XDG_CACHE_HOME=folder).splitlines()
            settings = dict(line.removeprefix("export ").split("=", 1) for line in lines if line.startswith("export "))
        else:
            settings |= {"JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0"}
            told(what, **settings)
        return [told(what, **settings) for _ in range(rounds)]
