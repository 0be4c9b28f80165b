"""The files of a page, and a server that ends and starts again."""

from contextlib import suppress

import pytest

from .served import Seen, Server

pytestmark = pytest.mark.browser

KINDS = {"png": b"\x89PNG\r\n\x1a\n", "svg": b"<?xml", "pdf": b"%PDF-"}


def test_a_scene_file_opens_again(browser, seen, tmp_path):
    seen.click("diagram", 2.75, 0.72)
    path = tmp_path / "scene.toml"
    path.write_bytes(seen.take("scene.toml"))
    with Server(path, tmp_path) as server:
        again = Seen(browser, server.url)
        for key in ("python", "facts", "title", "numbers", "points"):
            assert again.state(key) == seen.state(key)
        again.close()
    seen.enter("damping", "0.06")
    lines = seen.state("python")
    seen.page.set_input_files("#load", path)
    seen.until(f"jaxvibro.idle && jaxvibro.state.python.length < {len(lines)}")
    seen.rest()
    assert seen.state("numbers")["damping"] == 0.05


def test_each_file_of_the_menu_is_of_its_kind(seen):
    seen.click("diagram", 2.75, 0.72)
    assert seen.take("lines.py").decode() == seen.state("python")
    assert seen.take("data.zip").startswith(b"PK")
    for panel in ("diagram", "plane", "portrait", "trace"):
        for kind, magic in KINDS.items():
            content = seen.take(f"{panel}.{kind}")
            assert content.startswith(magic) and len(content) > 5000


def test_a_page_outlives_its_server(browser, small):
    with Server(small, small.parent) as first:
        seen = Seen(browser, first.url)
        seen.click("diagram", 2.75, 0.72)
        before = {key: seen.state(key) for key in ("python", "facts", "numbers", "points")}
    seen.until("document.body.classList.contains('lost')")
    assert "trying again" in seen.page.inner_text("#status")
    with Server(small, small.parent, first.url.split(":")[2].split("/")[0]) as second:
        assert second.url == first.url
        seen.until("!document.body.classList.contains('lost')")
        seen.until("jaxvibro.idle && !jaxvibro.state.works.length && jaxvibro.pictures.portrait > 2")
        assert {key: seen.state(key) for key in before} == before
        seen.page.click("#undo", force=True)
        seen.click("diagram", 1.5, 0.65)
        assert seen.state("facts") != before["facts"]
    with suppress(AssertionError):
        seen.close()
    assert all("ERR_CONNECTION_REFUSED" in text for text in seen.complaints)
