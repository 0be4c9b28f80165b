"""Measure the cost of a point of a locus in amplitude and frequency: the time of `jaxvibro.locus` over its points."""

from functools import partial

import jaxvibro
from benchmarks import harness, ours, pictures
from benchmarks.rows import Row, Topic
from continuation.hostcall import compile_at_once

ROUNDS, STEP = 7, 0.005
ASKED = {"SN": 60, "PD": 150, "SB": 150, "GR": 40}  # largest microseconds per point
BOUNDS = {"amplitude": (0.0, 12.0), "frequency": (1.2, 3.0)}
NOTES = (
    f"`locus` runs with steps of {STEP} at the values of figure 4, for A from 0 to 12 and omega from 1.2 to 3. The "
    "processor time of a warm call, with everything compiled, is divided by the number of points. The time includes "
    "points of codimension two and ends.",
)


def measure(size):
    """Measure this part and return its `Topic`."""
    orbit = jaxvibro.find_orbit(ours.scene(2.0), jaxvibro.State(0.9, -1.1))
    branch = jaxvibro.follow(orbit, "amplitude", (0.0, 6.0))
    lopsided = jaxvibro.switch(branch.points("SB")[0])[1]
    asked = [(branch, "SN"), (branch, "SB"), (branch, "GR"), (lopsided, "SN"), (lopsided, "PD"), (lopsided, "GR")]
    rows = []
    for start, kind in size.few(asked):
        call = partial(jaxvibro.locus, start.points(kind)[0], tuple(BOUNDS), BOUNDS, largest_step=STEP)
        with compile_at_once():
            locus = call()
        per = 1e6 * harness.alone(call, size.rounds(ROUNDS)) / len(locus)
        row = Row(f"{kind} of {locus.label}", "microseconds per point", ASKED[kind])
        rows.append(row.of(per, f"{len(locus)} points"))
    title = f"Loci in amplitude and frequency, steps of {STEP}, with all searches along them"
    drawn = partial(pictures.bars, groups={"locus": rows}, unit="time per point of a locus (µs)", title=title)
    what = "Microseconds per point of a locus, by kind"
    return Topic("loci", rows, notes=NOTES, pictures={"loci.png": (what, drawn)})
