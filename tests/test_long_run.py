"""Long runs by the fast path, with lanes that it gives up, and by the host: against the strobe, period by period."""

import sys
from dataclasses import replace
from functools import partial

import jax
import numpy as np
import pytest

import jaxvibro as jv
from jaxvibro.maps.initial_conditions import draw_initial_states
from jaxvibro.maps.iterate import final_states, iterate, unroll_ring_buffers
from tests.kinds import KINDS
from tests.lanes import at
from tests.properties.motions import Status
from tests.wild import Wild

LANES, KEPT, SLOTS = 70, 64, 16  # a run records the last periods, and so many impacts of each
PERIODS, MODULE = KEPT + 3, "jaxvibro.maps.iterate"
SCENES = {
    "slow impacts": jv.make_scene(3.61, 1.06, 0.14, 0.32, (-1.21, 1.15)),
    "chatter": jv.make_scene(2.98, 2.6, 0.3, 0.33, (-1.75, 0.21)),
    "batch": jv.make_scene(np.random.default_rng(5).uniform(1.0, 3.0, LANES), 2.6, 0.3, 0.33, (-1.75, 0.21)),
    "no speed left": jv.make_scene(2.0, 1.1, 0.2, 0.0, (-1.0, 1.0)),
    "many impacts": jv.make_scene(3.0, 0.1, 0.05, 0.8, (-1.0, 0.5)),
    "moving": jv.make_scene(1.5, 1.3, 0.4, 0.3, (jv.Wall(-0.6, motion=jv.Motion(0.1, 0.5)), 0.4)),
}
MIXED = (("slow impacts", 3_000), ("no speed left", 9_000), ("many impacts", 9_000))


def strobed(scene, state, periods):
    """Return (x, v, contact, time, side, speed of each recorded period; the worst status), by the public strobe."""
    rows, worst = [], np.zeros(len(state.x), int)
    for k in range(periods):
        state, impacts = jax.device_get(jv.strobe(scene, state, slots=SLOTS))
        status = np.where((impacts.status == Status.FULL) & (k < periods - KEPT), Status.OK, impacts.status)
        worst = np.where(worst >= Status.CAP, worst, np.maximum(worst, status))
        rows.append((state.x, state.v, state.contact, impacts.time, impacts.side, impacts.speed))
    return [np.stack(each[-KEPT:]) for each in zip(*rows, strict=True)], worst


@pytest.mark.parametrize("kind, patience", [*((kind, patience) for kind in SCENES for patience in (0, np.inf)), *MIXED])
def test_lanes_of_both_paths_agree_with_the_map(kind, patience, monkeypatch):
    """By both tiers, by the host, and by one after the other."""
    counts = {"_reference_strobe": 0, "_iterate_block": 0}

    def counted(name, *given):
        counts[name] += name == "_reference_strobe" or not given[-1]
        return original[name](*given)

    original = {name: getattr(sys.modules[MODULE], name) for name in counts}
    for name in counts:
        monkeypatch.setattr(f"{MODULE}.{name}", partial(counted, name))
    monkeypatch.setattr(f"{MODULE}.MAX_RETRY_COST", patience)
    scene = SCENES[kind]
    starts = draw_initial_states(scene, LANES, 4)
    starts.x[7] = -9.0  # beyond the wall
    rows, worst = strobed(scene, starts, PERIODS)
    run = iterate(scene, starts, PERIODS)
    assert (counts["_reference_strobe"] > 0) == (patience > 0) and (counts["_iterate_block"] > 0) == (patience < np.inf)
    np.testing.assert_array_equal(run.status, worst)
    for computed, expected in zip(run[2:], rows, strict=True):
        np.testing.assert_allclose(computed, expected, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(run.state.x, run.x[-1])
    last = final_states(scene, starts, PERIODS)
    for computed, expected in zip(jax.tree.leaves(last), jax.tree.leaves((run.state, worst)), strict=True):
        np.testing.assert_allclose(computed, expected, rtol=1e-13)  # by two programs


@pytest.mark.parametrize(
    "scene", [SCENES["no speed left"], SCENES["many impacts"], jv.make_scene(1.5, 1.3, 0.2, 0.6, (None, None))]
)
def test_a_few_lanes_on_the_host_agree_with_the_compiled_run(scene, monkeypatch):
    state = jv.State(np.array([0.1, -0.3, 0.35]), np.array([1.0, 2.0, -0.5]), np.zeros(3), np.zeros(3))
    for periods in (3, KEPT + 2):
        host = iterate(scene, state, periods)
        with monkeypatch.context() as patched:
            patched.setattr("jaxvibro.maps.iterate.MAX_HOST_PERIODS", 0)
            run = iterate(scene, state, periods)
        for one, other in zip(jax.tree.leaves(host), jax.tree.leaves(run), strict=True):
            assert one.dtype == other.dtype
            np.testing.assert_allclose(one, other, rtol=1e-11, atol=1e-11)
    assert (host.status == (Status.FULL if scene is SCENES["many impacts"] else Status.OK)).all()


def test_the_recorded_periods_are_in_order():
    for periods in (1, KEPT - 1, KEPT, KEPT + 1, KEPT + 2, 3 * KEPT):
        ring = np.zeros(KEPT)
        for k in range(periods):
            ring[k % KEPT] = k
        (rows,) = unroll_ring_buffers((ring,), periods)
        assert rows.tolist() == list(range(max(0, periods - KEPT), periods))


def test_studies_keep_the_status_of_lanes_without_an_end():
    scene, start = Wild("rm", narrow=True).draw(np.random.default_rng(5), 256)
    status = np.asarray(jv.strobe(scene, start, slots=0)[1].status)
    assert 20 < (status == Status.CAP).sum() < 236
    run = iterate(scene, start, 2)
    swept = jv.sweep(scene, "damping", np.asarray(scene.damping)[None], start, settle=1, keep=1)
    for found, x in ((run.status, run.x), (swept.status.values[0], swept.x.values[0].T)):
        assert (found[status >= Status.CAP] >= Status.CAP).all()
        assert np.array_equal(np.isnan(x[-1]), found >= Status.CAP)
    with pytest.raises(jv.ArgumentError, match="must have a trajectory"):
        jv.simulate(*at((scene, start), np.flatnonzero(status == Status.CAP)[0]), samples=4)


@pytest.mark.parametrize("impacts", [1_000, 1_000_000])
def test_the_energy_of_elastic_impacts_changes_by_rounding_alone(impacts):
    """Each impact may have the same rounding, so the bound grows as their number."""
    scene, state = KINDS["two_walls"].draw(0)
    speed = 1.0 + abs(state.v)
    walls = (jv.Wall(-0.5 * speed, 1.0 + 0.0 * speed), jv.Wall(0.25 * speed, 1.0 + 0.0 * speed))
    scene = jv.make_scene(0.0 * speed, 1.0 + 0.1 * scene.frequency, 0.0 * speed, 0.7, walls)
    end, record = jv.strobe(scene, replace(state, x=0.0 * speed, v=speed, phase=0.0 * speed), impacts // 4, 0)
    assert np.min(record.count) >= 0.9 * impacts and np.all(record.status <= Status.FULL)
    error = abs((np.asarray(end.x) ** 2 + np.asarray(end.v) ** 2) / speed**2 - 1.0)
    assert error.max() < 20.0 * np.finfo(float).eps * np.max(record.count)
