"""What every test stands on: double precision, pictures without a screen, the same examples each time, and what is
compiled shared by the processes that tests start."""

import os
from pathlib import Path

import jax
import matplotlib
from hypothesis import settings

CACHE = {
    "JAX_COMPILATION_CACHE_DIR": str(Path(__file__).parents[1] / ".pytest_cache" / "jax"),
    "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
    "JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES": "-1",
}
os.environ.update({name: value for name, value in CACHE.items() if name not in os.environ})  # of processes begun here

jax.config.update("jax_enable_x64", True)
matplotlib.use("Agg")
settings.register_profile("same", deadline=None, derandomize=True, print_blob=True)
settings.load_profile("same")
