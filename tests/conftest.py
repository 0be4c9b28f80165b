"""What every test stands on: double precision, pictures without a screen, the same examples each time, what is compiled
shared by the processes that tests start, and let go where it has grown large."""

import ctypes
import gc
import os
import platform
from pathlib import Path

CACHE = {
    "JAX_COMPILATION_CACHE_DIR": str(Path(__file__).parents[1] / ".pytest_cache" / "jax"),
    "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
    "JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES": "-1",
}
os.environ.update({name: value for name, value in CACHE.items() if name not in os.environ})  # before jax is imported

COVERAGE = "COVERAGE" in os.environ and "PYTEST_XDIST_WORKER" in os.environ  # whether lines are recorded here

import jax  # noqa: E402
import matplotlib as mpl  # noqa: E402
import pytest  # noqa: E402
from hypothesis import settings  # noqa: E402

from . import checked_types, line_coverage, tiers  # noqa: E402

LARGE = 4e9  # bytes that a process may hold: ten scenes with soft walls, each with functions of its own

jax.config.update("jax_enable_x64", True)
gc.set_threshold(50_000, 20, 50)  # tracing makes many objects that stay: a twentieth of the time went to their rounds
checked_types.install(line_coverage.record if COVERAGE else lambda spec: None)
mpl.use("Agg")
settings.register_profile("same", deadline=None, derandomize=True, print_blob=True)
settings.load_profile("same")


def pytest_addoption(parser):
    """Add the options that choose a tier, or draws of properties."""
    parser.addoption(
        "--tier", choices=tiers.TIERS, help="run only what a tier adds to the ones before (tests/tiers.toml)"
    )
    parser.addoption("--draws", type=int, help="of each property, instead of the tier's number")


def pytest_configure(config):
    """Compile with little optimisation in CI, also in processes that tests start: half of the time went to it."""
    if config.getoption("tier") == "ci":
        os.environ["JAX_DISABLE_MOST_OPTIMIZATIONS"] = "1"
        jax.config.update("jax_disable_most_optimizations", True)


def pytest_sessionfinish():
    """Write the lines that this process has run."""
    if COVERAGE:
        line_coverage.write(checked_types.PACKAGES)


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


def pytest_collection_modifyitems(config, items):
    """Select the tests of a tier, no property without draws in it, and no test of a graphics card without one."""
    tier = config.getoption("tier")
    chosen = [item for item in items if has_draws(item) and (tier is None or own_tier(item) in ("", tier))]
    if not any(device.platform == "gpu" for device in jax.devices()):
        chosen = [item for item in chosen if not item.get_closest_marker("card")]
    config.hook.pytest_deselected(items=[item for item in items if item not in set(chosen)])
    items[:] = chosen


def has_draws(item):
    """Return whether a test is no property, or one of a kind that has draws."""
    return not getattr(item.function, "is_property", False) or isinstance(item.callspec.params["kind"], str)


def own_tier(item):
    """Return the first tier in which a test runs that is no property; of a property "", as its draws decide."""
    if getattr(item.function, "is_property", False):
        return ""
    return "release" if item.get_closest_marker("browser") else tiers.tier_of(module_name(item.module), item.name)


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
