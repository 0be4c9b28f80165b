"""A small case of what is too long for every run: the verification scripts and the files with long tests.

A third of them is tried in each run; the commit decides which. A script, or a long test, is stopped after a time limit
and has then passed: the trial finds names that no longer exist, not wrong numbers.
"""

import os
import signal
import subprocess
import sys
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PARTS = 3
SCRIPT_SECONDS = 16.0
TEST_SECONDS = 8.0

# The smallest case of each verification script; FOLDER is a temporary one.
SCRIPTS = {
    "alone": (),
    "arguments": ("5",),
    "attractors": ("1", "FOLDER"),
    "basins": ("100",),
    "branch": ("specials", "1"),
    "cache": ("2",),
    "cascade": ("1", "50"),
    "codim2": ("tangent", "1"),
    "compositions": ("1", "FOLDER"),
    "cuda": None,  # needs a graphics card: imported alone
    "degenerate": ("10",),
    "energy": ("1000", "4"),
    "explore": ("fig4", "4", "1"),
    "files": ("flips", "2"),
    "fit": ("settled", "1"),
    "force": ("spring", "10"),
    "fractions": ("fig4", "1", "1"),
    "graze_within": ("1",),
    "harmonics": ("1", "1"),
    "isolas": ("1",),
    "least_shock": ("1", "10"),
    "located": ("gradients", "1"),
    "locus": ("1",),
    "map": ("map", "2", "FOLDER"),
    "margin": ("loci", "1"),
    "normal_forms": ("folds", "1"),
    "paper": ("1",),
    "place": ("1", "1"),
    "rest": ("chatter", "2"),
    "rest_slopes": ("first", "8"),
    "sample": ("2",),
    "scenario": ("returns", "1"),
    "search": ("1",),
    "slopes": ("first", "1"),
    "soft": ("strobe", "2", "FOLDER", "1"),
    "soft_force": ("1",),
    "soft_studies": ("exponents",),
    "spectrum": ("20", "720"),
    "status": ("lanes", "10"),
    "stores": ("kill", "1"),
    "tiers": ("maps", "10"),
    "trace": ("1",),
}


def part():
    """The part that is tried: 0, 1 or 2, by the commit."""
    command = ["git", "rev-parse", "HEAD"]
    commit = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False).stdout.strip()
    return int(commit or "0", 16) % PARTS


def script_error(name, arguments, seconds=SCRIPT_SECONDS):
    """Run a verification script for a while: its last lines if it failed, "" otherwise."""
    module = f"tests.{name}_proof"
    run = ["-c", f"import {module}"] if arguments is None else ["-m", module, *arguments]
    command = [sys.executable, *run]
    options = {"cwd": ROOT, "stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
    with subprocess.Popen(command, start_new_session=True, **options) as process:
        try:
            output, _ = process.communicate(timeout=seconds)
        except subprocess.TimeoutExpired:
            return ""
        finally:
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
    failed = process.returncode < 0 or process.returncode == 2 or "Traceback" in output
    return output[-2000:] or f"exit status {process.returncode}" if failed else ""


class OutOfTime(pytest.fail.Exception):
    """A long test has run for its time without an error.

    No `except Exception` of the code under test catches it; pytest knows it, and lets a stopped fixture be torn down.
    """


STOPPED = pytest.StashKey[bool]()  # of a test whose time ended


def choose(items):
    """The long tests that are tried: the first one of a third of the files that have any."""
    first = {}
    for item in items:
        if item.get_closest_marker("long") and not item.get_closest_marker("browser"):
            first.setdefault(item.path, item)
    chosen = part()
    return [item for k, (_, item) in enumerate(sorted(first.items())) if k % PARTS == chosen]


@contextmanager
def time_limit(seconds, stash):
    """Raise OutOfTime in the main thread after some seconds, and note it in the stash of the test."""

    def stop(number, frame):
        stash[STOPPED] = True
        raise OutOfTime

    previous = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, previous)
