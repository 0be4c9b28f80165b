"""What rounding leaves undecided: periods in one call against one by one, single precision against double."""

import jax.numpy as jnp
import numpy as np
import pytest

import jaxvibro as jv
from jaxvibro.scene.codes import Status
from tests.status_proof import draw

PERIODS = 4
pytestmark = pytest.mark.long


def eps(dtype):
    return float(jnp.finfo(dtype).eps)


def sizes(scene, states):
    """The largest length and speed of each lane: A, the walls' and the mass's."""
    size = np.asarray(scene.amplitude)
    for wall in scene.walls.values():
        swing = 0.0 if wall.motion is None else abs(wall.motion.amplitude)
        rate = 0.0 if wall.motion is None else wall.motion.harmonic * scene.frequency
        size = np.maximum(size, np.maximum(abs(wall.position) + swing, swing * rate))
    return np.maximum(size, np.max([np.maximum(abs(each.x), abs(each.v)) for each in states], axis=0))


@pytest.mark.parametrize("kind", [((False, 0), (False, 1)), ((True, 0), None)])
def test_periods_in_one_call_are_one_by_one_but_for_their_roundings(kind):
    scene, state = draw(np.random.default_rng(4), 1024, kind)
    whole, told = jv.strobe(scene, state, periods=PERIODS, slots=0)
    states, found = [state], []
    for _ in range(PERIODS):
        end, impacts = jv.strobe(scene, states[-1], slots=0)
        states, found = [*states, end], [*found, impacts]
    product, norms = np.eye(2), np.ones(1024)
    for each in states[-2:0:-1]:
        product = product @ np.asarray(jv.monodromy(scene, each))
        norms = norms + np.linalg.norm(product, axis=(1, 2))
    span = 2.0 * np.pi / np.asarray(scene.frequency)
    bound = 16.0 * eps(scene.dtype) * (1.0 + span) * sizes(scene, states) * norms
    count, slowest = sum(each.count for each in found), np.min([each.least_speed for each in found], axis=0)
    fair = (count == told.count) & (slowest > 1e-4) & (norms < 1e6) & (np.asarray(told.status) < Status.CAP)
    assert fair.sum() > 150, fair.sum()
    error = np.maximum(abs(whole.x - states[-1].x), abs(whole.v - states[-1].v))
    assert (error < bound)[fair].all(), np.sort((error / bound)[fair])[-5:]
    assert np.median((error / bound)[fair]) < 1e-2


def test_single_precision_decides_contacts_eight_roundings_deep():
    rng, count, single = np.random.default_rng(4), 1 << 14, np.float32
    amplitude, omega, x, v, phase, damping, bounce = (
        np.asarray(each, single)
        for each in (
            *(10.0 ** rng.uniform(-1.0, 1.0, (2, count))),
            *(rng.uniform(-1.0, 1.0, count), rng.normal(size=count)),
            *rng.uniform((0.0, 0.0, 0.0), (6.0, 1.0, 1.0), (count, 3)).T,
        )
    )

    def told(dtype, wall):
        given = (np.asarray(each, dtype) for each in (amplitude, omega, damping, bounce))
        scene = jv.make_scene(*given, (None, np.asarray(wall, dtype)), dtype=dtype)
        state = jv.State(*(np.asarray(each, dtype) for each in (x, v, phase)))
        return scene, state, *jv.strobe(scene, state, slots=0, clearance=True)

    top = 1e3 - np.asarray(told(np.float64, np.full(count, 1e3))[-1].least_clearance)
    turns = np.isfinite(top) & (top > x + 1e-3)
    top = np.where(turns, top, 3.0)
    ulp = eps(single) * np.max([abs(x), abs(v), amplitude, abs(top)], axis=0)
    wall = np.asarray(top - 10.0 ** rng.uniform(0.0, 3.0, count) * rng.choice([-1, 1], count) * ulp, single)
    turns &= wall > x + 1e-3
    wall = np.where(turns, wall, single(20.0))
    scene, state, end, impacts = told(np.float64, wall)
    short, less = told(single, wall)[2:]
    decided = turns & (abs(top - wall) > 8.0 * ulp)
    assert decided.sum() > 5_000
    assert np.array_equal((np.asarray(less.count) > 0)[decided], (np.asarray(impacts.count) > 0)[decided])
    matrix = np.linalg.norm(np.asarray(jv.monodromy(scene, state)), axis=(1, 2))
    bound = 16.0 * eps(single) * (1.0 + 2.0 * np.pi / omega) * sizes(scene, [state, end]) * (1.0 + matrix)
    calm = (np.asarray(impacts.count) == np.asarray(less.count)) & (np.asarray(impacts.least_speed) > 1e-2)
    calm &= np.isfinite(matrix)
    assert calm.sum() > 5_000
    error = np.maximum(abs(np.asarray(short.x, float) - end.x), abs(np.asarray(short.v, float) - end.v))
    assert (error < bound)[calm].all(), np.sort((error / bound)[calm])[-5:]
    assert np.median((error / bound)[calm]) < 0.05
