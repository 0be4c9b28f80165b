"""Processes that create and continue one store at once, some of them killed (-9): `python -m tests.stores_race COUNT`.

The processes are forked from one that has loaded everything and started nothing, so that a round takes a moment.
"""

import os
import random
import re
import shutil
import signal
import sys
import tempfile
import time
import traceback
from pathlib import Path

import jaxvibro as jv
from jaxvibro.stores.study_completion import complete_study

from .counted_study import Counted
from .stored_bits import bits

CHUNKS = 5
LONGEST = 0.3  # s: the latest kill


def begin(path, study, at, log):
    """Fork a process that works the study out from a moment on; its exit code is 0, 2 for an ArgumentError, else 1."""
    child = os.fork()
    if child:
        return child
    code = 1
    try:
        while time.monotonic() < at:
            pass
        complete_study(study, jv.Store(path, jv.LocalEngine(1)), None)
        code = 0
    except jv.ArgumentError as error:
        log.write_text(str(error))
        code = 2
    except BaseException:
        log.write_text(traceback.format_exc())
    finally:
        os._exit(code)


def round_of(folder, rng, processes, whole):
    """One round: a list of faults, and how many processes were killed while the store was being created."""
    path, faults, early = folder / "store", [], 0
    at = time.monotonic() + 0.02
    victims = set(rng.sample(range(processes), rng.randrange(processes)))  # one process at least lives on
    kills = {one: at + rng.uniform(0.0, LONGEST) for one in victims}
    logs = [folder / f"log_{one}" for one in range(processes)]
    children = [begin(path, Counted(CHUNKS, 0.002), at, log) for log in logs]
    for one in sorted(kills, key=kills.get):
        time.sleep(max(0.0, kills[one] - time.monotonic()))
        early += not path.exists()
        os.kill(children[one], signal.SIGKILL)
    for one, child in enumerate(children):
        _, status = os.waitpid(child, 0)
        code = os.waitstatus_to_exitcode(status)
        if code and code != -signal.SIGKILL:
            faults.append(f"process {one} ended with {code}: {logs[one].read_text() if logs[one].exists() else ''}")
    if again := ended(begin(path, Counted(CHUNKS), at, logs[0])):
        faults.append(f"a later process ended with {again}")
    if not path.is_dir() or bits(path) != whole:
        faults.append("the store is not complete")
    left = sorted(one.name for one in folder.iterdir() if one != path and one not in logs)
    return faults + [f"left behind: {left}"] * bool(left), early


def round_of_two_studies(folder, rng, processes, whole):
    """One round with processes of two studies: the first to create the store wins, the others are refused."""
    path, faults, codes = folder / "store", [], {}
    at = time.monotonic() + 0.02 + 0.01 * rng.random()
    logs = [folder / f"log_{one}" for one in range(processes)]
    offsets = [0.5 if one % 2 else 0.25 for one in range(processes)]
    children = [begin(path, Counted(CHUNKS, offset=each), at, log) for each, log in zip(offsets, logs, strict=True)]
    for offset, child, log in zip(offsets, children, logs, strict=True):
        code = ended(child)
        codes.setdefault(offset, set()).add(code)
        rule = "must hold this study: scene differs"
        if code not in (0, 2) or (code == 2 and rule not in log.read_text()):
            faults.append(f"ended with {code}: {log.read_text()}")
    if sorted(map(sorted, codes.values())) != [[0], [2]]:
        faults.append(f"not one study alone won: {codes}")
    return faults, 0


def ended(child):
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def race(count, seed=58):
    """Rounds with two and four processes in turn, one in ten of two studies. Prints a summary; the faults."""
    rng, faults, early, began = random.Random(seed), [], 0, time.perf_counter()
    _ = Counted(CHUNKS).frame, jv.Store, jv.LocalEngine  # loads all that the processes need, before they are forked
    with tempfile.TemporaryDirectory() as where:
        reference = Path(where) / "whole"
        assert ended(begin(reference, Counted(CHUNKS), 0.0, Path(where) / "log")) == 0
        whole = bits(reference)
        for number in range(count):
            folder = Path(where) / str(number)
            folder.mkdir()
            one = round_of_two_studies if number % 10 == 2 else round_of
            found, killed = one(folder, rng, (2, 4)[number % 2], whole)
            faults += [f"round {number}: {each}" for each in found]
            early += killed
            shutil.rmtree(folder)
    seconds = time.perf_counter() - began
    for each in faults:
        print(re.sub(r"\n\s*", " | ", each)[-600:])
    killed = f"{early} processes killed before the store was there"
    print(f"{count} rounds of 2 and 4 processes, seed {seed}: {len(faults)} faults; {killed}; {seconds:.0f} s")
    return faults


if __name__ == "__main__":
    sys.exit(bool(race(int(sys.argv[1]))))
