"""What every test stands on: double precision, pictures without a screen, the same examples each time, what is compiled
shared by the processes that tests start, and let go where it has grown large."""

import ctypes
import gc
import os
import platform
from contextlib import nullcontext
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


def limited(item):
    """Run a phase of a test, with a time limit if the test is only tried."""
    tried = item.get_closest_marker("smoke") and "smoke" in item.config.getoption("markexpr")
    with smoke.time_limit(smoke.TEST_SECONDS, item.stash) if tried else nullcontext():
        return (yield)


# Pytest catches the exceptions of these phases; one raised between them would end the whole run.
pytest_runtest_setup = pytest.hookimpl(wrapper=True)(limited)
pytest_runtest_call = pytest.hookimpl(wrapper=True)(limited)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item, call):
    """A test that is stopped has passed.

    The report is made without the exception: where it was raised there may be no line to show, and hypothesis, which
    calls a stopped test again, raises an error of its own.
    """
    if item.stash.get(smoke.STOPPED, None):
        call.excinfo = None
    return (yield)


@pytest.hookimpl(tryfirst=True)
def pytest_pyfunc_call(pyfuncitem):
    """Do not call a test whose fixtures took all the time."""
    return pyfuncitem.stash.get(smoke.STOPPED, None)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_teardown(item):
    """After a stopped test tear down all fixtures: one that was stopped must run again for the next test."""
    result = yield
    if item.stash.get(smoke.STOPPED, None):
        item.session._setupstate.teardown_exact(None)
    return result


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
