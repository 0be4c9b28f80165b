"""Which scenes take the fast path, lanes near its limits, strips of lanes, tiny starts, and single precision."""

import subprocess
import sys
from functools import partial

import jax
import numpy as np
import pytest

import jaxvibro as jv
from jaxvibro.maps.two_tier_strobe import has_fast_path
from tests.lanes import at
from tests.properties.motions import Status, assert_same
from tests.properties.test_wild_scenes import fast, norms_of
from tests.wild import Grazing, Usual, lengths

UNUSED_OPERAND = """
import jax, jax.numpy as jnp
from jax import lax
from jaxvibro.compiled.kernel_calls import call_as_kernel

def carried(a, unused):
    turn = lambda carry: (carry[0] + 1, 2.0 * carry[1], carry[2])
    return lax.while_loop(lambda carry: carry[0] < 3, turn, (jnp.int32(0), a, unused))[1]

print(jax.jit(lambda a, unused: call_as_kernel(carried, a, unused))(jnp.ones(4), jnp.float32(2.0)))
"""


def test_lanes_that_turn_back_near_a_wall_are_rejected():
    scene, start = Grazing().draw(np.random.default_rng(6), 1024)
    top = scene.right.position
    for far, given_up in ((1e-3, 0.0), (1e-8, 0.0), (1e-11, 1.0)):
        wide = scene.replace(**{"right.position": top + far * np.maximum(1.0, abs(top))})
        assert np.mean(np.asarray(fast(wide, start)[1])) == pytest.approx(given_up, abs=0.05)


def test_lanes_in_strips_are_those_in_blocks():
    width, strip = 64, 512  # lanes of a block, and of a kernel
    for count in (strip + 1, 2 * strip - 30):
        scene, start = Usual("one_wall").draw(np.random.default_rng(9), count)
        whole = jax.device_get(fast(scene, start))
        for first in (0, count // 2, count - width):
            lanes = slice(first, first + width)
            block = jax.tree.leaves(fast(*at((scene, start), lanes)))
            assert_same(*((one, other[lanes]) for one, other in zip(block, jax.tree.leaves(whole), strict=True)))


def test_scenes_that_take_the_fast_path():
    scene = jv.make_scene(2.0, 2.1, 0.05, 0.7, (-1.0, 1.0))
    assert has_fast_path(scene)
    assert not has_fast_path(jax.tree.map(np.float32, scene))
    for walls in ((None, None), (-1.0, jv.Wall(1.0, stiffness=50.0))):
        assert not has_fast_path(jv.make_scene(2.0, 2.1, 0.05, 0.7, walls))


def test_a_start_that_is_tiny_beside_the_scene_ends_with_a_state():
    # one wall at 0 and no drive: what is left of the motion falls below all that can be squared
    scene = jv.make_scene(0.0, 1.0, 0.1, 0.5, (0.0, 1.0))
    size = 10.0 ** -np.arange(1.0, 308.0)
    for x, v in ((size, size), (size, 0.0 * size), (size, -size), (0.0 * size, -size), (0.0 * size, size)):
        end, impacts = jv.strobe(scene, jv.State(x, v), slots=0)
        assert (np.asarray(impacts.status) < Status.CAP).all()
        assert (np.abs(end.x) <= 2.0 * size).all()


def test_an_unused_operand_does_not_end_the_process():
    command = [sys.executable, "-c", UNUSED_OPERAND]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr[-500:]
    assert done.stdout.split() == ["[8.", "8.", "8.", "8.]"]


def test_single_precision_decides_contacts_eight_roundings_deep():
    scene, start = Grazing(np.float32).draw(np.random.default_rng(4), 1 << 12)
    run = partial(jv.strobe, slots=0, clearance=True)
    far = scene.replace(**{"right.position": scene.right.position + 1.0})
    (end, impacts), (_, free), (single, fewer) = jax.device_get(
        (run(scene, start), run(far, start), run(*jax.tree.map(np.float32, (scene, start))))
    )
    rounding = float(np.finfo(np.float32).eps) * lengths(scene, start, end)
    decided = abs(1.0 - free.least_clearance) > 8.0 * rounding
    assert decided.sum() > 500
    assert_same(((fewer.count > 0)[decided], (impacts.count > 0)[decided]))
    norms = norms_of(jv.monodromy(scene, start))
    bound = 16.0 * (1.0 + 2.0 * np.pi / np.asarray(scene.frequency)) * rounding * (1.0 + norms)
    calm = (impacts.count == fewer.count) & (impacts.least_speed > 1e-2) & np.isfinite(norms)
    error = np.maximum(abs(single.x - end.x), abs(single.v - end.v))
    assert calm.sum() > 300 and np.all((error < bound)[calm]) and np.median((error / bound)[calm]) < 0.05
