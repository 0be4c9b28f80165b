"""Reserve one core and measure on it: `python -m benchmarks.run [--limit DIR] [--quick] [--part NAME]`.

The core and the number of threads must be set before jax and numpy are loaded, so this file loads neither.
"""

import os
import sys

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")

if __name__ == "__main__":
    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    alone = {**os.environ, **dict.fromkeys(THREADS, "1"), "JAX_PLATFORMS": "cpu"}
    os.execve(sys.executable, [sys.executable, "-m", "benchmarks.measure", *sys.argv[1:]], alone)
