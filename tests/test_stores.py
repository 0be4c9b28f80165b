"""Studies in chunks: the same bits from any engine, gone on with after any end, and damage told in one line."""

import errno
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import dask
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr
from distributed import LocalCluster

import jaxvibro as jv
from jaxvibro.output.checksums import netcdf_bytes
from jaxvibro.stores import study_completion, zarr_store
from jaxvibro.stores.study_completion import complete_study
from jaxvibro.stores.study_protocol import Grid, fingerprint_array

from .counted_study import Counted, counts
from .stored_bits import bits


def test_chunks_cover_a_grid_once():
    grid = Grid({"a": 7, "b": 5, "c": 2}, (2, 3, 2))
    seen = np.zeros(grid.shape, int)
    for number in range(grid.n_chunks):
        seen[grid.chunk_slices(number)] += 1
        assert seen[grid.chunk_slices(number)].size == grid.n_chunk_cells(number)
    assert (seen == 1).all()


def test_memory_store_and_cluster_give_the_same(tmp_path):
    study = Counted(9)
    whole = complete_study(study, None, None)
    np.testing.assert_array_equal(whole["label"], np.repeat(np.arange(9), 4).reshape(9, 4))
    reports = []
    for name, engine in (("a", jv.LocalEngine(1)), ("b", jv.LocalEngine(3)), ("c", jv.DaskEngine(workers=2))):
        found = complete_study(study, jv.Store(tmp_path / name, engine), reports.append)
        xr.testing.assert_identical(found, whole)
        assert bits(tmp_path / name) == bits(tmp_path / "a")
    assert [one.done for one in reports[:10]] == list(range(0, 37, 4))
    assert reports[9][:3] == (36, 36, 4)
    assert reports[9].remaining == 0.0 and reports[9].rate > 0
    loaded = jv.load_store(tmp_path / "a")
    xr.testing.assert_identical(loaded.drop_attrs(), whole.drop_attrs())
    assert loaded.attrs == whole.attrs | {"chunks": 9, "chunks_done": 9}
    there = xr.open_zarr(tmp_path / "a", consolidated=False)
    np.testing.assert_array_equal(there["number"].values, whole["number"].values)
    (tmp_path / "whole.nc").write_bytes(netcdf_bytes(loaded))
    xr.testing.assert_equal(jv.load_data(tmp_path / "whole.nc"), loaded)


def test_what_is_done_is_not_done_again(tmp_path):
    log, path = str(tmp_path / "log"), tmp_path / "store"
    with pytest.raises(ArithmeticError, match="chunk 1"):
        complete_study(Counted(9, log=log, fails=1), jv.Store(path, jv.LocalEngine(1)), None)
    half = jv.load_store(path)
    assert half.attrs["chunks_done"] in (5, 6)  # the next one, 6, may have been begun
    np.testing.assert_array_equal(half["label"].values[[0, 5, 2, 7, 4, 1, 3, 8], 0], [0, 5, 2, 7, 4, -1, -1, -1])
    assert np.isnan(half["number"].values[[1, 3, 8]]).all()
    complete_study(Counted(9, log=log), jv.Store(path), None)
    complete_study(Counted(9, log=log), jv.Store(path), None)
    assert counts(log) == dict.fromkeys(range(9), 1)
    complete_study(Counted(9), jv.Store(tmp_path / "other"), None)
    assert bits(path) == bits(tmp_path / "other")


KILLED = """
import sys
from tests.counted_study import Counted
from jaxvibro.stores.study_completion import complete_study
from jaxvibro import Store
complete_study(Counted(30, 0.03, sys.argv[2]), Store(sys.argv[1]), None)
"""


def test_a_killed_process_loses_what_it_was_at_alone(tmp_path):
    path, log = str(tmp_path / "store"), tmp_path / "log"
    process = subprocess.Popen([sys.executable, "-c", KILLED, path, str(log)], cwd=Path(__file__).parents[1])
    while not log.exists() or len(log.read_text().split()) < 8:
        assert process.poll() is None
        time.sleep(0.005)
    process.send_signal(signal.SIGKILL)
    process.wait()
    known = jv.load_store(path).attrs["chunks_done"]
    before = log.read_text().split()
    assert 4 <= known < 30
    complete_study(Counted(30, log=str(log)), jv.Store(path), None)
    assert len(log.read_text().split()) == len(before) + 30 - known
    complete_study(Counted(30), jv.Store(tmp_path / "other"), None)
    assert bits(path) == bits(tmp_path / "other")


