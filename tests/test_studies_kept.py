"""Basins, exponents and sweeps that are kept in a store: the numbers that they have without one."""

import numpy as np
import pytest
import xarray as xr

import jaxvibro as jv

REST = jv.State(0.0, 0.0)


def scene():
    return jv.make_scene(4.65, 2.1, 0.05, 0.7, (jv.Wall(-1.0), jv.Wall(1.0)))


def test_basins(tmp_path, monkeypatch):
    monkeypatch.setattr("jaxvibro.attractors.basins.STARTS_PER_CHUNK", 200)
    here = scene().replace(amplitude=5.0)  # chaos, whose sample is kept too
    known = jv.find_attractors(here, 40)
    assert {one.kind for one in known} >= {"periodic", "chaotic"}
    axes, seen = (np.linspace(-1.0, 1.0, 25), np.linspace(-4.0, 4.0, 30)), []
    plain = jv.basins(here, *axes, 0.4, known)
    kept = jv.basins(here, *axes, 0.4, known, progress=seen.append, store=jv.Store(tmp_path / "basins"))
    again = jv.basins(here, *axes, 0.4, known, progress=seen.append, store=jv.Store(tmp_path / "basins"))
    xr.testing.assert_identical(kept, plain)
    xr.testing.assert_identical(again, plain)
    far = jv.Store(tmp_path / "far", jv.DaskEngine(workers=1))
    xr.testing.assert_identical(jv.basins(here, *axes, 0.4, known, store=far), plain)
    assert sorted(seen) == seen and seen[0] == 0 and seen[-2:] == [750, 750] and len(seen) == 6
    assert (jv.load_store(tmp_path / "basins")["label"] == plain["label"]).all()
    with pytest.raises(jv.ArgumentError, match="attractors differs"):
        jv.basins(here, *axes, 0.4, known[:1], store=jv.Store(tmp_path / "basins"))


def test_spectrum(tmp_path):
    values, asked = np.linspace(4.0, 5.0, 5), {"error": 0.05, "most": 2**12}
    plain = jv.spectrum(scene(), "amplitude", values, REST, **asked)
    kept = jv.spectrum(scene(), "amplitude", values, REST, **asked, store=jv.Store(tmp_path / "spectrum"))
    xr.testing.assert_identical(kept, plain)
    far = jv.Store(tmp_path / "far", jv.DaskEngine(workers=1))
    xr.testing.assert_identical(jv.spectrum(scene(), "amplitude", values, REST, **asked, store=far), plain)
    again = jv.spectrum(scene(), "amplitude", values, REST, **asked, store=jv.Store(tmp_path / "spectrum"))
    xr.testing.assert_identical(again, plain)
    with pytest.raises(jv.ArgumentError, match=r"start\.x differs"):
        jv.spectrum(scene(), "amplitude", values, jv.State(0.1, 0.0), **asked, store=jv.Store(tmp_path / "spectrum"))


def test_sweep(tmp_path):
    values, state = np.linspace(2.0, 4.0, 5), jv.State(np.linspace(-0.5, 0.5, 66).reshape(2, 33), 0.0)
    seen = []
    plain = jv.sweep(scene(), "amplitude", values, state, 20, 5)
    kept = jv.sweep(
        scene(), "amplitude", values, state, 20, 5, progress=seen.append, store=jv.Store(tmp_path / "sweep")
    )
    xr.testing.assert_identical(kept, plain)
    assert seen[0] == 0 and seen[1] in (2, 64) and seen[2:] == [66]
    xr.testing.assert_identical(
        jv.sweep(scene(), "amplitude", values, state, 20, 5, store=jv.Store(tmp_path / "sweep")), plain
    )
    with pytest.raises(jv.ArgumentError, match="settings differs"):
        jv.sweep(scene(), "amplitude", values, state, 21, 5, store=jv.Store(tmp_path / "sweep"))
