"""Measure nanoseconds per map and seconds to compile by walls and force, each kind of scene in its own process.

`python -m benchmarks.scenes WALLS MOVING SOFT FORCE STATES ROUNDS` measures one kind and prints JSON.
"""

import json
import sys

import jax
import jax.numpy as jnp

import jaxvibro
from benchmarks import fresh, harness, page
from benchmarks.rows import Topic, spread
from benchmarks.work import GAMMA, OMEGA, RESTITUTION, draw, held

STATES, ROUNDS = 32_768, 9
STIFFNESS = 1e4  # of soft walls, with the damping that leaves as much of a speed as the rigid ones do
ASKED = {
    "no impacts recorded": (0, False),
    "4 impacts recorded": (4, False),
    "4 impacts and minimum clearance": (4, True),
}
FORCES = [  # in place of spring and damper, and the tolerance; None: these
    (None, None),
    *(("duffing", tolerance) for tolerance in (1e-13, 1e-9, 1e-6)),
    *((name, 1e-13) for name in ("pendulum", "stribeck", "van_der_pol")),
]
NUMBERS = {
    "duffing": {"cubic": 0.5, "damping": GAMMA},
    "pendulum": {"damping": GAMMA},
    "stribeck": {"belt": 0.3, "low": 0.1, "high": 0.25, "slip": 0.8, "smooth": 0.4},
    "van_der_pol": {"gain": 0.2},
}
KINDS = [
    (0, 0, 0, 0),
    *((walls, moving, soft, 0) for soft in (0, 1) for walls in (1, 2) for moving in (0, 1)),
    *((2, 0, 0, force) for force in range(1, len(FORCES))),
]
WALLS = ("no walls", "one wall", "two walls")
HEAD = ("scene", *(f"ns per map: {name}" for name in ASKED), "compile time (s), no impacts recorded")
NOTES = (
    f"One core; medians and quartiles of warm calls with {STATES:,} random states like those of figure 4. Between "
    "moving walls the initial positions lie in the middle 0.8 of the gap.",
    "Moving walls have the amplitude 0.1 and the period of the drive. Soft walls have k2 = 1e4 and the effective "
    "restitution 0.7.",
    "Compile time: processor time of the first strobe of a fresh process without a compile cache, minus that of a "
    "warm strobe.",
)


def measure(size):
    """Measure this part and return its `Topic`."""
    lines = []
    for walls, moving, soft, force in size.few(KINDS):
        words = WALLS[walls] + (f", {'soft' if soft else 'rigid'}, {'moving' if moving else 'fixed'}" if walls else "")
        name, tolerance = FORCES[force]
        words += f", {name}, tolerance {tolerance:g}" if force else ""
        given = map(str, (walls, moving, soft, force, size.states(STATES), size.rounds(ROUNDS)))
        seconds, *costs = json.loads(fresh.ask("benchmarks.scenes", *given))
        print(f"  {words}: {seconds:.2f} s, {', '.join(map(page.spread, costs))} ns")
        lines.append((words, *map(page.spread, costs), f"{seconds:.2g}"))
    return Topic("scenes", [], (page.table(HEAD, lines),), NOTES)


def given(walls, moving, soft, force, states):
    """Return the scene of a kind, and states."""
    swing = jaxvibro.Motion(0.1, 0.3, 1) if moving else None
    hard = {"stiffness": STIFFNESS, "damping": held(STIFFNESS)} if soft else {}
    left, right = (jaxvibro.Wall(place, motion=swing, **hard) for place in (-1.0, 1.0))
    x, v, amplitude = jnp.asarray((draw(states) * [0.8 if moving else 1.0, 1.0, 1.0]).T)
    pair = (left if walls == 2 else None, right if walls else None)
    name, tolerance = FORCES[force]
    own = jaxvibro.Force(name, NUMBERS[name], tolerance) if name else None
    damping = None if own else GAMMA
    scene = jaxvibro.make_scene(amplitude, OMEGA, damping, RESTITUTION, pair, force=own)
    return scene, jaxvibro.State(x, v)


def main(walls, moving, soft, force, states, rounds):
    """Measure a kind: seconds to compile, then nanoseconds for all settings."""
    jax.config.update("jax_enable_x64", True)
    scene, state = given(walls, moving, soft, force, states)
    found = []
    for slots, clearance in ASKED.values():

        def call(slots=slots, clearance=clearance):
            jax.block_until_ready(jaxvibro.strobe(scene, state, slots=slots, clearance=clearance))

        first, _ = harness.clock(call)
        warm = spread(harness.alone(call, rounds))
        found = found or [first - warm[0]]
        found.append([1e9 * each / states for each in warm])
    print(json.dumps(found))


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
