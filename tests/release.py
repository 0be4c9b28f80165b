"""Run the tests that a release adds to CI, and write a table: `python -m tests.release FOLDER [WORDS ...] [--draws N]`.

Each property of each kind, and the release tests of each file, run in a process of their own with the draws of
`tests/tiers.toml`. Results are kept in FOLDER by commit, one line per job. A later call runs the jobs that are missing
or have failed. WORDS select the jobs whose names contain one of them. With --draws each property has this number of
draws, all kinds of a property run in one process, and the results have their own folder. The environment variable
FIRST_DRAW is the number of the first draw.
"""

import argparse
import json
import os
import re
import subprocess
import sys
import time
from collections import defaultdict
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from . import tiers

ROOT = Path(__file__).parents[1]
WORKERS = 2
COLLECTED = re.compile(r"^(tests/[\w/]+\.py)::(\w+)(\[.*\])?$", re.MULTILINE)


def commit():
    """Return the commit of the sources, marked if they have changed since."""

    def git(*arguments):
        return subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=True).stdout.strip()

    return git("rev-parse", "--short=12", "HEAD") + ("-changed" if git("status", "--porcelain") else "")


def jobs(draws):
    """Return the jobs as {name: (arguments of pytest, draws)}.

    `draws` is the number of draws of each property and kind. None takes the numbers of a release.
    """
    command = [sys.executable, "-m", "pytest", "-q", "--collect-only", "--tier", "release", "tests"]
    listed = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False).stdout
    found, of_properties, others = {}, defaultdict(list), defaultdict(list)
    for file, name, case in COLLECTED.findall(listed):
        node, folder, name = f"{file}::{name}{case}", Path(file).stem.removeprefix("test_"), name.removeprefix("test_")
        if "/properties/" not in file or name not in tiers.table().get(folder, {}):
            others[folder].append(node)
        elif draws:
            of_properties[f"{folder}.{name}"].append(node)
        else:
            numbers, kind = tiers.table()[folder][name], case.strip("[]")
            found[f"{folder}.{name}[{kind}]"] = [node], numbers.get("of", {}).get(kind, numbers["draws"])[-1]
    found |= {name: (["--draws", str(draws), *nodes], draws * len(nodes)) for name, nodes in of_properties.items()}
    return found | {name: (nodes, len(nodes)) for name, nodes in others.items()}


def run(arguments):
    """Return (whether the tests pass, seconds, the end of what they printed)."""
    begun = time.monotonic()
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--tier", "release", *arguments]
    done = subprocess.run(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False)
    return done.returncode == 0, time.monotonic() - begun, "" if done.returncode == 0 else done.stdout[-3000:]


def known(path):
    """Return {name: result} of the jobs that have passed."""
    lines = path.read_text("utf-8").splitlines() if path.exists() else []
    return {row["name"]: row for row in map(json.loads, lines) if row["passed"]}


def table(results):
    """Return the results as a table in Markdown, and the sums."""
    rows = ["| job | draws or tests | seconds | result |", "|---|---|---|---|"]
    for row in sorted(results.values(), key=lambda row: row["name"]):
        outcome = "passed" if row["passed"] else "FAILED"
        rows.append(f"| {row['name']} | {row['draws']:,} | {row['seconds']:.0f} | {outcome} |")
    seconds, failed = (
        sum(row["seconds"] for row in results.values()),
        sum(not row["passed"] for row in results.values()),
    )
    return "\n".join([*rows, "", f"{len(results)} jobs, {failed} failed, {seconds / 3600.0:.2f} hours of processes"])


def main():
    """Run what is missing; return whether all has passed."""
    parser = argparse.ArgumentParser(prog="python -m tests.release", description=__doc__.split("\n")[0])
    parser.add_argument("folder", type=Path, help="of the results")
    parser.add_argument("words", nargs="*", help="parts of the names of jobs")
    parser.add_argument("--draws", type=int, help="of each property and kind, instead of those of a release")
    given = parser.parse_args()
    words, folder = given.words, given.folder / (commit() + (f"-draws-{given.draws}" if given.draws else ""))
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "results.jsonl"
    chosen = {name: job for name, job in jobs(given.draws).items() if not words or any(word in name for word in words)}
    results = {name: row for name, row in known(path).items() if name in chosen}
    missing = [name for name in chosen if name not in results]
    print(f"{len(chosen)} jobs, {len(missing)} of them to run", flush=True)

    def work(name):
        arguments, draws = chosen[name]
        passed, seconds, output = run(arguments)
        return {"name": name, "draws": draws, "seconds": seconds, "passed": passed, "output": output}

    with ThreadPoolExecutor(int(os.environ.get("WORKERS", WORKERS))) as pool, path.open("a", encoding="utf-8") as file:
        for row in pool.map(work, missing):
            file.write(json.dumps(row) + "\n")
            file.flush()
            results[row["name"]] = row
            print(f"{row['name']}: {'passed' if row['passed'] else 'FAILED'} in {row['seconds']:.0f} s", flush=True)
            print(row["output"], end="", flush=True)
    (folder / "table.md").write_text(table(results) + "\n", "utf-8")
    print(table(results).rpartition("\n")[2], f"table: {folder / 'table.md'}", sep="; ")
    return all(row["passed"] for row in results.values())


if __name__ == "__main__":
    sys.exit(not main())
