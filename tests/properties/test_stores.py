"""Properties of stores: studies in chunks give the same bits on any engine, and go on after any end."""

import os
import random
import subprocess
import sys
import tempfile
import time
import warnings
from contextlib import contextmanager
from pathlib import Path
from unittest import mock

import numpy as np
import psutil
import pytest
import xarray as xr

import jaxvibro as jv
from jaxvibro.stores.zarr_store import OpenStore
from tests.stored_studies import KINDS, bits
from tests.tiers import generator, of_numbers

OWN_KINDS = KINDS
ROOT = Path(__file__).parents[2]
SCHEDULER = """
import time
from distributed import LocalCluster
if __name__ == "__main__":
    cluster = LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=None, silence_logs=50)
    print(cluster.scheduler_address, flush=True)
    time.sleep(600)
"""


@contextmanager
def folder():
    """Give a new folder for the time of a draw."""
    with tempfile.TemporaryDirectory() as path:
        yield Path(path)


def marks(path):
    """Return {chunk: when its mark was written} of the chunks of a store that are done."""
    place = Path(path) / "done" / "c"
    return {mark.name: mark.stat().st_mtime_ns for mark in place.glob("*") if mark.suffix == ""}


@of_numbers
def test_engines(kind, number):
    """A store has the bits of a run in memory, with one thread or several, chunk by chunk; a second run leaves them."""
    compute, reports = kind.draw(number), []
    whole = compute()
    assert kind.name != "counted" or (whole["label"] == np.arange(whole.sizes["row"])[:, None]).all()
    with folder() as place:
        for name, engine in (("one", jv.LocalEngine(1)), ("several", jv.LocalEngine(3))):
            xr.testing.assert_identical(compute(jv.Store(place / name, engine), reports.append), whole)
            assert bits(place / name) == bits(place / "one")
        before = marks(place / "one")
        xr.testing.assert_identical(compute(jv.Store(place / "one"), reports.append), whole)
        assert marks(place / "one") == before
        with pytest.raises(jv.ArgumentError, match=r"must hold this study: .* differs"):
            kind.draw(number + 1)(jv.Store(place / "one"))
        assert bits(place / "one") == bits(place / "several")
        loaded = jv.load_store(place / "one")
        assert loaded.attrs["chunks"] == loaded.attrs["chunks_done"] == len(before) > 1
        for key in loaded.data_vars:
            if key in whole and loaded[key].dims == whole[key].dims:
                np.testing.assert_array_equal(loaded[key], whole[key])
    done = [getattr(report, "done", report) for report in reports]
    assert done[-1] == max(done) and done.count(0) == 2  # of each of the first two runs


@of_numbers
def test_processes(kind, number):
    """Workers of Dask give the bits of a run in this process."""
    compute = kind.draw(number)
    with folder() as place:
        there = compute(jv.Store(place / "there", jv.DaskEngine(workers=2)))
        xr.testing.assert_identical(there, compute(jv.Store(place / "here")))
        assert bits(place / "there") == bits(place / "here")


@of_numbers
def test_interruption(kind, number):
    """After an error at any chunk the others are kept, and a later run computes the rest alone."""
    compute, put = kind.draw(number), OpenStore.put
    with folder() as place:
        whole = compute(jv.Store(place / "whole"))
        chunks = len(marks(place / "whole"))
        last, calls = int(generator(kind, number).integers(chunks)), []

        def limited(self, *chunk):
            calls.append(chunk[0])
            if len(calls) > last:
                raise OSError("No space left")
            put(self, *chunk)

        store = jv.Store(place / "part", jv.LocalEngine(1))
        with mock.patch.object(OpenStore, "put", limited), pytest.raises(OSError, match="No space left"):
            compute(store)
        before = marks(place / "part")
        assert len(before) == last
        xr.testing.assert_identical(compute(store), whole)
        assert bits(place / "part") == bits(place / "whole")
        assert before.items() <= marks(place / "part").items()


