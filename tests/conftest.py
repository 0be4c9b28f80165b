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

from . import checked_types, smoke

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


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    """Mark the long tests that are tried for a few seconds."""
    for item in smoke.choose(items):
        item.add_marker(pytest.mark.smoke)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item, nextitem):
    """Give a long test that is only tried its time limit, its fixtures included."""
    tried = item.get_closest_marker("smoke") and "smoke" in item.config.getoption("markexpr")
    if tried:
        smoke.limit(smoke.TEST_SECONDS)
    try:
        return (yield)
    finally:
        if tried:
            smoke.limit(0)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item, call):
    """A test that has run for its time without an error has passed."""
    report = yield
    if call.excinfo is not None and call.excinfo.errisinstance(smoke.OutOfTime):
        report.outcome, report.longrepr = "passed", None
        item.user_properties.append(("stopped", "after its time limit"))
    return report


@pytest.hookimpl(tryfirst=True)
def pytest_pyfunc_call(pyfuncitem):
    """Do not call a test whose fixtures took all the time."""
    return True if pyfuncitem.user_properties and "stopped" in dict(pyfuncitem.user_properties) else None


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
