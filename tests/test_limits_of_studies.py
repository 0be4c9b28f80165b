"""Limits of time of the studies: what is done is what a whole run gives, the rest is blank, and the reason is given."""

import numpy as np
import pytest

import jaxvibro as jv
from continuation import limits
from jaxvibro.attractors import sweep_study
from jaxvibro.surveys import fractions as shares

START = jv.State(0.3, 0.1)


def scene(**changes):
    return jv.make_scene(4.65, 2.1, 0.05, 0.7, (-1.0, 1.0)).replace(**changes)


@pytest.fixture
def ticking(monkeypatch):
    """Makes the clock be a second later each time that it is read, from now on."""

    def start():
        read = iter(range(1_000_000))
        monkeypatch.setattr(limits, "clock", lambda: float(next(read)))

    return start


def test_a_sweep_stops_between_chunks(tmp_path, ticking, monkeypatch):
    values = np.linspace(4.5, 4.9, 40)
    whole = jv.sweep(scene(), "amplitude", values, START, 3, 2)
    ticking()
    part = jv.sweep(scene(), "amplitude", values, START, 3, 2, max_seconds=1.5)
    done = part["status"].values >= 0
    assert done.sum() == 32 and done[:32].all() and part.attrs["stopped"] == "max_seconds reached: 32 of 40 values done"
    assert np.array_equal(part["x"].values[:32], whole["x"].values[:32]) and np.isnan(part["x"].values[32:]).all()
    monkeypatch.setattr(sweep_study, "WIDTH", 1)  # lanes of a chunk
    lanes = scene(damping=np.array([0.04, 0.05, 0.06]))
    store = jv.Store(tmp_path / "sweep.zarr", jv.LocalEngine(workers=1))
    ticking()
    part = jv.sweep(lanes, "amplitude", values, START, 3, 2, store=store, max_seconds=1.5)
    done = part["status"].values >= 0
    assert part.attrs["stopped"] == f"max_seconds reached: {done[0].sum()} of 3 cells done" and 0 < done[0].sum() < 3
    again = jv.sweep(lanes, "amplitude", values, START, 3, 2, store=store)
    assert "stopped" not in again.attrs and (again["status"].values >= 0).all()
    assert np.array_equal(part["v"].values[done], again["v"].values[done])
    assert np.array_equal(again["v"].values[:, 1], whole["v"].values)


def test_a_spectrum_stops_between_values(tmp_path, ticking):
    values = np.linspace(2.0, 2.2, 66)  # of two blocks
    few = {"settle": 5, "error": 1.0, "most": 1}
    whole = jv.spectrum(scene(), "amplitude", values, START, **few)
    store = jv.Store(tmp_path / "spectrum.zarr", jv.LocalEngine(workers=1))
    for kept, unit in ((None, "values"), (store, "cells")):
        ticking()
        part = jv.spectrum(scene(), "amplitude", values, START, **few, store=kept, max_seconds=1.5)
        done = part["status"].values >= 0
        assert 0 < done.sum() < 66 and part.attrs["stopped"] == f"max_seconds reached: {done.sum()} of 66 {unit} done"
        for key in ("exponent", "impacts", "within", "periods", "rests"):
            np.testing.assert_array_equal(part[key].values[done], whole[key].values[done])
        assert np.isnan(part["exponent"].values[~done]).all() and not part["count"].values[~done].any()
    again = jv.spectrum(scene(), "amplitude", values, START, **few, store=store)
    assert "stopped" not in again.attrs
    np.testing.assert_array_equal(again["exponent"].values, whole["exponent"].values)


@pytest.mark.slow
def test_fractions_stop_between_values(ticking, monkeypatch):
    monkeypatch.setattr(shares, "_least", lambda *given: 0.5)  # `least_shock` has its own test
    values = [4.6, 4.65, 4.7]
    whole = jv.fractions(scene(), "amplitude", values[:2], 2, settle=100, shocks=8)
    ticking()
    part = jv.fractions(scene(), "amplitude", values, 2, settle=100, max_seconds=1.5)
    assert part.attrs["stopped"] == "max_seconds reached: 2 of 3 values done"
    for key in part.data_vars:
        assert part[key].dtype == whole[key].dtype
        np.testing.assert_array_equal(part[key].values[:2], whole[key].values)
    assert np.isnan(part["share"].values[2]).all() and (part["label"].values[2] == "").all() and part["status"][2] == -1
    assert part["amplitude"].attrs == whole["amplitude"].attrs and part["amplitude"].values.tolist() == values
    ticking()
    part = jv.fractions(scene(), "amplitude", values[:2], 2, settle=100, shocks=8, max_seconds=2.5)
    assert part.attrs["stopped"] == "max_seconds reached: 1 of 2 values done"
    np.testing.assert_array_equal(part["least_shock"].values[0], whole["least_shock"].values[0])
    assert np.isnan(part["least_shock"].values[1]).all()


@pytest.mark.slow
def test_the_least_shock_so_far_is_given(ticking):
    attractors = jv.find_attractors(scene(), starts=60)
    few = {"shocks": 64, "phase": [0.0, 1.0]}
    whole = jv.least_shock(scene(), attractors, **few)
    assert not whole.stopped
    ticking()
    part = jv.least_shock(scene(), attractors, **few, max_seconds=0.5)
    assert part.stopped == "max_seconds reached: 0 of 2 phases done" and part.stopped in part.table()
    assert whole.size <= part.size < part.reach and np.isnan(part.by_phase["size"].values[1])
    assert part.safe == whole.safe and part.phase == 0.0 and part.below < whole.below
    ticking()
    assert jv.least_shock(scene(), attractors, **few, max_seconds=1e9).size == whole.size


def test_times_that_cannot_be_are_refused():
    attractors = ()
    calls = (
        lambda **more: jv.sweep(scene(), "amplitude", [1.0], START, **more),
        lambda **more: jv.spectrum(scene(), "amplitude", [1.0], START, **more),
        lambda **more: jv.fractions(scene(), "amplitude", [1.0], **more),
        lambda **more: jv.least_shock(scene(), attractors, **more),
    )
    for call in calls:
        with pytest.raises(jv.ArgumentError, match="max_seconds: must be a positive number"):
            call(max_seconds=-1.0)
