"""`make mutate`: guards of the package broken one by one, each in a copy and against a fast test that ought to notice.

The list is data, a file of tables for each room in `tests/mutants`. A table's name says which guard it is; it has

- file, text, becomes: where it stands, how it reads there, once, and what it is made to read;
- tests: node ids of the tests that are run, a few seconds each; guard: what it is for;
- survives: why no test can notice, where that is so; endless: true where a loop then has no end, so that a run that is
  stopped has been noticed.
"""

import argparse
import os
import shutil
import signal
import subprocess
import sys
import time
import tomllib
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

ROOT = Path(__file__).parents[1]
FOLDERS = ("jaxvibro", "continuation", "tests", "scenes")  # of a copy, beside pyproject.toml
LIMIT = 60.0  # seconds of a run
ENOUGH = 0.95  # of the mutants are to be killed
KILLED, SURVIVED, TOO_LONG, NOT_RUN = "killed", "survived", "too long", "not run"
RUN = ("-m", "pytest", "-q", "-x", "--no-header", "-p", "no:cacheprovider")


@dataclass(frozen=True)
class Mutant:
    """A table of the list. room: its file's name; name: its own."""

    room: str
    name: str
    file: str
    text: str
    becomes: str
    tests: list[str]
    guard: str
    survives: str = ""
    endless: bool = False


def mutants():
    """All that are listed, in order."""
    files = sorted((ROOT / "tests" / "mutants").glob("*.toml"))
    return [
        Mutant(path.stem, name, **table)
        for path in files
        for name, table in tomllib.loads(path.read_text("utf-8")).items()
    ]


def broken(one, source):
    """The text of a file with the guard broken. Raises ValueError unless it reads so in one place."""
    count = source.count(one.text)
    if count != 1 or one.text == one.becomes:
        raise ValueError(f"{one.room}: {one.name}: {one.file} has its text {count} times: {one.text}")
    return source.replace(one.text, one.becomes)


def environment(folder, cache):
    """Of a run in a folder: its own sources, and what is compiled kept for all."""
    own = {name: value for name, value in os.environ.items() if not name.startswith("JAX_")}
    return own | {
        "PYTHONPATH": str(folder),
        "JAX_COMPILATION_CACHE_DIR": str(cache),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
        "JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES": "-1",
    }


def copied(folder):
    """The sources in a folder of their own."""
    folder.mkdir()
    for name in FOLDERS:
        shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy2(ROOT / "pyproject.toml", folder)
    return folder


def unbroken(whole, cache, tests, jobs):
    """Run all tests as they should pass, which compiles what is kept. Raises SystemExit where one does not."""
    given = {"cwd": whole, "env": environment(whole, cache)}
    where = "import continuation, jaxvibro; print(continuation.__file__, jaxvibro.__file__)"
    told = subprocess.run([sys.executable, "-c", where], check=True, capture_output=True, text=True, **given)
    if told.stdout.count(str(whole)) != 2:
        raise SystemExit(f"the copy is not what is imported: {told.stdout}")
    if subprocess.run([sys.executable, *RUN, "-n", str(jobs), "--dist", "worksteal", *tests], **given).returncode:
        raise SystemExit("a test fails though nothing is broken")


def attempt(one, whole, cache):
    """(what became of a mutant, seconds, the end of what was printed)."""
    with TemporaryDirectory(dir=whole.parent) as folder:
        place = Path(folder) / "broken"
        shutil.copytree(whole, place)
        path = place / one.file
        for stale in (path.parent / "__pycache__").glob(f"{path.stem}.*.pyc"):
            stale.unlink()  # it is told by the file's size and second alone
        path.write_text(broken(one, path.read_text("utf-8")), "utf-8")
        begun = time.monotonic()
        run = subprocess.Popen(
            [sys.executable, *RUN, *one.tests],
            cwd=place,
            env=environment(place, cache),
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,
        )
        try:
            told, _ = run.communicate(timeout=LIMIT)
        except subprocess.TimeoutExpired:
            os.killpg(run.pid, signal.SIGKILL)
            run.communicate()
            return TOO_LONG, LIMIT, ""
        result = {0: SURVIVED, 1: KILLED}.get(run.returncode, NOT_RUN)  # 1: a test fails; else it crashed
        return result, time.monotonic() - begun, told[-2000:]


def judged(found):
    """Print the summary of (mutant, result) pairs; whether they are enough."""
    rooms, dead = Counter(one.room for one, _ in found), Counter()
    for one, result in found:
        dead[one.room] += result == KILLED or (result == TOO_LONG and one.endless)
    print("\n" + ", ".join(f"{room} {dead[room]} of {count}" for room, count in rooms.items()))
    ended = sum(one.endless and result == TOO_LONG for one, result in found)
    print(f"killed {sum(dead.values())} of {len(found)}, {ended} of them as a loop had no end")
    good = sum(dead.values()) >= ENOUGH * len(found)
    for one, result in found:
        if result == KILLED and one.survives:
            print(f"{one.room}: {one.name}: is noticed, though the list says: {one.survives}")
        if result == KILLED or (result == TOO_LONG and one.endless):
            continue
        explained = result == SURVIVED and one.survives
        print(f"{one.room}: {one.name}: {result}: {one.survives or 'unexplained'}")
        good &= bool(explained)
    return good


def main():
    parser = argparse.ArgumentParser(prog="python -m tests.mutate", description=__doc__.split("\n")[0])
    parser.add_argument("--jobs", type=int, default=2, help="runs at a time")
    parser.add_argument("--only", default="", help="mutants whose 'room: name' has this in it")
    parser.add_argument("--show", action="store_true", help="the end of what each run printed")
    given = parser.parse_args()
    some = [one for one in mutants() if given.only in f"{one.room}: {one.name}"]
    for one in some:
        broken(one, (ROOT / one.file).read_text("utf-8"))
    begun = time.monotonic()
    with TemporaryDirectory() as folder:
        whole, cache = copied(Path(folder) / "whole"), Path(folder) / "cache"
        unbroken(whole, cache, sorted({test for one in some for test in one.tests}), given.jobs)
        print(f"all pass unbroken, {time.monotonic() - begun:.0f} s", flush=True)
        found = []
        with ThreadPoolExecutor(given.jobs) as pool:
            runs = pool.map(lambda one: attempt(one, whole, cache), some)
            for one, (result, seconds, told) in zip(some, runs, strict=True):
                print(f"{result:9s}{seconds:6.1f} s  {one.room}: {one.name}", flush=True)
                if given.show or result == NOT_RUN:
                    print(told)
                found.append((one, result))
    good = judged(found)
    print(f"{time.monotonic() - begun:.0f} s")
    raise SystemExit(0 if good else 1)


if __name__ == "__main__":
    main()
