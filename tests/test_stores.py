"""Studies in chunks: reports, refusals and messages of stores and engines, and several processes at one store."""

import errno
import json
import os
import re
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
from jaxvibro.output.atomic_files import acquire_lock, create_folder_atomically, lock_file, remove_abandoned_folders
from jaxvibro.stores.study import spread_chunk_order
from jaxvibro.stores.zarr_store import OpenStore

from .stored_studies import Counted, bits, complete_study, counts, keep

TOKEN = "0123456789abcdef"


def test_reports_and_the_data_that_are_read_from_a_store(tmp_path):
    whole, reports = complete_study(Counted(9), None, None), []
    complete_study(Counted(9), jv.Store(tmp_path / "a", jv.LocalEngine(1)), reports.append)
    assert [report.done for report in reports] == list(range(0, 37, 4))
    assert reports[-1][:3] == (36, 36, 4) and reports[-1].remaining == 0.0 and reports[-1].rate > 0
    loaded = jv.load_store(tmp_path / "a")
    xr.testing.assert_identical(loaded.drop_attrs(), whole.drop_attrs())
    assert loaded.attrs == whole.attrs | {"chunks": 9, "chunks_done": 9}
    opened = xr.open_zarr(tmp_path / "a", consolidated=False)
    np.testing.assert_array_equal(opened["number"].values, whole["number"].values)
    attributes = json.loads((tmp_path / "a" / "zarr.json").read_text())["attributes"]
    assert json.loads(attributes["jaxvibro_store"])["sizes"] == {"row": 9, "column": 4}


def test_a_damaged_chunk_is_named_and_recomputed(tmp_path):
    path, log = tmp_path / "store", str(tmp_path / "log")
    keep(Counted(6), path)
    before, file = bits(path), path / "number" / "c" / "3" / "0" / "0"
    file.write_bytes(file.read_bytes()[:7])
    with pytest.raises(jv.ArgumentError, match=r"must be undamaged; run the study again.*chunk 3 of"):
        jv.load_store(path)
    with pytest.warns(UserWarning, match="chunk 3 is damaged and is recomputed"):
        keep(Counted(6, log=log), path)
    (path / "done" / "c" / "3").write_bytes(b"no number")  # the chunk is not done
    keep(Counted(6, log=log), path)
    assert counts(log) == {3: 2} and bits(path) == before


def test_other_versions_are_refused(tmp_path, monkeypatch):
    path = tmp_path / "store"
    with monkeypatch.context() as patch:
        patch.setattr("jaxvibro.stores.zarr_store._current_versions", lambda: {"jaxvibro": "0.0.9", "jax": "0.1"})
        keep(Counted(3), path)
    with pytest.raises(jv.ArgumentError, match=r"versions that began it.*jaxvibro 0\.0\.9, now"):
        keep(Counted(3), path)
    assert jv.load_store(path).attrs["chunks_done"] == 3  # to be read it may be
    monkeypatch.setattr("jaxvibro.stores.zarr_store.FORMAT_NUMBER", 2)
    with pytest.raises(jv.ArgumentError, match="must be of format 2; got 'format 1 in"):
        jv.load_store(path)


def test_a_folder_that_is_no_store_is_refused(tmp_path):
    (tmp_path / "file").write_text("no folder")
    (tmp_path / "folder").mkdir()
    xr.Dataset({"a": ("b", [1.0])}).to_zarr(tmp_path / "other", zarr_format=3, consolidated=False)
    for name in ("file", "missing/store"):
        with pytest.raises(NotADirectoryError):
            keep(Counted(3), tmp_path / name)
    with pytest.raises(jv.ArgumentError, match="must be a store of jaxvibro"):
        keep(Counted(3), tmp_path / "folder")
    for name, error in (("missing", NotADirectoryError), ("other", jv.ArgumentError)):
        with pytest.raises(error):
            jv.load_store(tmp_path / name)


