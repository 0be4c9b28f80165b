"""A status is never better than the state: lanes that are given up, and starts on a wall that are slow."""

import subprocess
import sys

import numpy as np
import pytest

import jaxvibro as jv
from jaxvibro.attractors import tangent_growth
from jaxvibro.flight.wall_positions import wall_states
from jaxvibro.maps.iterate import iterate
from jaxvibro.scene.codes import Status
from tests.lanes import at
from tests.status_proof import draw, judged

FIXED, MOVING, SOFT, SOFT_MOVING = (False, 0), (False, 1), (True, 0), (True, 1)
SPENT = """
import jax, jax.numpy as jnp
from jax import lax
from jaxvibro.compiled.kernel_calls import call_as_kernel

def carried(a, spent):
    turn = lambda carry: (carry[0] + 1, 2.0 * carry[1], carry[2])
    return lax.while_loop(lambda carry: carry[0] < 3, turn, (jnp.int32(0), a, spent))[1]

print(jax.jit(lambda a, spent: call_as_kernel(carried, a, spent))(jnp.ones(4), jnp.float32(2.0)))
"""


def capped(kind, count, periods):
    """(scene, start, status) of lanes in short gaps, of which many reach the cap."""
    scene, start = draw(np.random.default_rng(5), count, kind, short=True)
    end, impacts = jv.strobe(scene, start, periods=periods, slots=0)
    assert [each.sum() for each in judged(scene, end, impacts.status)] == [0, 0, 0]
    return scene, start, np.asarray(impacts.status)


@pytest.mark.parametrize(
    ("kind", "periods"), [((FIXED, MOVING), 1), pytest.param((SOFT, FIXED), 2, marks=pytest.mark.long)]
)
def test_a_lane_that_is_given_up_has_no_state(kind, periods):
    status = capped(kind, 2048, periods)[2]
    assert (status == Status.CAP).sum() > 200
    assert (status < Status.CAP).sum() > 200


def test_what_runs_lanes_on_keeps_the_status_of_those_that_are_given_up():
    scene, start, status = capped((FIXED, MOVING), 256, 1)
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


@pytest.mark.parametrize(
    "kind",
    [
        pytest.param((FIXED, None), marks=pytest.mark.long),
        (None, MOVING),
        pytest.param((SOFT, None), marks=pytest.mark.slow),
        pytest.param((None, SOFT_MOVING), marks=pytest.mark.long),
    ],
)
def test_a_slow_start_on_a_wall_goes_as_one_without_speed(kind):
    rng, count = np.random.default_rng(8), 4096
    scene, start = draw(rng, count, kind)
    left = kind[0] is not None
    place, pace = wall_states(scene, start.phase)[0 if left else 1]
    into = (-1.0 if left else 1.0) * 10.0 ** rng.uniform(-308.0, -9.0, count)
    into[::4] *= -1.0
    still, told = jv.strobe(scene, jv.State(place, pace, start.phase), slots=0)
    slow, also = jv.strobe(scene, jv.State(place, pace + into, start.phase), slots=0)
    status, other = np.asarray(told.status), np.asarray(also.status)
    assert (other < Status.CAP).mean() > 0.98
    assert np.array_equal(status < Status.CAP, other < Status.CAP)
    far = np.abs(np.asarray(slow.x - still.x)) / (1.0 + np.asarray(scene.amplitude))
    assert far[status < Status.CAP].max() < 1e-6


def test_a_start_that_is_tiny_beside_the_scene_ends_with_a_state():
    # one wall at 0 and no drive: what is left of the motion falls below all that can be squared
    scene = jv.make_scene(0.0, 1.0, 0.1, 0.5, (0.0, 1.0))
    size = 10.0 ** -np.arange(1.0, 308.0)
    for x, v in ((size, size), (size, 0.0 * size), (size, -size), (0.0 * size, -size), (0.0 * size, size)):
        end, impacts = jv.strobe(scene, jv.State(x, v), slots=0)
        assert (np.asarray(impacts.status) < Status.CAP).all()
        assert (np.abs(end.x) <= 2.0 * size).all()


def test_an_operand_that_is_found_to_be_of_no_use_does_not_end_the_process():
    done = subprocess.run([sys.executable, "-c", SPENT], capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr[-500:]
    assert done.stdout.split() == ["[8.", "8.", "8.", "8.]"]