@pytest.mark.parametrize("damage", ["flipped", "cut", "gone", "mark", "nonsense mark"])
def test_a_damaged_chunk_is_told_and_done_anew(tmp_path, damage):
    path, log = tmp_path / "store", str(tmp_path / "log")
    complete_study(Counted(6), jv.Store(path), None)
    before, file = bits(path), path / "number" / "c" / "3" / "0" / "0"
    if "mark" in damage:
        file = path / "done" / "c" / "3"
    content = file.read_bytes()
    changed = {"flipped": content[:-1] + bytes([content[-1] ^ 4]), "cut": content[:7], "gone": None}
    changed |= {"mark": bytes([content[0] ^ 8]) + content[1:], "nonsense mark": b"no number"}
    file.unlink() if changed[damage] is None else file.write_bytes(changed[damage])
    if damage != "nonsense mark":  # else the chunk is not done
        with pytest.raises(jv.ArgumentError, match=r"must be undamaged; run the study again.*chunk 3 of"):
            jv.load_store(path)
        with pytest.warns(UserWarning, match="chunk 3 is damaged and is recomputed"):
            complete_study(Counted(6, log=log), jv.Store(path), None)
    else:
        complete_study(Counted(6, log=log), jv.Store(path), None)
    assert counts(log) == {3: 1}
    assert bits(path) == before


