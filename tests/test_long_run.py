"""Long runs by lean steps, with lanes that those give up: against the strobe, period by period."""

import jax
import numpy as np
import pytest

import jaxvibro as jv
from jaxvibro.maps import long_iteration
from jaxvibro.maps.initial_conditions import draw_initial_states
from jaxvibro.maps.iterate import MAX_RECORDED_PERIODS, PERIOD_SLOTS, final_states, iterate

LANES, PERIODS = 70, MAX_RECORDED_PERIODS + 3
SCENES = {
    "slow impacts": jv.make_scene(3.61, 1.06, 0.14, 0.32, (-1.21, 1.15)),
    "chatter": jv.make_scene(2.98, 2.6, 0.3, 0.33, (-1.75, 0.21)),
    "no speed left": jv.make_scene(2.0, 1.1, 0.2, 0.0, (-1.0, 1.0)),
    "many impacts": jv.make_scene(3.0, 0.1, 0.05, 0.8, (-1.0, 0.5)),
    "moving": jv.make_scene(1.5, 1.3, 0.4, 0.3, (jv.Wall(-0.6, motion=jv.Motion(0.1, 0.5)), 0.4)),
}
MIXED = (("slow impacts", 3_000), ("no speed left", 9_000), ("many impacts", 9_000))


def strobed(scene, state, periods):
    """(x, v, contact, time, side, speed of each period; the worst status), by the public strobe."""
    rows, worst = [], np.zeros(len(state.x), int)
    for k in range(periods):
        state, impacts = jax.device_get(jv.strobe(scene, state, slots=PERIOD_SLOTS))
        told = np.where((impacts.status == 1) & (k < periods - MAX_RECORDED_PERIODS), 0, impacts.status)
        worst = np.where(worst >= 2, worst, np.maximum(worst, told))
        rows.append((state.x, state.v, state.contact, impacts.time, impacts.side, impacts.speed))
    return [np.stack(each) for each in zip(*rows, strict=True)], worst


@pytest.fixture
def counted(monkeypatch):
    """How many periods the host did in full, and how often a run was by both tiers."""
    counts = {"full": 0, "both": 0}
    full, run = long_iteration._reference_strobe, long_iteration._iterate_block

    def one(*given):
        counts["full"] += 1
        return full(*given)

    def block(*given):
        counts["both"] += not given[-1]
        return run(*given)

    monkeypatch.setattr(long_iteration, "_reference_strobe", one)
    monkeypatch.setattr(long_iteration, "_iterate_block", block)
    return counts


@pytest.mark.parametrize("kind, patience", [*((kind, patience) for kind in SCENES for patience in (0, np.inf)), *MIXED])
def test_lanes_of_both_paths_agree_with_the_map(kind, patience, counted, monkeypatch):
    """By both tiers, by the host, and by one after the other."""
    monkeypatch.setattr(long_iteration, "MAX_RETRY_COST", patience)
    scene = SCENES[kind]
    starts = draw_initial_states(scene, LANES, 4)
    starts.x[7] = np.nan if scene.left is None else -9.0
    (*rows, sides, speeds), worst = strobed(scene, starts, PERIODS)
    found = iterate(scene, starts, PERIODS)
    assert (counted["full"] > 0) == (patience > 0) and (counted["both"] > 0) == (patience < np.inf)
    np.testing.assert_array_equal(found.status, worst)
    np.testing.assert_array_equal(found.side, sides[-MAX_RECORDED_PERIODS:])
    for one, other in zip((*found[2:6], found.speed), (*rows, speeds), strict=True):
        np.testing.assert_allclose(one, other[-MAX_RECORDED_PERIODS:], rtol=0, atol=1e-9)
    np.testing.assert_array_equal(found.state.x, found.x[-1])
    last, status = final_states(scene, starts, PERIODS)
    for one, other in zip(jax.tree.leaves((last, status)), jax.tree.leaves((found.state, worst)), strict=True):
        np.testing.assert_array_equal(one, other)


def test_lanes_of_a_batch_of_scenes(counted):
    rng = np.random.default_rng(5)
    scene = jv.make_scene(rng.uniform(1.0, 3.0, LANES), 2.6, 0.3, 0.33, (-1.75, 0.21))
    starts = draw_initial_states(scene, LANES, 4)
    rows, worst = strobed(scene, starts, PERIODS)
    found = iterate(scene, starts, PERIODS)
    assert counted["full"] > 0
    np.testing.assert_array_equal(found.status, worst)
    for one, other in zip(found[2:], rows, strict=True):
        np.testing.assert_allclose(one, other[-MAX_RECORDED_PERIODS:], rtol=0, atol=1e-9)


@pytest.mark.parametrize(
    "periods",
    [
        1,
        MAX_RECORDED_PERIODS - 1,
        MAX_RECORDED_PERIODS,
        MAX_RECORDED_PERIODS + 1,
        MAX_RECORDED_PERIODS + 2,
        3 * MAX_RECORDED_PERIODS,
    ],
)
def test_the_recorded_periods_are_in_order(periods):
    ring = np.zeros(MAX_RECORDED_PERIODS)
    for k in range(periods):
        ring[k % MAX_RECORDED_PERIODS] = k
    (told,) = long_iteration.unroll_ring_buffers((ring,), periods)
    assert told.tolist() == list(range(max(0, periods - MAX_RECORDED_PERIODS), periods))