@of_numbers
def test_limits(kind, number):
    """When the time is over, what is done is that of the whole and the rest is blank; a later run completes a store."""
    compute, (name, blank) = kind.draw(number), kind.blank
    whole = compute()
    with folder() as place:
        store = jv.Store(place / "store", jv.LocalEngine(1))
        for kept in (None, store):
            seconds = iter(range(1_000_000))
            with mock.patch("continuation.branch_segment.clock", lambda seconds=seconds: float(next(seconds))):
                part = compute(kept, max_seconds=1.5)
            done = part[name] != blank
            if kept is None and kind.name in ("basins", "sweep"):  # of one chunk
                assert done.all() and "stopped" not in part.attrs
                continue
            unit = "cells" if kept or kind.name == "map" else "values"
            assert 0 < done.sum() < done.size
            assert part.attrs["stopped"].startswith("max_seconds reached: ") and f"{unit} done" in part.attrs["stopped"]
            for key, values in part.data_vars.items():
                if set(done.dims) <= set(values.dims):
                    same = (values == whole[key]) | (values.isnull() & whole[key].isnull())
                    assert same.where(done, True).all(), key
                    assert values.dtype.kind != "f" or values.isnull().where(~done, True).all(), key
        loaded = jv.load_store(store.path)
        assert ((loaded[name] != blank) & loaded[name].notnull()).sum() == done.sum()
        assert 0 < loaded.attrs["chunks_done"] < loaded.attrs["chunks"]
        xr.testing.assert_identical(compute(store), whole)


@of_numbers
def test_damage(kind, number):
    """A file of a store that is changed, cut or removed is reported; damaged chunks are recomputed, with their bits."""
    compute, rng = kind.draw(number), generator(kind, number)
    with folder() as place:
        store = jv.Store(place / "store")
        compute(store)
        before = bits(store.path)
        for _ in range(6):
            file = Path(store.path) / rng.choice(list(before))
            content = file.read_bytes()
            byte = int(rng.integers(len(content)))
            flipped = content[:byte] + bytes([content[byte] ^ (1 << int(rng.integers(8)))]) + content[byte + 1 :]
            changed = [flipped, content[:byte], None][int(rng.integers(3))]
            file.unlink() if changed is None else file.write_bytes(changed)
            with warnings.catch_warnings(record=True):
                warnings.simplefilter("always")
                try:
                    compute(store)
                except (jv.ArgumentError, OSError):
                    assert "/c/" not in str(file) or "done" not in str(file)
                    with pytest.raises((jv.ArgumentError, OSError)):
                        jv.load_store(store.path)
                    file.write_bytes(content)
            assert bits(store.path) == before, (file, changed)


@of_numbers
def test_kills(kind, number):
    """After a kill (-9) of the process, a worker, the scheduler or the client, no chunk that is done is done again."""
    victim, compute = ("process", "worker", "scheduler", "client")[number % 4], kind.draw(number)
    with folder() as place:
        whole = compute(jv.Store(place / "whole"))
        chunks, path = len(marks(place / "whole")), place / "killed"
        wanted = int(generator(kind, number).integers(1, chunks))
        environment = {**os.environ, "PYTHONPATH": str(ROOT)}
        engine, scheduler = "local" if victim == "process" else "dask", None
        if victim == "scheduler":
            command = [sys.executable, "-c", SCHEDULER]
            scheduler = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=ROOT, env=environment)
            engine = scheduler.stdout.readline().strip()
        command = [sys.executable, "-m", "tests.stored_studies", kind.name, str(number), str(path), engine]
        process = subprocess.Popen(command, cwd=ROOT, env=environment, stderr=subprocess.DEVNULL)
        while process.poll() is None and len(marks(path)) < wanted:
            time.sleep(0.002)
        before = marks(path)
        processes = children(process.pid)
        if victim == "worker":
            workers = [one for one in processes if "spawn_main" in " ".join(one.cmdline())]
            random.Random(number).choice(workers).kill()
            assert process.wait(300) == 0  # another worker takes the place of the lost one
        elif victim == "scheduler":
            for one in [*children(scheduler.pid), psutil.Process(scheduler.pid)]:
                one.kill()
            process.wait(300)
        else:
            process.kill()
        for one in [*processes, *([process] if scheduler is None else [process, scheduler])]:
            end(one)
        xr.testing.assert_identical(compute(jv.Store(path)), whole)
        assert bits(path) == bits(place / "whole")
        assert before and before.items() <= marks(path).items()


def children(pid):
    """Return the processes below a process."""
    try:
        return psutil.Process(pid).children(recursive=True)
    except psutil.Error:
        return []


def end(process):
    """End a process of this test, if it is still there."""
    try:
        process.kill()
        process.wait(60)
    except psutil.Error:
        pass
