"""Lanes that are given up, tiny states, and single precision."""

import subprocess
import sys

import jax.numpy as jnp
import numpy as np
import pytest

import jaxvibro as jv
from jaxvibro.attractors import tangent_growth
from jaxvibro.maps.iterate import iterate
from jaxvibro.scene.codes import Status
from tests.lanes import at
from tests.wild import Wild, lengths

SPENT = """
import jax, jax.numpy as jnp
from jax import lax
from jaxvibro.compiled.kernel_calls import call_as_kernel

def carried(a, spent):
    turn = lambda carry: (carry[0] + 1, 2.0 * carry[1], carry[2])
    return lax.while_loop(lambda carry: carry[0] < 3, turn, (jnp.int32(0), a, spent))[1]

print(jax.jit(lambda a, spent: call_as_kernel(carried, a, spent))(jnp.ones(4), jnp.float32(2.0)))
"""


def test_studies_keep_the_status_of_lanes_without_an_end():
    scene, start = Wild("rm", narrow=True).draw(np.random.default_rng(5), 256)
    status = np.asarray(jv.strobe(scene, start, slots=0)[1].status)
    assert 20 < (status == Status.CAP).sum() < 236
    free = jv.State(start.x, start.v, start.phase, np.zeros(256))
    run = iterate(scene, free, 2)
    laps = tangent_growth.run_tangents(scene, tangent_growth.start_tangents(free), 2)[1]
    swept = jv.sweep(scene, "damping", np.asarray(scene.damping)[None], free, settle=1, keep=1)
    for found, x in ((run.status, run.x), (laps.status, laps.x), (swept.status.values[0], swept.x.values[0].T)):
        assert (found[status >= Status.CAP] >= Status.CAP).all()
        assert np.isnan(x[-1][found >= Status.CAP]).all()
        assert np.isfinite(x[-1][found < Status.CAP]).all()
    lost = np.flatnonzero(status == Status.CAP)[0]
    one = at((scene, free), lost)
    with pytest.raises(jv.ArgumentError, match="must have a trajectory"):
        jv.simulate(*one, samples=4)


def test_a_start_that_is_tiny_beside_the_scene_ends_with_a_state():
    # one wall at 0 and no drive: what is left of the motion falls below all that can be squared
    scene = jv.make_scene(0.0, 1.0, 0.1, 0.5, (0.0, 1.0))
    size = 10.0 ** -np.arange(1.0, 308.0)
    for x, v in ((size, size), (size, 0.0 * size), (size, -size), (0.0 * size, -size), (0.0 * size, size)):
        end, impacts = jv.strobe(scene, jv.State(x, v), slots=0)
        assert (np.asarray(impacts.status) < Status.CAP).all()
        assert (np.abs(end.x) <= 2.0 * size).all()


def test_an_unused_operand_does_not_end_the_process():
    done = subprocess.run([sys.executable, "-c", SPENT], capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr[-500:]
    assert done.stdout.split() == ["[8.", "8.", "8.", "8.]"]


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
    eps = float(jnp.finfo(single).eps)
    ulp = eps * np.max([abs(x), abs(v), amplitude, abs(top)], axis=0)
    wall = np.asarray(top - 10.0 ** rng.uniform(0.0, 3.0, count) * rng.choice([-1, 1], count) * ulp, single)
    turns &= wall > x + 1e-3
    wall = np.where(turns, wall, single(20.0))
    scene, state, end, impacts = told(np.float64, wall)
    short, less = told(single, wall)[2:]
    decided = turns & (abs(top - wall) > 8.0 * ulp)
    assert decided.sum() > 5_000
    assert np.array_equal((np.asarray(less.count) > 0)[decided], (np.asarray(impacts.count) > 0)[decided])
    matrix = np.linalg.norm(np.asarray(jv.monodromy(scene, state)), axis=(1, 2))
    bound = 16.0 * eps * (1.0 + 2.0 * np.pi / omega) * lengths(scene, state, end) * (1.0 + matrix)
    calm = (np.asarray(impacts.count) == np.asarray(less.count)) & (np.asarray(impacts.least_speed) > 1e-2)
    calm &= np.isfinite(matrix)
    assert calm.sum() > 5_000
    error = np.maximum(abs(np.asarray(short.x, float) - end.x), abs(np.asarray(short.v, float) - end.v))
    assert (error < bound)[calm].all(), np.sort((error / bound)[calm])[-5:]
    assert np.median((error / bound)[calm]) < 0.05
