"""Load a hand-written kernel outside this project, DIR/limit.py with load() -> strobe(states (n, 3)) -> ends (n, 2).

It is tried in a process of its own first: built for other processors it may not compile, or crash. Run as a script on
DIR this module makes that trial.
"""

import importlib.util
import pathlib
import shutil
import signal
import subprocess
import sys

import numpy as np

COMPILERS = ("clang++", "clang++-19", "clang++-16", "clang++-15", "clang++-14")
UNSET = "skipped: no LIMIT=DIR was given"


def load(directory):
    """Return the kernel's map, and a line with its kind and the first line of its description."""
    path = pathlib.Path(directory) / "limit.py"
    spec = importlib.util.spec_from_file_location("yardstick", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    kind = getattr(module, "kind", lambda: "its only")()
    return module.load(), f"{kind} kernel. {(module.__doc__ or 'No description.').strip().splitlines()[0]}"


def found(directory):
    """Return the kernel's map, None if it cannot run on this machine, and a line on it."""
    why = refusal(directory)
    return (None, why) if why else load(directory)


def refusal(directory):
    """Explain in one line why the kernel cannot run on this machine; None if it can."""
    if not directory:
        return UNSET
    if not (pathlib.Path(directory) / "limit.py").is_file():
        return "skipped: the folder given by LIMIT contains no limit.py"
    trial = subprocess.run([sys.executable, "-m", "benchmarks.limit", directory], capture_output=True, text=True)
    if trial.returncode == 0:
        return None
    return f"skipped: {reason(trial)}"


def reason(trial):
    """Explain a failed trial: missing processor features, or how the trial ended."""
    if not any(map(shutil.which, COMPILERS)):
        return "it needs clang, which is not on the path"
    lacks = "" if "avx512dq" in flags() else "; this processor lacks AVX-512, which it may need"
    if trial.returncode < 0:
        return f"its trial was stopped by {signal.Signals(-trial.returncode).name}{lacks}"
    lines = (trial.stderr.strip() or "no message").splitlines()
    cause = next((line.split("error:")[1].strip() for line in lines if "error:" in line), lines[-1])
    return f"it does not build or run here ({cause[:90]}){lacks}"


def flags():
    """Return the processor's features, as Linux names them."""
    info = pathlib.Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else []
    return next((line.split(":")[1].split() for line in lines if line.startswith("flags")), [])


if __name__ == "__main__":
    ends = load(sys.argv[1])[0](np.array([[0.9, -1.1, 2.0]] * 100))
    sys.exit(0 if np.isfinite(ends).all() else "it returned no finite numbers")
