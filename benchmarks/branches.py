"""Measure the cost of a branch point of P111 with multipliers and all monitors, single, under vmap, and with SciPy."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

import jaxvibro
from benchmarks import harness, ours, pictures, scipy_arclength
from benchmarks.rows import Row, Topic, spread
from continuation import arclength
from continuation.hostcall import compile_at_once
from jaxvibro.branches.follow import polish_orbit
from jaxvibro.compiled.lane_arithmetic import COMPILER_OPTIONS
from jaxvibro.problem import orbit_equations
from jaxvibro.problem.orbit_equations import IMPACT_PROBLEM

LANES, STEPS, POINTS, ROUNDS = 1_000, 32, 8, 9
LARGEST = (0.1, 0.05, 0.02, 0.01, 0.005)  # largest steps
POINT = {0.02: 30, 0.005: 20}  # required microseconds per point, by largest step
NOTES = (
    "`follow` computes the branch of P111 from A = 2 to 6 at the values of figure 4. The processor time of a warm "
    "call, with everything compiled, is divided by the number of points. The time includes multipliers, all monitors "
    "and special points.",
    f"SciPy: pseudo-arclength continuation of {POINTS} points with DOP853 at tolerance 1e-9 and central differences. "
    "Its runs alternate with runs of jaxvibro at the smallest steps.",
)


def measure(size):
    """Measure this part and return its `Topic`."""
    rounds, orbit = size.rounds(ROUNDS), jaxvibro.find_orbit(ours.scene(2.0), jaxvibro.State(0.9, -1.1))
    rows, curve = [], []
    for step in LARGEST:
        call = partial(followed, orbit, step)
        with compile_at_once():
            points = len(call())
        spent = harness.alone(call, rounds)
        per = 1e6 * spent / points
        curve.append((step, spread(per)))
        if step == LARGEST[0]:
            rows.append(Row(f"whole branch, steps of {step}", "milliseconds", 10).of(1e3 * spent, f"{points} points"))
        elif step in POINT:
            row = Row(f"one point, steps of {step}", "microseconds", POINT[step])
            rows.append(row.of(per, f"{points} points"))
    scipy, ratios = harness.in_turn(call, partial(scipy_arclength.branch, POINTS), size.rounds(5))
    together = many(orbit, size.states(LANES), rounds)
    rows.append(Row(f"{LANES:,} branches under vmap, with monitors", "microseconds per point", 6).of(together))
    rows.append(
        Row("SciPy arclength shooting, one point", "relative to jaxvibro", 500, least=True).of(ratios * points / POINTS)
    )
    levels = {"SciPy arclength shooting": 1e6 / POINTS * float(np.median(scipy))}
    levels[f"{LANES:,} branches of jaxvibro under vmap"] = float(np.median(together))
    panel = pictures.Panel("largest step (arclength)", "time per point of a branch (µs)", {"jaxvibro": curve}, levels)
    drawn = partial(pictures.curves, panels=[panel], title="P111 of figure 4, from A = 2 to 6; one core")
    what = "Microseconds per point of a branch over the largest step"
    return Topic("branches", rows, notes=NOTES, pictures={"branch_points.png": (what, drawn)})


def followed(orbit, step):
    """Follow P111 up to A = 6."""
    return jaxvibro.follow(orbit, "amplitude", (0.6, 6.0), "forward", step, step)


def many(orbit, lanes, rounds):
    """Measure branches under vmap that start at many amplitudes, tracked and then diagnosed at every point.

    Returns microseconds per point, one number per round.
    """
    along, z = polish_orbit(orbit, "amplitude")
    scale = along.weights(1.0)
    numbers = (jnp.asarray(each) for each in (1e-8, 0.1, 1e-10, 0.0, 1e3))
    control = arclength.StepControl(jnp.asarray(scale), *numbers)
    begun = jaxvibro.follow(orbit, "amplitude", (1.5, 2.5), "both", 0.01, 0.001)
    places = np.linspace(0, len(begun) - 1, lanes).astype(int)
    data = begun.data.isel(point=places)

    def columns(*names):
        return np.concatenate([np.reshape(data[name].values, (lanes, -1)) for name in names], axis=1)

    zs, tangents = columns("time", "speed", "amplitude"), columns("time_slope", "speed_slope", "value_slope")
    assert zs.shape[1] == len(z)
    start = arclength.TrackState(zs, tangents, np.full(lanes, 0.05), np.zeros(lanes, np.int32))

    def one(place, along):
        _, points = arclength.track_branch(IMPACT_PROBLEM.function, IMPACT_PROBLEM.solve, place, control, along, STEPS)
        return points.accepted, jax.vmap(lambda z: orbit_equations.impact_diagnostics(along, z, 1))(points.z)

    call = jax.jit(jax.vmap(one, in_axes=(0, None)), compiler_options=COMPILER_OPTIONS)
    jax.block_until_ready(call(start, along))
    spent = []
    for _ in range(rounds):
        seconds, (kept, _) = harness.clock(lambda: jax.block_until_ready(call(start, along)))
        spent.append(1e6 * seconds / float(kept.sum()))
    return np.array(spent)
