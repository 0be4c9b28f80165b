"""What every test stands on: double precision, pictures without a screen, the same examples each time, what is compiled
shared by the processes that tests start, and let go where it has grown large."""

import ctypes
import gc
import os
import platform
from contextlib import nullcontext
from pathlib import Path

CACHE = {
    "JAX_COMPILATION_CACHE_DIR": str(Path(__file__).parents[1] / ".pytest_cache" / "jax"),
    "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
    "JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES": "-1",
}
os.environ.update({name: value for name, value in CACHE.items() if name not in os.environ})  # before jax is imported

import jax  # noqa: E402
import matplotlib as mpl  # noqa: E402
import pytest  # noqa: E402
from hypothesis import settings  # noqa: E402

from . import checked_types, smoke, tiers  # noqa: E402

LARGE = 4e9  # bytes that a process may hold: ten scenes with soft walls, each with functions of its own

jax.config.update("jax_enable_x64", True)
gc.set_threshold(50_000, 20, 50)  # tracing makes many objects that stay: a twentieth of the time went to their rounds
checked_types.install()
mpl.use("Agg")
settings.register_profile("same", deadline=None, derandomize=True, print_blob=True)
settings.load_profile("same")


def pytest_addoption(parser):
    """Add the options that choose a tier, or draws of properties."""
    parser.addoption(
        "--tier", choices=tiers.TIERS, help="run only what a tier adds to the ones before (tests/tiers.toml)"
    )
    parser.addoption("--draws", type=int, help="of each property, instead of the tier's number")


def module_name(module):
    """Return the name of a test module without the package."""
    return module.__name__.removeprefix("tests.")


def pytest_generate_tests(metafunc):
    """Make a test of each kind of a property, with the draws of the tier if it has more than the tier before."""
    if not getattr(metafunc.function, "is_property", False):
        return
    folder = module_name(metafunc.module).removeprefix("properties.test_")
    draws, tier = metafunc.config.getoption("draws"), metafunc.config.getoption("tier")
    names = tuple(metafunc.function.kinds)
    rows = tiers.draws_of(folder, metafunc.function.__name__.removeprefix("test_"), names)
    numbers = [(row.kind, draws or row.in_tier(tier)) for row in rows]
    metafunc.parametrize(("kind", "draws"), [pytest.param(*row, id=row[0]) for row in numbers if row[1]])


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config, items):
    """Select the tests of a tier; those whose pages need a browser run before a release alone."""
    release = [item for item in items if own_tier(item) == "release" and not item.get_closest_marker("browser")]
    for item in smoke.choose(release):
        item.add_marker(pytest.mark.smoke)
    tier = config.getoption("tier")
    if tier is None:
        return
    chosen = [item for item in items if is_in_tier(item, tier)]
    config.hook.pytest_deselected(items=[item for item in items if item not in set(chosen)])
    items[:] = chosen


def own_tier(item):
    """Return the first tier in which a test runs that is no property; of a property "", as its draws decide."""
    if getattr(item.function, "is_property", False):
        return ""
    marked = [
        tier
        for mark, tier in (("long", "release"), ("browser", "release"), ("slow", "ci"))
        if item.get_closest_marker(mark)
    ]
    return marked[0] if marked else tiers.tier_of(module_name(item.module), item.name)


def is_in_tier(item, tier):
    """Return whether a test is what a tier adds to the ones before it."""
    return own_tier(item) in ("", tier) or (tier == "ci" and item.get_closest_marker("smoke") is not None)


def limited(item):
    """Run a phase of a test, with a time limit if the test is only tried."""
    tried = item.get_closest_marker("smoke") and item.config.getoption("tier") == "ci"
    with smoke.time_limit(item.stash, smoke.TEST_SECONDS) if tried else nullcontext():
        return (yield)


# Pytest catches the exceptions of these phases; one raised between them would end the whole run.
pytest_runtest_setup = pytest.hookimpl(wrapper=True)(limited)
pytest_runtest_call = pytest.hookimpl(wrapper=True)(limited)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item, call):
    """A test that has run for its time without an error has passed.

    The report is made without the exception: where it was raised there may be no line to show, and hypothesis, which
    calls the test again, raises one of its own.
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
