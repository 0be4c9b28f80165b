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
    except jv.ArgumentError as error:
        log.write_text(str(error))
        code = 2
    except BaseException:
        log.write_text(traceback.format_exc())
    finally:
        os._exit(code)


def ended(child):
    """Return the exit code of a process when it ends."""
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def faults_of(folder, rng, processes, whole, two_studies):
    """Run one round and return its faults.

    Of one study, some processes are killed, and a later one must complete the store. Of two, the first to create the
    store wins, and the others are refused.
    """
    path, faults, codes = folder / "store", [], {}
    at = time.monotonic() + 0.02 + 0.01 * rng.random()
    victims = [] if two_studies else rng.sample(range(processes), rng.randrange(processes))  # one at least lives on
    kills = {victim: at + rng.uniform(0.0, LONGEST) for victim in victims}
    logs = [folder / f"log_{number}" for number in range(processes)]
    offsets = [0.25 if two_studies and number % 2 == 0 else 0.5 for number in range(processes)]
    nap = 0.0 if two_studies else 0.002
    children = [
        begin(path, Counted(CHUNKS, nap, offset=each), at, log) for each, log in zip(offsets, logs, strict=True)
    ]
    for victim in sorted(kills, key=kills.get):
        time.sleep(max(0.0, kills[victim] - time.monotonic()))
        os.kill(children[victim], signal.SIGKILL)
    for number, child in enumerate(children):
        code, text = ended(child), logs[number].read_text() if logs[number].exists() else ""
        codes.setdefault(offsets[number], set()).add(code)
        refused = two_studies and code == 2 and "must hold this study: scene differs" in text
        if code and not refused and (code != -signal.SIGKILL or number not in victims):
            faults.append(f"process {number} ended with {code}: {text}")
    if two_studies:
        return faults if sorted(map(sorted, codes.values())) == [[0], [2]] else [*faults, f"not one alone won: {codes}"]
    if code := ended(begin(path, Counted(CHUNKS), at, logs[0])):
        faults.append(f"a later process ended with {code}")
    if not path.is_dir() or bits(path) != whole:
        faults.append("the store is not complete")
    rest = sorted(file.name for file in folder.iterdir() if file != path and file not in logs)
    return faults + [f"left behind: {rest}"] * bool(rest)


def race(count, seed=58):
    """Run rounds with two and four processes in turn, one in ten of two studies; return whether none has a fault."""
    rng, faults = random.Random(seed), []
    _ = Counted(CHUNKS).frame, jv.Store, jv.LocalEngine  # load all that the processes need, before they are forked
    with tempfile.TemporaryDirectory() as where:
        assert ended(begin(Path(where) / "whole", Counted(CHUNKS), 0.0, Path(where) / "log")) == 0
        whole = bits(Path(where) / "whole")
        for number in range(count):
            folder = Path(where) / str(number)
            folder.mkdir()
            faults += faults_of(folder, rng, (2, 4)[number % 2], whole, number % 10 == 2)
            shutil.rmtree(folder)
    print(f"{count} rounds of 2 and 4 processes, seed {seed}: {len(faults)} faults")
    print(*(re.sub(r"\n\s*", " | ", fault)[-600:] for fault in faults), sep="\n")
    return not faults


if __name__ == "__main__":
    sys.exit(not race(int(sys.argv[1])))