def test_sizes_are_checked_before_anything_is_made(tmp_path, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr("jaxvibro.stores.study.MAX_BYTES", 700)
        with pytest.raises(jv.ArgumentError, match="store: must be given for results of more than"):
            complete_study(Counted(9), None, None)  # of 9 times 4 times 20 bytes
    monkeypatch.setattr(shutil, "disk_usage", lambda path: SimpleNamespace(free=100))
    with pytest.raises(OSError, match="not enough space for up to") as caught:
        keep(Counted(30), tmp_path / "store")
    assert caught.value.errno == errno.ENOSPC and list(tmp_path.iterdir()) == []


def test_the_chunks_that_are_done_sample_the_whole():
    for chunks in (1, 2, 3, 6, 9, 100, 245, 1000):
        order = spread_chunk_order(chunks)
        assert sorted(order) == list(range(chunks))
        for count in range(8, chunks, 7):
            quarters = np.bincount(np.array(order[:count]) * 4 // chunks, minlength=4)
            assert max(abs(quarters - count / 4)) <= 2.5


def test_threads_work_on_the_device_that_is_named():
    def device(number):
        return jax.config.jax_default_device

    (one, *_) = jax.devices("cpu")
    with jax.default_device(one):
        assert list(jv.LocalEngine(2).each(device, range(3))) == [one] * 3
    assert list(jv.LocalEngine(2).each(device, range(3))) == [None] * 3


def test_invalid_engines_are_refused(tmp_path, monkeypatch):
    for wrong in ({"workers": 0}, {"workers": 1.5}, {"devices": 0}):
        with pytest.raises(jv.ArgumentError, match="must be a whole number from 1 on"):
            jv.LocalEngine(**wrong)
    with pytest.raises(jv.ArgumentError, match="must be None if the address of a cluster is given"):
        jv.DaskEngine("tcp://there:8786", 2)
    with pytest.raises(jv.ArgumentError, match="must be the address of a scheduler"):
        jv.DaskEngine(8786)
    monkeypatch.setattr("jaxvibro.stores.dask_engine.CONNECT_TIMEOUT", 0.3)
    with pytest.raises(OSError, match=r"no scheduler answers at tcp://127.0.0.1:9"):
        complete_study(Counted(3), jv.Store(tmp_path / "store", jv.DaskEngine("tcp://127.0.0.1:9")), None)


def test_a_given_cluster_uses_the_requested_precision_and_raises_the_errors_of_its_workers(tmp_path):
    study = Counted(3, offset=jnp.asarray(1.0 / 3.0))
    assert study.offset.dtype == np.float64
    with LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=None) as cluster:
        engine = jv.DaskEngine(cluster.scheduler_address)
        data = complete_study(study, jv.Store(tmp_path / "there", engine), None)
        with pytest.raises(ArithmeticError, match="chunk 2"):
            complete_study(Counted(4, fails=2), jv.Store(tmp_path / "store", engine), None)
    np.testing.assert_array_equal(data["number"].values[:, 0, 0], 1.0 / 3.0 + np.arange(3))
    keep(study, tmp_path / "here")
    assert bits(tmp_path / "there") == bits(tmp_path / "here")


@pytest.mark.parametrize(("workers", "chunks", "losses"), [(1, 80, 1), (8, 4000, 8)])
def test_own_workers_sample_nothing_and_a_lost_one_is_replaced(workers, chunks, losses):
    """Also the worker that takes the place of a lost one; Dask's settings are restored in the end."""

    def work(number):
        time.sleep(0.002)
        return os.getpid(), dask.config.get("distributed.worker.profile.enabled")

    setting = "distributed.deploy.lost-worker-timeout"
    before, lost, others = dask.config.get(setting), set(), set()
    for done, (process, sampled) in enumerate(jv.DaskEngine(workers=workers).each(work, range(chunks)), 1):
        assert not sampled
        if len(lost) < losses and done > len(lost) * chunks // (2 * losses) and process not in lost:
            assert dask.config.get(setting) == "600.0 s" != before
            os.kill(process, signal.SIGKILL)
            lost.add(process)
        others |= {process} - lost
    assert done == chunks and len(lost) == losses and (len(others) == 1 or workers > 1)
    assert dask.config.get(setting) == before


@pytest.mark.parametrize("rounds", [3, 200])
def test_processes_that_create_one_store_at_once_share_it(rounds):
    """Two processes, four, and two of different studies, some of them killed."""
    command = [sys.executable, "-m", "tests.stores_race", str(rounds)]
    process = subprocess.run(command, cwd=Path(__file__).parents[1], capture_output=True, text=True, timeout=900)
    assert process.returncode == 0, process.stdout + process.stderr


def test_the_loser_of_a_race_leaves_the_folder_of_the_winner(tmp_path):
    path = tmp_path / "store"
    with create_folder_atomically(path) as slow:
        slow.mkdir()
        with create_folder_atomically(path) as fast:
            fast.mkdir()
            (fast / "winner").write_text("")
        assert slow != fast and slow.is_dir()
    assert [file.name for file in path.iterdir()] == ["winner"] and list(tmp_path.iterdir()) == [path]


def test_the_loser_of_a_race_refuses_another_study(tmp_path, monkeypatch):
    path = tmp_path / "store"

    def later(place):
        monkeypatch.undo()
        keep(Counted(3), path)
        return create_folder_atomically(place)

    monkeypatch.setattr("jaxvibro.stores.zarr_store.create_folder_atomically", later)
    with pytest.raises(jv.ArgumentError, match="must hold this study: scene differs"):
        keep(Counted(3, offset=0.25), path)
    keep(Counted(3), tmp_path / "other")
    assert bits(path) == bits(tmp_path / "other")
    assert {file.name for file in tmp_path.iterdir()} == {"store", "other"}


def test_an_error_leaves_nothing_and_names_the_folder(tmp_path):
    with pytest.raises(ArithmeticError), create_folder_atomically(tmp_path / "store") as part:
        part.mkdir()
        raise ArithmeticError
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "file").write_text("")
    for path in (tmp_path / "file" / "store", tmp_path / ("a" * 300)):
        with pytest.raises(OSError, match=re.escape(str(path))), create_folder_atomically(path):
            pass


