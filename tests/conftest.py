"""What every test stands on: double precision, pictures without a screen, the same examples each time, what is compiled
shared by the processes that tests start, and let go where it has grown large."""

import ctypes
import gc
import os
import platform
from pathlib import Path

import jax
import matplotlib
import pytest
from hypothesis import settings

from . import checked_types

LARGE = 4e9  # bytes that a process may hold: ten scenes with soft walls, each with functions of its own

CACHE = {
    "JAX_COMPILATION_CACHE_DIR": str(Path(__file__).parents[1] / ".pytest_cache" / "jax"),
    "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
    "JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES": "-1",
}
os.environ.update({name: value for name, value in CACHE.items() if name not in os.environ})  # of processes begun here

jax.config.update("jax_enable_x64", True)
gc.set_threshold(50_000, 20, 50)  # tracing makes many objects that stay: a twentieth of the time went to their rounds
checked_types.install()
matplotlib.use("Agg")
settings.register_profile("same", deadline=None, derandomize=True, print_blob=True)
settings.load_profile("same")


@pytest.fixture(autouse=True)
def small():
    """What is compiled is let go, and given back to the system, where a process has grown large."""
    yield
    if platform.system() == "Linux" and resident() > LARGE:
        jax.clear_caches()
        getattr(ctypes.CDLL(None), "malloc_trim", lambda _: None)(0)


def resident():
    """Bytes of this process that lie in memory."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
