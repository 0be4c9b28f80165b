"""Stores that are killed: `python -m tests.stores_proof [kill COUNT [KIND ...]] [workers COUNT CHUNKS] [race COUNT]`.

kill: a map worked out over and over, its process, a Dask worker, the scheduler or the client killed (-9) at random
moments; after each the next run goes on. The store must end bit for bit as one that was never killed, and no chunk
that was done may be done again. workers: a cluster of 64 workers of which some are lost all the time, and chunks that
only sleep. race: rounds in which two and four processes create and continue one store at once, some of them killed.
"""

import os
import random
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from contextlib import suppress
from pathlib import Path

import numpy as np
import psutil

import jaxvibro as jv
from jaxvibro.stores.study_completion import complete_study
from jaxvibro.stores.zarr_store import OpenStore

from .counted_study import Counted, counts
from .stored_bits import bits
from .stores_race import race

ROOT = Path(__file__).parents[1]
KINDS = ("local", "worker", "scheduler", "client")
EVERY = 20.0  # s between two losses, on average: a new worker takes a core for three
MAP = """
import sys
import numpy as np
import jax
jax.config.update("jax_enable_x64", True)
import jaxvibro as jv
engine = jv.LocalEngine() if sys.argv[2] == "local" else jv.DaskEngine(None if sys.argv[2] == "dask" else sys.argv[2])
if __name__ == "__main__":
    scene = jv.make_scene(4.65, 2.1, 0.05, 0.7, (jv.Wall(-1.0), jv.Wall(1.0)))
    grid = {"amplitude": np.linspace(1.0, 6.0, 60), "frequency": np.linspace(1.5, 3.5, 64)}
    jv.map_parameters(scene, grid, chunk=128, store=jv.Store(sys.argv[1], engine))
"""


def begun(folder, script, engine):
    return subprocess.Popen(
        [sys.executable, script, str(folder), engine],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )


def marks(folder):
    """{chunk: when its mark was written} of those that are done."""
    place = Path(folder) / "done" / "c"
    return {one.name: one.stat().st_mtime_ns for one in place.iterdir() if one.suffix == ""} if place.is_dir() else {}


def ended(process):
    """Whether a run ended well."""
    return process.wait() == 0


def kill(count, rng, kinds):
    """Kills runs of a map, in turn local, a Dask worker, the scheduler, the client."""
    with tempfile.TemporaryDirectory() as where:
        script = Path(where) / "work.py"
        script.write_text(MAP)
        began = time.perf_counter()
        assert ended(begun(Path(where) / "whole", script, "local"))
        whole = bits(Path(where) / "whole")
        seconds = time.perf_counter() - began
        print(f"never killed: {len(marks(Path(where) / 'whole'))} chunks, {seconds:.1f} s", flush=True)
        for kind in kinds:
            kills = again = 0
            while kills < count:
                folder = Path(where) / kind
                shutil.rmtree(folder, ignore_errors=True)
                while kills < count:
                    before = marks(folder)
                    finished = killed(kind, folder, script, rng.uniform(0.2, 1.1) * seconds)
                    after = marks(folder)
                    again += sum(after.get(name) != when for name, when in before.items())
                    kills += not finished
                    if finished:
                        break
            assert ended(begun(folder, script, "local"))
            alike = bits(folder) == whole
            print(
                f"{kind}: killed {kills} times, {again} chunks done twice, bits {'alike' if alike else 'OTHERS'}",
                flush=True,
            )


def killed(kind, folder, script, after):
    """Runs the map and kills what is to be killed after so many seconds; whether it had ended by itself before."""
    scheduler, engine = None, "local" if kind == "local" else "dask"
    if kind == "scheduler":
        scheduler = subprocess.Popen(
            [sys.executable, "-c", SCHEDULER],
            stdout=subprocess.PIPE,
            text=True,
            cwd=ROOT,
            env={**os.environ, "PYTHONPATH": str(ROOT)},
        )
        engine = scheduler.stdout.readline().strip()
    process = begun(folder, script, engine)
    end = time.monotonic() + after
    while process.poll() is None and time.monotonic() < end:
        time.sleep(0.02)
    well = process.poll() is not None
    if not well:
        below = psutil.Process(process.pid).children(recursive=True)
        if kind == "worker":
            if found := workers_of(psutil.Process(process.pid)):
                random.Random(after).choice(found).kill()
            process.wait(timeout=600)  # the nanny begins another, and the run ends well
        elif kind == "scheduler":
            for one in psutil.Process(scheduler.pid).children(recursive=True):
                one.kill()
            scheduler.kill()
            process.wait(timeout=600)
        else:
            process.kill()
            process.wait()
            for one in below:  # what outlives its client for a moment
                try:
                    one.wait(60)
                except psutil.TimeoutExpired:
                    one.kill()
    if scheduler is not None:
        for one in [*psutil.Process(scheduler.pid).children(recursive=True)] if scheduler.poll() is None else []:
            one.kill()
        scheduler.kill()
        scheduler.wait()
    return well


SCHEDULER = """
import time
from distributed import LocalCluster
if __name__ == "__main__":
    cluster = LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None, silence_logs=50)
    print(cluster.scheduler_address, flush=True)
    time.sleep(3600)
"""


def workers(count, chunks, rng):
    """Chunks that only sleep, on so many workers of which one is killed every second."""
    with tempfile.TemporaryDirectory() as where:
        log, nap = str(Path(where) / "log"), 0.02
        study, place = Counted(chunks, nap, log), Path(where) / "store"
        kept = jv.Store(place, jv.DaskEngine(workers=count))
        began, ends, lost = time.perf_counter(), threading.Event(), []
        killer = threading.Thread(target=lose, args=(log, ends, lost, rng))
        killer.start()
        try:
            found = complete_study(study, kept, None)
        finally:
            ends.set()
            killer.join()
        seconds = time.perf_counter() - began
        times = counts(log)
        assert (found["label"].values[:, 0] == np.arange(chunks)).all()
        assert OpenStore(str(place)).damaged_chunks() == []
        twice = sum(1 for each in times.values() if each > 1)
        print(f"{count} workers, {len(lost)} lost, {chunks} chunks: all done, {twice} of them begun again")
        over = 1e3 * (seconds / chunks - nap / count)
        print(f"{1e3 * seconds / chunks:.2f} ms a chunk in all, {over:.2f} ms more than naps on as many workers take")


def lose(log, ends, lost, rng):
    """Kills a worker of this process every few seconds, from the first chunk that is done until told to end."""
    while not ends.wait(rng.uniform(0.0, 2.0 * EVERY)):
        found = workers_of(psutil.Process())
        if found and os.path.exists(log):
            rng.choice(found).kill()
            lost.append(1)


def workers_of(process):
    """The Dask workers below a process that are there."""
    found = []
    for one in process.children(recursive=True):
        with suppress(psutil.Error):
            if "spawn_main" in " ".join(one.cmdline()):
                found.append(one)
    return found


if __name__ == "__main__":
    asked = sys.argv[1:] or ["kill", "20"]
    if asked[0] == "kill":
        kill(int(asked[1]), random.Random(25), asked[2:] or KINDS)
    elif asked[0] == "race":
        sys.exit(bool(race(int(asked[1]))))
    else:
        workers(int(asked[1]), int(asked[2]), random.Random(25))
