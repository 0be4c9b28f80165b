"""Processes that create and continue one store at once, some of them killed (-9): `python -m tests.stores_race COUNT`.

The processes are forked from one that has loaded everything and started nothing, so that a round takes a moment.
"""

import os
import random
import signal
import sys
import tempfile
import time
import traceback
from pathlib import Path

import jaxvibro as jv

from .stored_studies import Counted, bits, keep

CHUNKS = 5
LONGEST = 0.3  # s: the latest kill


def begin(path, study, at, log):
    """Fork a process that computes the study from a moment on; its exit code is 0, 2 for an ArgumentError, else 1."""
    child = os.fork()
    if child:
        return child
    code = 1
    try:
        while time.monotonic() < at:
            pass
        keep(study, path, 1)
        code = 0
    except BaseException as error:
        code = 2 if isinstance(error, jv.ArgumentError) else 1
        log.write_text(traceback.format_exc())
    finally:
        os._exit(code)


def ended(child):
    """Return the exit code of a process when it ends."""
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def check_round(folder, rng, processes, whole, two_studies):
    """Start processes at once; one of two studies alone wins the store, and a store of one study is completed."""
    path, at = folder / "store", time.monotonic() + 0.02 + 0.01 * rng.random()
    victims = [] if two_studies else rng.sample(range(processes), rng.randrange(processes))  # one at least lives on
    kills = {victim: at + rng.uniform(0.0, LONGEST) for victim in victims}
    offsets = [0.25 if two_studies and number % 2 == 0 else 0.5 for number in range(processes)]
    logs, nap = [folder / f"log_{number}" for number in range(processes)], 0.0 if two_studies else 0.002
    children = [
        begin(path, Counted(CHUNKS, nap, offset=offset), at, log) for offset, log in zip(offsets, logs, strict=True)
    ]
    for victim in sorted(kills, key=kills.get):
        time.sleep(max(0.0, kills[victim] - time.monotonic()))
        os.kill(children[victim], signal.SIGKILL)
    codes = [ended(child) for child in children]
    texts = [log.read_text() if log.exists() else "" for log in logs]
    if two_studies:
        refused = ["must hold this study: scene differs" in text for text in texts]
        outcomes = set(zip(offsets, codes, refused, strict=True))
        assert sorted(outcome[1:] for outcome in outcomes) == [(0, False), (2, True)], texts
        return
    killed = [code == -signal.SIGKILL and number in victims for number, code in enumerate(codes)]
    assert all(dead or not code for dead, code in zip(killed, codes, strict=True)), texts
    assert ended(begin(path, Counted(CHUNKS), at, logs[0])) == 0
    assert bits(path) == whole
    assert [file for file in folder.iterdir() if file != path and file not in logs] == []


def race(count, seed=58):
    """Run rounds with two and four processes in turn, one in ten of two studies."""
    rng = random.Random(seed)
    _ = Counted(CHUNKS).frame, jv.Store, jv.LocalEngine  # load all that the processes need, before they are forked
    with tempfile.TemporaryDirectory() as where:
        assert ended(begin(Path(where) / "whole", Counted(CHUNKS), 0.0, Path(where) / "log")) == 0
        whole = bits(Path(where) / "whole")
        for number in range(count):
            folder = Path(where) / str(number)
            folder.mkdir()
            check_round(folder, rng, (2, 4)[number % 2], whole, number % 10 == 2)


if __name__ == "__main__":
    race(int(sys.argv[1]))