@pytest.mark.parametrize("name", ["zarr.json", "label/zarr.json", "known/c/0", "row/c/0"])
def test_damage_beside_the_chunks_is_told(tmp_path, name):
    path = tmp_path / "store"
    complete_study(Counted(3), jv.Store(path), None)
    content = (path / name).read_bytes()
    for place in range(0, len(content), max(1, len(content) // 40)):
        (path / name).write_bytes(content[:place] + bytes([content[place] ^ 1]) + content[place + 1 :])
        with pytest.raises(jv.ArgumentError, match=r"^(store|path): must be .*; got "):
            jv.load_store(path)
    (path / name).write_bytes(content)
    jv.load_store(path)


def test_another_study_is_refused(tmp_path):
    path = tmp_path / "store"
    complete_study(Counted(3), jv.Store(path), None)
    before = bits(path)
    with pytest.raises(jv.ArgumentError, match=r"scene differs; got 'offset = 0.5 stored, offset = 0.25 requested'"):
        complete_study(Counted(3, offset=0.25), jv.Store(path), None)
    with pytest.raises(jv.ArgumentError, match="rows differs; got '3 stored, 4 requested'"):
        complete_study(Counted(4), jv.Store(path), None)
    assert bits(path) == before


def test_an_axis_is_told_in_plain_numbers():
    assert fingerprint_array(np.linspace(1.5, 4.0, 10)).startswith("10, 1.5 to 4.0, ")
    assert fingerprint_array(np.empty(0)).startswith("0, none")
    assert fingerprint_array(np.array([1, 2])) != fingerprint_array(np.array([1.0, 2.0]))


def test_other_versions_are_refused(tmp_path, monkeypatch):
    path = tmp_path / "store"
    with monkeypatch.context() as patch:
        patch.setattr(zarr_store, "_current_versions", lambda: {"jaxvibro": "0.0.9", "jax": "0.1"})
        complete_study(Counted(3), jv.Store(path), None)
    with pytest.raises(jv.ArgumentError, match=r"versions that began it.*jaxvibro 0\.0\.9, now"):
        complete_study(Counted(3), jv.Store(path), None)
    assert jv.load_store(path).attrs["chunks_done"] == 3  # to be read it may be
    monkeypatch.setattr(zarr_store, "FORMAT_NUMBER", 2)
    with pytest.raises(jv.ArgumentError, match="must be of format 2; got 'format 1 in"):
        jv.load_store(path)


def test_what_is_no_store_is_refused(tmp_path):
    (tmp_path / "file").write_text("no folder")
    with pytest.raises(NotADirectoryError):
        complete_study(Counted(3), jv.Store(tmp_path / "file"), None)
    (tmp_path / "folder").mkdir()
    with pytest.raises(jv.ArgumentError, match="must be a store of jaxvibro"):
        complete_study(Counted(3), jv.Store(tmp_path / "folder"), None)
    xr.Dataset({"a": ("b", [1.0])}).to_zarr(tmp_path / "other", zarr_format=3, consolidated=False)
    with pytest.raises(jv.ArgumentError, match="must be a store of jaxvibro"):
        jv.load_store(tmp_path / "other")
    with pytest.raises(NotADirectoryError):
        jv.load_store(tmp_path / "missing")
    with pytest.raises(NotADirectoryError):
        complete_study(Counted(3), jv.Store(tmp_path / "missing" / "store"), None)


def test_sizes_are_looked_at_before_anything_is_made(tmp_path, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr(study_completion, "MAX_BYTES", 700)
        with pytest.raises(jv.ArgumentError, match="store: must be given for results of more than"):
            complete_study(Counted(9), None, None)  # of 9 times 4 times 20 bytes
    monkeypatch.setattr(shutil, "disk_usage", lambda path: SimpleNamespace(free=100))
    with pytest.raises(OSError, match="not enough space for up to") as told:
        complete_study(Counted(30), jv.Store(tmp_path / "store"), None)
    assert told.value.errno == errno.ENOSPC
    assert list(tmp_path.iterdir()) == []


def test_what_is_done_is_a_sample_of_the_whole():
    for chunks in (1, 2, 3, 6, 9, 100, 245, 1000):
        order = study_completion.spread_chunk_order(chunks)
        assert sorted(order) == list(range(chunks))
        for count in range(8, chunks, 7):
            quarters = np.bincount(np.array(order[:count]) * 4 // chunks, minlength=4)
            assert max(abs(quarters - count / 4)) <= 2.5


def test_a_full_disk_leaves_the_other_chunks(tmp_path, monkeypatch):
    path, whole = tmp_path / "store", zarr_store.OpenStore.put

    def put(self, number, parts, undecided):
        if number == 1:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), self.path)
        whole(self, number, parts, undecided)

    with monkeypatch.context() as patch:
        patch.setattr(zarr_store.OpenStore, "put", put)
        with pytest.raises(OSError, match="No space left"):
            complete_study(Counted(9), jv.Store(path, jv.LocalEngine(1)), None)
    assert jv.load_store(path)["label"].values[[0, 5, 2, 7, 4, 1], 0].tolist() == [0, 5, 2, 7, 4, -1]
    assert complete_study(Counted(9), jv.Store(path), None)["label"].values.min() == 0


def test_unfinished_files_are_swept_up(tmp_path):
    path = tmp_path / "store"
    complete_study(Counted(3), jv.Store(path), None)
    before = bits(path)
    (path / "label" / "c" / "0" / "0.abc.partial").write_text("half")
    complete_study(Counted(3), jv.Store(path), None)
    assert bits(path) == before


def test_threads_work_on_the_device_that_is_named():
    (one, *_) = jax.devices("cpu")
    with jax.default_device(one):
        assert list(jv.LocalEngine(2).each(lambda number: jax.config.jax_default_device, range(3))) == [one] * 3
    assert list(jv.LocalEngine(2).each(lambda number: jax.config.jax_default_device, range(3))) == [None] * 3


def test_engines_refuse_what_cannot_be():
    for wrong in ({"workers": 0}, {"workers": 1.5}, {"devices": 0}):
        with pytest.raises(jv.ArgumentError, match="must be a whole number from 1 on"):
            jv.LocalEngine(**wrong)
    with pytest.raises(jv.ArgumentError, match="must be None if the address of a cluster is given"):
        jv.DaskEngine("tcp://there:8786", 2)
    with pytest.raises(jv.ArgumentError, match="must be the address of a scheduler"):
        jv.DaskEngine(8786)


def test_a_scheduler_that_does_not_answer_is_told(tmp_path, monkeypatch):
    monkeypatch.setattr("jaxvibro.stores.dask_engine.CONNECT_TIMEOUT", 0.3)
    with pytest.raises(OSError, match=r"no scheduler answers at tcp://127.0.0.1:9"):
        complete_study(Counted(3), jv.Store(tmp_path / "store", jv.DaskEngine("tcp://127.0.0.1:9")), None)


def test_workers_that_are_there_compute_in_the_precision_that_is_asked(tmp_path):
    study = Counted(3, offset=jnp.asarray(1.0 / 3.0))
    assert study.offset.dtype == np.float64
    with LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=None) as cluster:
        engine = jv.DaskEngine(cluster.scheduler_address)
        found = complete_study(study, jv.Store(tmp_path / "there", engine), None)
    np.testing.assert_array_equal(found["number"].values[:, 0, 0], 1.0 / 3.0 + np.arange(3))
    complete_study(study, jv.Store(tmp_path / "here"), None)
    assert bits(tmp_path / "there") == bits(tmp_path / "here")


def test_an_error_of_a_worker_is_told(tmp_path):
    with pytest.raises(ArithmeticError, match="chunk 2"):
        complete_study(Counted(4, fails=2), jv.Store(tmp_path / "store", jv.DaskEngine(workers=1)), None)


def test_workers_of_ones_own_sample_nothing_and_one_that_is_lost_is_waited_for():
    """Also the worker that takes a lost one's place; what Dask is told is taken back in the end."""
    before = dask.config.get("distributed.deploy.lost-worker-timeout")
    told = jv.DaskEngine(workers=1).each(
        lambda number: (os.getpid(), dask.config.get("distributed.worker.profile.enabled")), range(80)
    )
    first, _ = next(told)
    assert dask.config.get("distributed.deploy.lost-worker-timeout") == "600.0 s" != before
    os.kill(first, signal.SIGKILL)
    rest = list(told)
    assert len(rest) == 79 and len({process for process, _ in rest} - {first}) == 1
    assert not any(sampled for _, sampled in rest)
    assert dask.config.get("distributed.deploy.lost-worker-timeout") == before


def test_told_is_json(tmp_path):
    complete_study(Counted(2), jv.Store(tmp_path / "store"), None)
    attrs = json.loads((tmp_path / "store" / "zarr.json").read_text())["attributes"]
    assert json.loads(attrs["jaxvibro_store"])["sizes"] == {"row": 2, "column": 4}
