"""Random compositions in child processes: `python -m tests.compositions_proof COUNT [FOLDER] [FIRST]` prints failures.

Ten compositions a process; results are kept in FOLDER/results.jsonl, and a later run goes on with what is missing. A
process that dies is reported with the composition that it died of. XLA_FLAGS are handed on, so that
`XLA_FLAGS=--xla_cpu_max_isa=AVX2` looks at another instruction set.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
EACH = 10  # compositions of a process
KINDS = 15  # of scenes, which take turns; those of one kind share the programs of their single calls
SECONDS = 1200.0  # for one composition; more is a failure


def children(seeds, folder):
    """{seed: its result}, worked out by one process after the other."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    found = known(folder)
    waiting = sorted((seed for seed in seeds if seed not in found), key=lambda seed: (seed % KINDS, seed))
    while waiting:
        some, waiting = waiting[:EACH], waiting[EACH:]
        environment = {**os.environ, "JAX_COMPILATION_CACHE_DIR": str(folder / "cache"), "PYTHONPATH": str(ROOT)}
        environment |= {"JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0", "JAX_ENABLE_X64": "1"}
        environment["XLA_FLAGS"] = f"--xla_force_host_platform_device_count=2 {os.environ.get('XLA_FLAGS', '')}"
        command = [sys.executable, "-m", "tests.compositions_proof", "child", str(folder), *map(str, some)]
        try:
            ended = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, timeout=SECONDS * EACH)
            code, said = ended.returncode, ended.stderr.decode(errors="replace")[-600:]
        except subprocess.TimeoutExpired:
            code, said = -1, "out of time"
        found = known(folder)
        left = [seed for seed in some if seed not in found]
        if left:
            keep(folder, {"seed": left[0], "failure": f"the process ended with {code}: {said}"})
            waiting = left[1:] + waiting
            found = known(folder)
    return {seed: found[seed] for seed in seeds}


def known(folder):
    """{seed: its result} of those that are done."""
    place = folder / "results.jsonl"
    return {one["seed"]: one for one in map(json.loads, place.read_text().splitlines())} if place.exists() else {}


def keep(folder, result):
    with (folder / "results.jsonl").open("a") as file:
        file.write(json.dumps(result) + "\n")


def child(folder, seeds):
    """Work out some compositions in this process, each kept as soon as it is done."""
    from tests import compositions  # noqa: PLC0415 - the parent does not load jax

    for seed in seeds:
        one = compositions.draw(seed)
        try:
            result = compositions.run(one)
        except Exception as error:
            result = {"failure": f"{type(error).__name__}: {str(error)[:500]}"}
        keep(folder, one | result)


def main(count, folder, first=0):
    """Print what failed, and the sums."""
    results = children(range(first, first + count), folder)
    failed = [one for one in results.values() if "failure" in one]
    wrong = [one for one in results.values() if one.get("error", 0.0) > 1]
    for one in failed + wrong:
        print(json.dumps(one))
    lanes, slow = (sum(one.get(key, 0) for one in results.values()) for key in ("compared", "slow"))
    print(f"compositions {first} to {first + count - 1}: {len(failed)} failed, {len(wrong)} wrong")
    print(f"{lanes} lanes compared, {slow} of them with a slow impact or a status: these are not held to the bound")
    return not failed and not wrong


if __name__ == "__main__":
    if sys.argv[1] == "child":
        child(Path(sys.argv[2]), [int(seed) for seed in sys.argv[3:]])
    else:
        given = sys.argv[1:] + ["out/compositions", "0"][len(sys.argv) - 2 :]
        sys.exit(not main(int(given[0]), given[1], int(given[2])))
