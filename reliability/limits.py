"""Measure behaviour at the limits of the method.

These are long elastic motions, sticking in narrow gaps, starts beyond walls, single floats, and derivatives next to a
grazing.
"""

import jax
import jax.numpy as jnp
import numpy as np

import jaxvibro as jv
from benchmarks.rows import Row
from jaxvibro.scene.state import Status

from . import cases, methods, near_grazing

ELASTIC, IMPACTS, A_PERIOD = 32, 1_000_000, 500
LANES = 1 << 20
STATES = 1 << 16
ORBITS = 24


def elastic(size):
    """Return rows of a free oscillator between elastic walls, 1e6 impacts; each takes the same time, by the arcsine."""
    rng, many = np.random.default_rng(0), size.states(IMPACTS)
    swing, wall = rng.uniform(1.5, 4.0, ELASTIC), rng.uniform(0.3, 1.2, ELASTIC)
    hop = 2.0 * np.arcsin(wall / swing)
    frequency, periods = 2.0 * np.pi / (A_PERIOD * hop), many // A_PERIOD
    scene = jv.make_scene(0.0, frequency, 0.0, 1.0, (-wall, wall))
    end, impacts = jv.strobe(scene, jv.State(np.zeros(ELASTIC), swing), periods=periods, slots=0)
    count = np.asarray(impacts.count)
    energy = np.max(abs(np.hypot(end.x, end.v) / swing - 1.0))
    # An even number of flights between the walls leads from the middle back to it.
    where = np.max(np.maximum(abs(end.x), abs(abs(np.asarray(end.v)) / swing - 1.0)))
    return [
        Row(f"elastic impacts, {many:,} in each of {ELASTIC} scenes: wrong counts", "scenes", 0).of(
            np.sum(abs(count - periods * A_PERIOD) > 1)
        ),
        Row("elastic impacts: drift of the energy", "relative", 1e-9).of(2.0 * energy),
        Row("elastic impacts: error of the final position", "lengths", 1e-6).of(where),
    ]


def narrow(size):
    """Return a row: a mass in a gap of 1e-12 to 1e-4 under a force of 1 to 10 ends up sticking to a wall."""
    rng, n = np.random.default_rng(1), size.states(LANES)
    place, gap, bounce = rng.uniform(-0.5, 0.5, n), cases.logarithmic(1e-12, 1e-4)(rng, n), rng.uniform(0.1, 0.7, n)
    amplitude = rng.uniform(1.0, 10.0, n)
    scene = jv.make_scene(amplitude, rng.uniform(0.5, 3.0, n), rng.uniform(0.0, 1.5, n), bounce, (place, place + gap))
    end, impacts = jv.strobe(scene, jv.State(place, rng.uniform(0.1, 1.0, n)), slots=0)
    rests = (np.asarray(end.x) == np.asarray(scene.right.position)) & (np.asarray(end.v) == 0.0)
    wrong = ~rests | (np.asarray(impacts.status) >= Status.CAP)
    return [
        Row(f"{n:,} sticking masses in gaps of 1e-12 to 1e-4 under a force: not at rest on the wall", "lanes", 0).of(
            wrong.sum()
        )
    ]


def beyond(size):
    """Return a row: starts beyond a wall, by 1e-12 to 1 of its position, are rejected."""
    rng, n = np.random.default_rng(2), size.states(LANES)
    wall = rng.uniform(0.5, 2.0, n)
    scene = jv.make_scene(rng.uniform(0.0, 5.0, n), rng.uniform(0.3, 5.0, n), 0.05, 0.7, (-wall, wall))
    x = rng.choice([-1.0, 1.0], n) * wall * (1.0 + cases.logarithmic(1e-12, 1.0)(rng, n))
    _, impacts = jv.strobe(scene, jv.State(x, rng.normal(size=n)), slots=0)
    return [
        Row(f"{n:,} initial states beyond a wall by 1e-12 of its position and more: not refused", "lanes", 0).of(
            np.sum(np.asarray(impacts.status) != Status.INVALID)
        )
    ]


def single(size):
    """Return rows of single precision on near grazes.

    They are the largest depth, in its ulp, that it decides wrongly, and itineraries and labels that differ from
    double's.
    """
    case = cases.CASES[0]
    wrong = []
    for k in range(len(case.shapes)):
        batch, _ = case.batch(size.states(STATES), k)
        rounded = batch._replace(lanes=type(batch.lanes)(*(each.astype(np.float32) for each in batch.lanes)))
        met = methods.ours(rounded, dtype=jnp.float32)
        unit = np.spacing(
            np.float32(np.maximum.reduce([*map(abs, batch.lanes[2:3] + batch.lanes[4:]), abs(batch.walls[0].position)]))
        )
        astray = (met.side != 0) != (batch.side != 0)
        wrong.append(np.max(abs(batch.measure) / unit, where=astray, initial=0.0))
    rng, n = np.random.default_rng(3), size.states(STATES)
    x, v, amplitude = rng.uniform(-1.0, 1.0, n), rng.uniform(-3.0, 3.0, n), rng.uniform(0.0, 6.0, n)
    sides = []
    for dtype in (jnp.float64, jnp.float32):
        scene = jv.make_scene(amplitude, 2.1, 0.05, 0.7, (-1.0, 1.0), dtype=dtype)
        _, impacts = jv.strobe(scene, jv.State(*(jnp.asarray(each, dtype) for each in (x, v))), slots=30)
        sides.append(np.asarray(impacts.side))
    differ = np.mean((sides[0] != sides[1]).any(1))
    return [
        Row("single precision: deepest contact decided wrongly", "single-precision ulp of the largest length").of(
            max(wrong)
        ),
        Row(
            f"single precision: itineraries of {n:,} random periods that differ from double precision", "per million"
        ).of(1e6 * differ),
        Row(
            f"single precision: labels of {size.states(ORBITS)} settled orbits that differ from double precision",
            "orbits",
        ).of(labels(size)),
    ]


def derivatives(size):
    """Return rows of derivatives by autodiff where the flight just misses the wall, and at the grazing itself."""
    return [
        Row(f"autodiff of a flight that misses the wall by {gap:g}: error", "relative to the largest entry", 1e-12).of(
            error
        )
        for gap, error in near_grazing.on_the_other_side()
    ]


def labels(size):
    """Count orbits of one period at random amplitudes whose label differs in single precision."""
    rng, differ = np.random.default_rng(4), 0
    for amplitude in rng.uniform(0.3, 4.4, size.states(ORBITS)):
        found = []
        for dtype in (jnp.float64, jnp.float32):
            scene = jv.make_scene(float(amplitude), 2.1, 0.05, 0.7, (-1.0, 1.0), dtype=dtype)
            end, _ = jv.strobe(
                scene, jv.State(*(jnp.asarray(each, dtype) for each in (0.9, -1.1))), periods=400, slots=0
            )
            _, impacts = jv.strobe(scene, end, slots=16)
            found.append([int(np.sum(np.asarray(impacts.side) == side)) for side in (-1, 1)])
        differ += found[0] != found[1]
    return differ


def measure(size):
    """Return all rows."""
    found = []
    for part in (elastic, narrow, beyond, single, derivatives):
        found += part(size)
        jax.clear_caches()
    return found
