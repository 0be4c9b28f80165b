"""The lean tier decides nothing that the full one decides otherwise, and which tier a lane takes changes no bit."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxvibro as jv
from jaxvibro.compiled.kernel_calls import BLOCK_WIDTH
from jaxvibro.flight.wall_positions import wall_states
from jaxvibro.maps import iterate, two_tier_strobe
from tests.lanes import at
from tests.status_proof import RIGID, draw
from tests.tiers_proof import bits, chatter, compared, full, grazing, lean, measured, same, usual

MOST = 4_000  # lanes of a test
KINDS = [RIGID[3], *(pytest.param(RIGID[k], marks=pytest.mark.long) for k in (1, 4))]


@pytest.mark.parametrize(("make", "most"), [(usual, 0.2), (draw, 0.9)])
@pytest.mark.parametrize("kind", KINDS)
def test_random_scenes_end_as_by_full_steps(kind, make, most):
    found = compared(*make(np.random.default_rng(5), MOST, kind))
    assert found.wrong == 0 and found.error < 1
    assert found.clearance < 1 and found.nearer <= 1e-3 * MOST and found.bits == 0
    assert found.given_up < most * MOST  # so that there is something to compare


def test_what_turns_back_near_a_wall_is_given_up():
    scene, start = grazing(np.random.default_rng(6), MOST)
    found = compared(scene, start)
    assert found.given_up == found.lanes > MOST // 4 and found.wrong == 0
    top = scene.right.position
    for far, given_up in ((1e-3, 0.0), (1e-8, 0.0), (1e-11, 1.0)):
        wide = scene.replace(**{"right.position": top + far * np.maximum(1.0, abs(top))})
        assert np.mean(np.asarray(lean(wide, start)[1])) == pytest.approx(given_up, abs=0.05)


def test_masses_that_hop_and_rest_end_as_by_full_steps():
    scene, start = chatter(np.random.default_rng(7), MOST)
    found = compared(scene, start)
    assert found.wrong == 0 and found.error < 1 and 0 < found.given_up < found.lanes
    (_, impacts), given_up = jax.device_get(lean(scene, start))
    after = np.asarray(scene.right.restitution) * np.nan_to_num(impacts.least_speed)
    assert after[~given_up & (impacts.count > 0)].min() > 2e-3  # a slower impact is not theirs to decide


@pytest.mark.parametrize("kind", (RIGID[1], RIGID[4]))
def test_no_bit_depends_on_the_batch(kind):
    wrong, given_up = bits(np.random.default_rng(8), 400, kind)
    assert wrong == [] and given_up > 0


@pytest.mark.parametrize(
    "count",
    [two_tier_strobe.BLOCKS_PER_STRIP * BLOCK_WIDTH + 1, 2 * two_tier_strobe.BLOCKS_PER_STRIP * BLOCK_WIDTH - 30],
)
def test_lanes_in_strips_are_those_in_blocks(count):
    scene, start = usual(np.random.default_rng(9), count, RIGID[4])
    whole = lean(scene, start)
    for first in (0, count // 2, count - BLOCK_WIDTH):
        lanes = slice(first, first + BLOCK_WIDTH)
        assert same(lean(*at((scene, start), lanes)), at(whole, lanes))


def test_turning_points_are_those_of_a_motion_sampled_densely():
    """Of walls that move, and of one that does beside one that stands still; full steps lose some of these."""
    for kind in ((False, 2), (False, 3)), ((False, 0), (False, 1)):
        scene, start = usual(np.random.default_rng(3), 1 << 12, kind)
        (_, impacts), given_up = jax.device_get(measured(scene, start))
        calm = np.flatnonzero(~given_up & (impacts.count == 0))[:12]
        assert len(calm) == 12
        for k in calm:
            one = at((scene, start), k)
            path = jv.simulate(*one, samples=4000)
            x, time, least = np.asarray(path.x), np.asarray(path.time), np.inf
            walls = wall_states(one[0], one[1].phase + one[0].frequency * time)
            for sign, (place, _) in zip((-1.0, 1.0), walls, strict=True):
                clear = sign * (np.asarray(place) - x)
                turns = (clear[1:-1] < clear[:-2]) & (clear[1:-1] <= clear[2:])
                least = min(least, clear[1:-1][turns].min(initial=np.inf))
            assert impacts.least_clearance[k] == pytest.approx(least, rel=0, abs=1e-4), k


def test_the_tier_of_a_scene():
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
        pytest.param(jv.make_scene(3.0, 0.1, 0.05, 0.8, (-1.0, 0.5)), marks=pytest.mark.slow),
        jv.make_scene(1.5, 1.3, 0.2, 0.6, (None, 0.4)),
        jv.make_scene(1.5, 1.3, 0.2, 0.6, (None, None)),
    ],
)
def test_a_few_lanes_strobed_from_the_host_are_those_of_the_compiled_run(scene, monkeypatch):
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


@pytest.mark.parametrize("place", ["anywhere", "middle"])
def test_a_start_without_speed_goes_as_its_mirror_image(place):
    """Full steps aim at one of two walls: of the mirror image at the other one."""
    rng = np.random.default_rng(3)
    lanes = 4096
    low, high = -rng.uniform(0.02, 1.2, lanes), rng.uniform(0.02, 1.2, lanes)
    share = rng.random(lanes) if place == "anywhere" else np.full(lanes, 0.5)
    if place == "middle":
        low = -high
    x, none, phase = low + share * (high - low), np.zeros(lanes), rng.uniform(0.0, 6.0, lanes)
    numbers = rng.uniform(0.1, 5.0, lanes), rng.uniform(0.3, 6.0, lanes), rng.uniform(0.0, 2.0, lanes), 0.5

    def told(sign, walls):
        scene = jv.make_scene(sign * numbers[0], *numbers[1:], walls)
        end, impacts = full(scene, jv.State(sign * x, none, phase, none))
        return sign * end.x, sign * end.v, impacts.time, sign * impacts.side, impacts.speed, impacts.status

    here, mirrored = told(1.0, (jv.Wall(low), jv.Wall(high))), told(-1.0, (jv.Wall(-high), jv.Wall(-low)))
    assert np.asarray(here[5] <= 1).mean() > 0.95 and np.asarray(here[3] != 0).any(axis=1).mean() > 0.3
    for one, other in zip(here, mirrored, strict=True):
        np.testing.assert_array_equal(one, other)
