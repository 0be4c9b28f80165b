"""Whether an interrupted `jaxvibro paper` goes on to the same numbers: `python -m tests.paper_proof [TIMES] [SEED]`.

It is begun and killed or interrupted at so many random moments, then left to end; then done once without a stop. All
claims must have the same values, bit for bit. The folder is a temporary one.
"""

import json
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

LONGEST = 45.0  # seconds until it is stopped
COMMAND = [sys.executable, "-m", "jaxvibro", "paper", "--out"]


def proof(times, seed):
    draw = np.random.default_rng(seed)
    with tempfile.TemporaryDirectory() as folder:
        begun, whole = (Path(folder) / name for name in ("stopped", "whole"))
        for count in range(times):
            stopped([*COMMAND, str(begun)], draw.uniform(3.0, LONGEST), draw.choice([signal.SIGINT, signal.SIGKILL]))
            done = len(list(begun.glob("*.json")))
            print(f"stop {count + 1}: {done} figures done, files left over: {_left(begun)}", flush=True)
        for out in (begun, whole):
            began = time.perf_counter()
            subprocess.run([*COMMAND, str(out)], check=True, capture_output=True)
            print(f"{out.name}: {time.perf_counter() - began:.0f} s to the end", flush=True)
        first, second = (_claims(out) for out in (begun, whole))
        differ = [name for name in second if first.get(name) != second[name]]
        print(f"{len(second)} figures, {sum(map(len, second.values()))} claims; with other numbers: {differ or 'none'}")


def stopped(command, after, how):
    """Begins a command and stops it by a signal after some seconds."""
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    run = subprocess.Popen(command, preexec_fn=_heard, **quiet)
    try:
        run.wait(after)
    except subprocess.TimeoutExpired:
        run.send_signal(how)
        run.wait()


def _heard():
    """An interrupt is heard, also where this was begun in a shell's background."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def _left(out):
    return [path.name for path in out.glob(".*")]


def _claims(out):
    return {path.name: json.loads(path.read_text())["claims"] for path in sorted(out.glob("*.json"))}


if __name__ == "__main__":
    given = [int(one) for one in sys.argv[1:3]]
    proof(*given, *(20, 1)[len(given) :])
