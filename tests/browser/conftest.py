"""One Chromium and one server for all tests that need no other."""

import pytest

from . import served


@pytest.fixture(scope="session")
def browser():
    if served.found() is None:
        pytest.fail(served.MISSING, pytrace=False)
    with served.chromium() as one:
        yield one


@pytest.fixture(scope="session")
def small(tmp_path_factory):
    path = tmp_path_factory.mktemp("scene") / "small.toml"
    path.write_text(served.SMALL)
    return path


@pytest.fixture(scope="session")
def server(browser, small):
    with served.served(small, small.parent) as one:
        yield one


@pytest.fixture
def seen(browser, server):
    one = served.Seen(browser, server.url)
    yield one
    one.ends()
