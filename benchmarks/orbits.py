"""Measure the cost of orbits: by Newton's method, single and batched, and of all of `find_orbit`."""

from functools import partial

import jax
import numpy as np

import jaxvibro
from benchmarks import harness, ours, pictures
from benchmarks.rows import Row, Topic, spread
from continuation.hostcall import compile_at_once
from jaxvibro.compiled.kernel_calls import call_as_kernel
from jaxvibro.orbits import impact_equations
from jaxvibro.orbits.orbit_from_impacts import padded_sequence

MANY, REPEATS, ROUNDS = 10_000, 501, 7
NOTES = (
    "The orbit is P111 at A = 2 of figure 4. Newton's method starts from impact times that are wrong by 0.01; "
    "`find_orbit` starts from the state of the orbit and includes all checks.",
    "One orbit is timed in wall-clock time, many orbits in processor time.",
)


def measure(size):
    """Measure this part and return its `Topic`."""
    scene = ours.scene(2.0)
    orbit = jaxvibro.find_orbit(scene, jaxvibro.State(0.9, -1.1))
    guess = padded_sequence(scene, orbit.impacts.time + 0.01, orbit.impacts.speed, orbit.impacts.side, 0.0, 1)
    kernel = jax.jit(lambda scene, guess: call_as_kernel(impact_equations.solve_sequence, scene, guess))
    seconds, one = harness.clock(lambda: kernel.lower(scene, guess).compile())
    newton = harness.latency(lambda: jax.block_until_ready(one(scene, guess)), size.rounds(REPEATS))
    with compile_at_once():
        jaxvibro.find_orbit(scene, orbit.state, 1, settle=0)
    whole = harness.latency(lambda: jaxvibro.find_orbit(scene, orbit.state, 1, settle=0), size.rounds(101))
    counts = [size.states(n) for n in size.few((100, 1000, MANY))]
    many = [(n, *together(scene, guess, n, size.rounds(ROUNDS))) for n in counts]
    rows = [
        Row("one orbit by Newton's method", "microseconds", 200).of(newton),
        Row("find_orbit without a transient", "microseconds").of(whole),
        Row(f"{MANY:,} orbits under vmap", "microseconds per orbit", 5).of(many[-1][1]),
        Row("one orbit", "seconds for tracing and compilation").of(seconds),
        Row(f"{MANY:,} orbits", "seconds for tracing and compilation").of(many[-1][2]),
    ]
    curve = [(1, spread(newton)), *((n, spread(each)) for n, each, _ in many)]
    panel = pictures.Panel(
        "orbits solved together",
        "time per orbit (µs)",
        {"jaxvibro, Newton's method on the impacts": curve},
        {"find_orbit, one orbit with all checks": spread(whole)[0], f"target for {MANY:,}: at most 5": 5.0},
    )
    drawn = partial(pictures.curves, panels=[panel], title="P111 of figure 4, A = 2; one core")
    picture = "Microseconds per orbit over the number of orbits solved together", drawn
    return Topic("orbits", rows, notes=NOTES, pictures={"orbits.png": picture})


def together(scene, guess, count, rounds):
    """Measure `count` orbits in one batch from nearby guesses.

    Returns microseconds per orbit, one number per round, and the seconds to compile.
    """
    off = 0.01 * np.random.default_rng(0).normal(size=(count, 2))
    guesses = jax.tree.map(lambda each: np.broadcast_to(each, (count, *np.shape(each))).copy(), guess)
    guesses = guesses._replace(times=guesses.times + off)
    batch = jax.jit(jax.vmap(impact_equations.solve_sequence, in_axes=(None, 0)))
    seconds, many = harness.clock(lambda: batch.lower(scene, guesses).compile())
    return 1e6 / count * harness.alone(lambda: jax.block_until_ready(many(scene, guesses)), rounds), seconds
