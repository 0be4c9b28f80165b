"""One Chromium and one server for all tests that need no other."""

import pytest

from . import served


@pytest.fixture(scope="session")
def browser():
    if served.find_chromium() is None:
        pytest.fail(served.MISSING, pytrace=False)
    with served.chromium() as browser:
        yield browser


@pytest.fixture(scope="session")
def small(tmp_path_factory):
    path = tmp_path_factory.mktemp("scene") / "small.toml"
    path.write_text(served.SMALL)
    return path


@pytest.fixture(scope="session")
def server(browser, small):
    with served.Server(small, small.parent) as server:
        yield server


@pytest.fixture
def seen(browser, server):
    seen = served.Seen(browser, server.url)
    yield seen
    seen.close()
