"""Which scenes take the fast path, lanes near its limits, strips of lanes, and a few lanes on the host."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxvibro as jv
from jaxvibro.compiled.kernel_calls import BLOCK_WIDTH
from jaxvibro.maps import iterate, two_tier_strobe
from tests.lanes import at
from tests.properties.test_wild_scenes import fast
from tests.wild import Grazing, Usual


def test_lanes_that_turn_back_near_a_wall_are_rejected():
    scene, start = Grazing().draw(np.random.default_rng(6), 1024)
    top = scene.right.position
    for far, given_up in ((1e-3, 0.0), (1e-8, 0.0), (1e-11, 1.0)):
        wide = scene.replace(**{"right.position": top + far * np.maximum(1.0, abs(top))})
        assert np.mean(np.asarray(fast(wide, start)[1])) == pytest.approx(given_up, abs=0.05)


@pytest.mark.parametrize(
    "count",
    [two_tier_strobe.BLOCKS_PER_STRIP * BLOCK_WIDTH + 1, 2 * two_tier_strobe.BLOCKS_PER_STRIP * BLOCK_WIDTH - 30],
)
def test_lanes_in_strips_are_those_in_blocks(count):
    scene, start = Usual("rm").draw(np.random.default_rng(9), count)
    whole = jax.device_get(fast(scene, start))
    for first in (0, count // 2, count - BLOCK_WIDTH):
        lanes = slice(first, first + BLOCK_WIDTH)
        for one, other in zip(jax.tree.leaves(fast(*at((scene, start), lanes))), jax.tree.leaves(whole), strict=True):
            np.testing.assert_array_equal(one, other[lanes])


def test_scenes_that_take_the_fast_path():
    scene = jv.make_scene(2.0, 2.1, 0.05, 0.7, (-1.0, 1.0))
    assert two_tier_strobe.has_fast_path(scene)
    single = jax.tree.map(jnp.float32, scene)
    assert not two_tier_strobe.has_fast_path(single)
    assert not two_tier_strobe.has_fast_path(jv.make_scene(2.0, 2.1, 0.05, 0.7, (None, None)))
    assert not two_tier_strobe.has_fast_path(jv.make_scene(2.0, 2.1, 0.05, 0.7, (-1.0, jv.Wall(1.0, stiffness=50.0))))


@pytest.mark.parametrize(
    "scene",
    [
        jv.make_scene(2.0, 2.1, 0.05, 0.7, (-1.0, 1.0)),
        jv.make_scene(2.0, 2.1, 0.05, 0.0, (-1.0, 1.0)),
        jv.make_scene(3.0, 0.1, 0.05, 0.8, (-1.0, 0.5)),
        jv.make_scene(1.5, 1.3, 0.2, 0.6, (None, 0.4)),
        jv.make_scene(1.5, 1.3, 0.2, 0.6, (None, None)),
    ],
)
def test_a_few_lanes_on_the_host_agree_with_the_compiled_run(scene, monkeypatch):
    state = jv.State(np.array([0.1, -0.3, 0.35]), np.array([1.0, 2.0, -0.5]), np.zeros(3), np.zeros(3))
    for periods in (3, iterate.MAX_RECORDED_PERIODS + 2):
        found = []
        for short in (iterate.MAX_HOST_PERIODS, 0):
            monkeypatch.setattr(iterate, "MAX_HOST_PERIODS", short)
            found.append(iterate.iterate(scene, state, periods))
        monkeypatch.undo()
        host, run = (jax.tree.leaves(each) for each in found)
        assert [each.dtype for each in host] == [each.dtype for each in run]
        for one, other in zip(host, run, strict=True):
            np.testing.assert_allclose(one, other, rtol=1e-11, atol=1e-11)
    assert (found[0].status == (1 if scene.left is not None and scene.frequency < 1 else 0)).all()
