"""Break the packages at one place at a time, in a copy, and check that a test fails.

- `python -m tests.mutate` (`make mutate`) runs the listed mutants of `tests/mutants`, each against a fast test. A table
  is named after the guard that it removes. Fields: file, text, becomes: the code and its replacement; tests: node ids
  of tests of a few seconds; guard: its purpose; survives: the reason why no test can notice it; endless: true if a
  loop then does not end, so that a stopped run counts as a killed mutant.
- `python -m tests.mutate draw COUNT SEED` draws mutants and writes them to `tests/mutants/drawn.toml`.
- `python -m tests.mutate drawn` runs these: each against the properties of its folder and the test files of its folder
  (`tests/mutants/folders.toml`) as on each push, then as in CI, then against all tests of a push. Results are kept in
  `out/mutants/drawn.jsonl`; a later call continues with those that are missing or have survived.
"""

import argparse
import json
import os
import shutil
import signal
import subprocess
import sys
import time
import tomllib
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory

from . import drawn_mutants

ROOT = Path(__file__).parents[1]
MUTANTS = ROOT / "tests" / "mutants"
DRAWN, FOLDERS = drawn_mutants.DRAWN, MUTANTS / "folders.toml"
RESULTS = ROOT / "out" / "mutants" / "drawn.jsonl"
NOT_COPIED = shutil.ignore_patterns(".git", ".venv", ".tools", ".hypothesis", "out", "__pycache__", ".*_cache")
LISTED_LIMIT, DRAWN_LIMIT = 60.0, 3600.0  # seconds of a run
ENOUGH = 0.95  # share of the listed mutants that must be killed
KILLED, SURVIVED, TOO_LONG, NOT_RUN = "killed", "survived", "too long", "not run"
RUN = ("-m", "pytest", "-q", "-x", "--no-header", "-p", "no:cacheprovider")


@dataclass(frozen=True)
class Mutant:
    """A table of a list. folder: of the packages; line: where the text begins, 0 if it occurs only once."""

    folder: str
    name: str
    file: str
    text: str
    becomes: str
    tests: list[str] = field(default_factory=list)
    guard: str = ""
    survives: str = ""
    endless: bool = False
    line: int = 0
    kind: str = ""


def read_table(path):
    """Return the tables of a file."""
    return tomllib.loads(path.read_text("utf-8"))


def listed_mutants():
    """Return the listed mutants in order."""
    files = sorted(path for path in MUTANTS.glob("*.toml") if path not in (DRAWN, FOLDERS))
    return [Mutant(path.stem, name, **table) for path in files for name, table in read_table(path).items()]


def drawn_list():
    """Return the drawn mutants in order."""
    return [Mutant(name.split()[0], name, **table) for name, table in read_table(DRAWN).items()]


def mutated(mutant, source):
    """Return the source of a file with a mutant. Raises ValueError if its text does not occur there exactly once."""
    start = sum(map(len, source.splitlines(keepends=True)[: max(mutant.line - 1, 0)]))
    head, tail = source[:start], source[start:]
    count = int(tail.startswith(mutant.text)) if mutant.line else source.count(mutant.text)
    if count != 1 or mutant.text == mutant.becomes:
        raise ValueError(f"{mutant.folder}: {mutant.name}: {mutant.file} has its text {count} times: {mutant.text}")
    return head + tail.replace(mutant.text, mutant.becomes, 1)


def stages(mutant):
    """Return the arguments of pytest of the runs against which a drawn mutant is tried, one after another."""
    files = [f"tests/{name}.py" for name in read_table(FOLDERS)[mutant.folder]]
    properties = f"tests/properties/test_{mutant.folder}.py"
    own = [row for row in ([properties] if (ROOT / properties).exists() else [], files) if row]
    return [["--tier", tier, *row] for tier in ("push", "ci") for row in own] + [["--tier", "push", "tests"]]


def environment(folder, cache):
    """Return the environment of a run in a folder: its own sources, and a cache of compiled programs for all."""
    own = {name: value for name, value in os.environ.items() if not name.startswith("JAX_")}
    return own | {
        "PYTHONPATH": str(folder),
        "JAX_COMPILATION_CACHE_DIR": str(cache),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
        "JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES": "-1",
    }


def check_unmutated(copy, cache, arguments, jobs):
    """Run tests without a mutant, which also fills the cache. Raises SystemExit if one fails."""
    given = {"cwd": copy, "env": environment(copy, cache)}
    code = "import continuation, jaxvibro; print(continuation.__file__, jaxvibro.__file__)"
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True, **given)
    if done.stdout.count(str(copy)) != 2:
        raise SystemExit(f"the copy is not what is imported: {done.stdout}")
    if subprocess.run([sys.executable, *RUN, "-n", str(jobs), "--dist", "worksteal", *arguments], **given).returncode:
        raise SystemExit("a test fails without a mutant")


