"""Measure the map against a hand-written kernel, and its time by batch size, periods and recorded impacts."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import jaxvibro
from benchmarks import harness, pictures
from benchmarks.rows import Row, Topic, spread
from benchmarks.sides import STATES, YARDSTICK
from benchmarks.work import GAMMA, OMEGA, RESTITUTION, draw
from tests.properties.test_wild_scenes import fast

ROUNDS, REPEATS = 21, 1001
LEAST = 20_000  # smallest number of maps in a timed call; smaller batches are mapped several times
LONG = 1000  # periods
PER_MAP = "time per map (ns)"
YARD, STILL = "relative to the hand-written kernel", "relative to two fixed walls"


class Work(NamedTuple):
    """Batch of states to map: number of walls, moving or not; `ordered` sorts by A, so that neighbours are similar."""

    states: int = STATES
    slots: int = 0
    clearance: bool = False
    periods: int = 1
    walls: int = 2
    moving: bool = False
    ordered: bool = False

    @property
    def rows(self):
        """Draw (n, 3) states x, x', A, between the walls."""
        rows = draw(self.states)
        rows = rows[np.argsort(rows[:, 2])] if self.ordered else rows
        return rows * [0.8, 1.0, 1.0] if self.moving else rows

    @property
    def given(self):
        """Return the scene and the states."""
        x, v, amplitude = jnp.asarray(self.rows.T)
        swing = jaxvibro.Motion(0.1, 0.3, 1) if self.moving else None
        left, right = (jaxvibro.Wall(place, motion=swing) for place in (-1.0, 1.0))
        walls = (left if self.walls == 2 else None, right)
        return jaxvibro.make_scene(amplitude, OMEGA, GAMMA, RESTITUTION, walls), jaxvibro.State(x, v)

    @property
    def times(self):
        """Number of times that a timed call maps the batch."""
        return max(1, LEAST // (self.states * self.periods))

    def ours(self):
        """Make a call that maps the batch with this package."""
        scene, state = self.given
        asked = {"periods": self.periods, "slots": self.slots, "clearance": self.clearance}
        return harness.repeated(lambda: jax.block_until_ready(jaxvibro.strobe(scene, state, **asked)), self.times)

    def yardstick(self, strobe):
        """Make a call that maps the batch with the hand-written kernel."""
        return harness.repeated(partial(strobe, self.rows, periods=self.periods), self.times)


MANY = f"{STATES:,} states"
ASKED = {  # each row, its work, and that of ours that it is measured against in place of the yardstick
    Row(f"{MANY}, no impacts recorded", YARD, 3.5): (Work(), None),
    Row(f"{MANY}, 4 impacts recorded", YARD, 4.5): (Work(slots=4), None),
    Row(f"{MANY}, 4 impacts and minimum clearance", YARD, 5.5): (Work(slots=4, clearance=True), None),
    Row(f"{MANY}, one wall, no impacts recorded", STILL, 0.8): (Work(walls=1), Work()),
    Row(f"{MANY}, two moving walls, no impacts recorded", STILL, 1.8): (Work(moving=True), Work(moving=False)),
    Row(f"1,024 states sorted by A, {LONG:,} periods", YARD, 4.5): (Work(1024, periods=LONG, ordered=True), None),
    Row("batches of 1,000, no impacts recorded", YARD, 5): (Work(1000), None),
    Row("batches of 1,000,000, no impacts recorded", YARD, 4): (Work(10**6), None),
}
NOTES = (
    "The hand-written kernel records no impacts and supports two fixed walls only. Moving walls have the "
    "amplitude 0.1 and the period of the drive.",
    "The times are processor times of warm calls from the host. Each row is timed between two measurements of its "
    "reference.",
    "The rows with one state use the state of the README and wall-clock time. In jit, x and v are arguments, and the "
    "scene is a constant or an argument.",
)


def measure(strobe, size):
    """Measure this part and return its `Topic`; `strobe` is the hand-written kernel's map, or None."""
    rows = [compared(row, *pair, strobe, size) for row, pair in ASKED.items()] + single(size)
    what = "Nanoseconds per map over the batch size, the periods per call, and the recorded impacts"
    title = f"omega {OMEGA}, gamma {GAMMA}, R {RESTITUTION}, A in [0, 6], walls at -1 and 1; one core"
    drawn = partial(pictures.curves, panels=scaling(strobe, size), title=title)
    return Topic("yardstick", rows, notes=NOTES, pictures={"scaling.png": (what, drawn)})


def small(work, size):
    """Return the work at a size."""
    periods = max(1, work.periods // 100) if size.quick else work.periods
    return work._replace(states=size.states(work.states), periods=periods)


def compared(row, work, against, strobe, size):
    """Return the row of some work, measured against other work or the hand-written kernel."""
    work = small(work, size)
    if against is None and strobe is None:
        return row
    remark = f"{100 * in_full(work):.2f} % of periods by full steps" if work.periods > 1 else ""
    base = work.yardstick(strobe) if against is None else small(against, size).ours()
    heavy = work.states * work.periods > 500_000
    _, ratios = harness.in_turn(base, work.ours(), size.rounds(7 if heavy else ROUNDS))
    print(f"{row.what}: {np.median(ratios):.2f}")
    return row.of(ratios, remark)


def in_full(work):
    """Return the fraction of periods that the fast path gives up, for lanes that continue by the map of one period."""
    scene, state = work.given
    given_up = []
    for _ in range(work.periods):
        given_up.append(np.mean(fast(scene, state)[1]))
        state, _ = jaxvibro.strobe(scene, state, slots=0)
    return float(np.mean(given_up))


def single(size):
    """Return the rows of a single state."""
    x, v = jnp.asarray(0.9), jnp.asarray(-1.1)
    scene = jaxvibro.make_scene(2.0, OMEGA, GAMMA, RESTITUTION, (-1.0, 1.0))
    state = jaxvibro.State(x, v)
    known = jax.jit(lambda x, v: jaxvibro.strobe(scene, jaxvibro.State(x, v)))
    handed = jax.jit(jaxvibro.strobe)
    calls = {
        Row("one state, from the host", "microseconds", 100): lambda: jaxvibro.strobe(scene, state),
        Row("one state, in jit", "microseconds", 40): lambda: known(x, v),
        Row("one state, in jit, scene as argument", "microseconds"): lambda: handed(scene, state),
    }
    found = []
    for row, call in calls.items():
        jax.block_until_ready(call())
        found.append(row.of(harness.latency(lambda call=call: jax.block_until_ready(call()), size.rounds(REPEATS))))
    return found


def scaling(strobe, size):
    """Return the panels: nanoseconds per map against batch size, periods and recorded impacts."""

    def points(works, own=None):
        return [(n, cost(work, size.rounds(9), own)) for n, work in works.items()]

    batches = {n: Work(size.states(n)) for n in size.few((16, 128, 1024, 8192, 65_536, 524_288))}
    periods = {n: Work(size.states(1024), periods=n, ordered=True) for n in size.few((1, 10, 100, LONG))}
    first, second = ({"jaxvibro, no impacts recorded": points(works)} for works in (batches, periods))
    first["jaxvibro, 4 impacts and minimum clearance"] = points(
        {n: work._replace(slots=4, clearance=True) for n, work in batches.items()}
    )
    if strobe:
        first[YARDSTICK], second[YARDSTICK] = points(batches, strobe), points(periods, strobe)
    third = {}
    for words, clearance in (("without", False), ("with", True)):
        works = {n: Work(size.states(STATES), n, clearance) for n in size.few((0, 4, 8, 16, 32))}
        third[f"jaxvibro, {words} minimum clearance"] = points(works)
    return (
        pictures.Panel("states in the batch", PER_MAP, first),
        pictures.Panel("periods in one call (1,024 states sorted by A)", PER_MAP, second),
        pictures.Panel(f"impacts recorded ({STATES:,} states)", PER_MAP, third, scale="linear"),
    )


def cost(work, rounds, strobe=None):
    """Return the nanoseconds per map of this package or the hand-written kernel: median and quartiles."""
    call = work.yardstick(strobe) if strobe else work.ours()
    rounds = max(2, rounds // 3) if work.states * work.periods > 500_000 else rounds
    return spread(1e9 * harness.alone(call, rounds) / (work.states * work.periods * work.times))