def abandoned(folder, name):
    """Make what a creator that was killed leaves behind."""
    part = folder / f".{name}.{TOKEN}.partial"
    part.mkdir()
    (part / "zarr.json").write_text("half")
    (folder / f".{name}.{TOKEN}.lock").write_text("")
    return part


def test_folders_of_dead_processes_alone_are_removed(tmp_path):
    path = tmp_path / "a [b].zarr"
    dead, another = abandoned(tmp_path, path.name), abandoned(tmp_path, "c.zarr")
    with create_folder_atomically(path) as live:
        live.mkdir()
        remove_abandoned_folders(path)
        assert live.is_dir() and not dead.exists() and another.is_dir()
        assert sorted(file.suffix for file in tmp_path.glob(".a*")) == [".lock", ".partial"]
    remove_abandoned_folders(tmp_path / "missing" / "store")
    for _ in range(2):  # opening a store removes them as well
        abandoned(tmp_path, "store")
        keep(Counted(3), tmp_path / "store")
    assert {file.name for file in tmp_path.iterdir()} >= {"store"} and not list(tmp_path.glob(".store*"))


def test_a_name_that_is_taken_before_it_is_locked_is_given_up(tmp_path, monkeypatch):
    """Another process removes a lock file between its creation and its locking."""
    removed = []

    def slow(descriptor):
        if not removed:
            removed.extend(tmp_path.glob(".*.lock"))
            removed[0].unlink()
        return acquire_lock(descriptor)

    monkeypatch.setattr("jaxvibro.output.atomic_files.acquire_lock", slow)
    with create_folder_atomically(tmp_path / "store") as part:
        part.mkdir()
        assert part.with_suffix(".lock").is_file() and part.with_suffix(".lock") not in removed
        monkeypatch.undo()
        remove_abandoned_folders(tmp_path / "store")
        assert part.is_dir()
    assert list(tmp_path.iterdir()) == [tmp_path / "store"]


def test_without_locks_nothing_is_taken_for_abandoned(tmp_path, monkeypatch):
    monkeypatch.setattr("jaxvibro.output.atomic_files.fcntl", None)
    path = tmp_path / "store"
    with create_folder_atomically(path) as part:
        part.mkdir()
        assert not part.with_suffix(".lock").exists()
        dead = abandoned(tmp_path, "store")
        remove_abandoned_folders(path)
        assert part.is_dir() and dead.is_dir()
    assert path.is_dir()


def test_unfinished_files_stay_while_another_process_writes_a_chunk(tmp_path):
    path = tmp_path / "store"
    keep(Counted(3), path)
    before = bits(path)
    unfinished = path / "label" / "c" / "0" / "0.abc.partial"
    unfinished.write_text("half")
    with lock_file(path / "zarr.json", shared=True):
        keep(Counted(3), path)
        assert unfinished.exists()
    keep(Counted(3), path)
    assert bits(path) == before


def test_a_chunk_is_written_under_the_lock(tmp_path, monkeypatch):
    path, free = tmp_path / "store", []
    plain = OpenStore._chunk_digest

    def digest(self, number):
        with lock_file(path / "zarr.json", shared=False) as alone:
            free.append(alone)
        return plain(self, number)

    monkeypatch.setattr(OpenStore, "_chunk_digest", digest)
    keep(Counted(1), path, 1)
    assert free[0] is False
    with lock_file(path / "zarr.json", shared=False) as alone:
        assert alone
    assert os.listdir(tmp_path) == ["store"]