def attempt(mutant, copy, cache, runs, limit):
    """Return (result, seconds, end of the output) of a mutant: the first run that does not pass decides."""
    begun, output = time.monotonic(), ""
    with TemporaryDirectory(dir=copy.parent) as folder:
        place = Path(folder) / "mutated"
        shutil.copytree(copy, place)
        path = place / mutant.file
        for stale in (path.parent / "__pycache__").glob(f"{path.stem}.*.pyc"):
            stale.unlink()  # Python recognises a stale file by size and second only
        path.write_text(mutated(mutant, path.read_text("utf-8")), "utf-8")
        for arguments in runs:
            run = subprocess.Popen(
                [sys.executable, *RUN, *arguments],
                cwd=place,
                env=environment(place, cache),
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
                start_new_session=True,
            )
            try:
                output, _ = run.communicate(timeout=limit)
            except subprocess.TimeoutExpired:
                os.killpg(run.pid, signal.SIGKILL)
                run.communicate()
                return TOO_LONG, time.monotonic() - begun, ""
            # 1: a test fails, 2: a module cannot be imported, 5: nothing was collected; else it crashed.
            result = {0: SURVIVED, 1: KILLED, 2: KILLED, 5: SURVIVED}.get(run.returncode, NOT_RUN)
            if result != SURVIVED:
                break
    return result, time.monotonic() - begun, output[-2000:]


def is_killed(mutant, result):
    """Return whether a result means that a test noticed the mutant."""
    return result == KILLED or (result == TOO_LONG and mutant.endless)


def summarise(results):
    """Print a summary of (mutant, result) pairs; return whether they suffice."""
    folders = Counter(mutant.folder for mutant, _ in results)
    killed = Counter(mutant.folder for mutant, result in results if is_killed(mutant, result))
    print("\n" + ", ".join(f"{folder} {killed[folder]} of {count}" for folder, count in folders.items()))
    print(f"killed {killed.total()} of {len(results)}")
    good = killed.total() >= ENOUGH * len(results)
    for mutant, result in results:
        if result == KILLED and mutant.survives:
            print(f"{mutant.folder}: {mutant.name}: is noticed, though the list says: {mutant.survives}")
        if not is_killed(mutant, result):
            print(f"{mutant.folder}: {mutant.name}: {result}: {mutant.survives or 'unexplained'}")
            good &= bool(result == SURVIVED and mutant.survives)
    return good


def run_all(mutants, runs_of, first, limit, given, results=None):
    """Run mutants, and return (mutant, result) pairs.

    runs_of: from a mutant to the arguments of its runs; first: of the run without a mutant; results: a file of rows,
    whose killed mutants are not run again.
    """
    killed = set()
    if results and results.exists():
        rows = map(json.loads, results.open(encoding="utf-8"))
        killed = {json.dumps(row["mutant"]) for row in rows if row["result"] == KILLED}
    missing = [mutant for mutant in mutants if json.dumps(asdict(mutant)) not in killed]
    pairs = [(mutant, KILLED) for mutant in mutants if mutant not in missing]
    if not missing:
        return pairs
    with TemporaryDirectory() as folder:
        copy, cache = shutil.copytree(ROOT, Path(folder) / "copy", ignore=NOT_COPIED), RESULTS.parent / "cache"
        if not given.checked:
            check_unmutated(copy, cache, first, given.jobs)
        with ThreadPoolExecutor(given.jobs) as pool:
            attempts = pool.map(lambda mutant: attempt(mutant, copy, cache, runs_of(mutant), limit), missing)
            for mutant, (result, seconds, output) in zip(missing, attempts, strict=True):
                print(f"{result:9s}{seconds:6.1f} s  {mutant.folder}: {mutant.name}", flush=True)
                if given.show or result == NOT_RUN:
                    print(output)
                pairs.append((mutant, result))
                if results:
                    results.parent.mkdir(parents=True, exist_ok=True)
                    with results.open("a", encoding="utf-8") as file:
                        file.write(json.dumps({"mutant": asdict(mutant), "result": result, "output": output}) + "\n")
    return pairs


def main():
    """Run the action of the command line."""
    parser = argparse.ArgumentParser(prog="python -m tests.mutate", description=__doc__.split("\n")[0])
    parser.add_argument("action", nargs="?", choices=("listed", "draw", "drawn"), default="listed")
    parser.add_argument("numbers", nargs="*", type=int, help="of draw: count and seed")
    parser.add_argument("--jobs", type=int, default=2, help="runs at a time")
    parser.add_argument("--only", default="", help="mutants whose 'folder: name' contains this text")
    parser.add_argument("--checked", action="store_true", help="skip the run without a mutant: it has passed")
    parser.add_argument("--show", action="store_true", help="print the end of the output of each run")
    given = parser.parse_args()
    if given.action == "draw":
        print(f"{drawn_mutants.write(*given.numbers)} mutants in {DRAWN.relative_to(ROOT)}")
        return
    begun, listed = time.monotonic(), given.action == "listed"
    mutants = listed_mutants() if listed else drawn_list()
    mutants = [mutant for mutant in mutants if given.only in f"{mutant.folder}: {mutant.name}"]
    for mutant in mutants:
        mutated(mutant, (ROOT / mutant.file).read_text("utf-8"))
    if listed:
        tests = sorted({test for mutant in mutants for test in mutant.tests})
        results = run_all(mutants, lambda mutant: [mutant.tests], tests, LISTED_LIMIT, given)
    else:
        results = run_all(mutants, stages, ["--tier", "push", "tests"], DRAWN_LIMIT, given, RESULTS)
    good = summarise(results)
    print(f"{time.monotonic() - begun:.0f} s")
    raise SystemExit(0 if good else 1)


if __name__ == "__main__":
    main()
