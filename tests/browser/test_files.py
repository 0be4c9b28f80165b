"""What can be taken from the page, and a server that has gone and is back."""

import io
import re
import subprocess
import sys
import zipfile
from contextlib import suppress

import pytest
import xarray as xr

from .served import ROOT, Seen, Served, served

pytestmark = pytest.mark.browser

PICTURES = {"png": b"\x89PNG\r\n\x1a\n", "svg": b"<?xml", "pdf": b"%PDF-"}
PANELS = ("diagram", "plane", "portrait", "trace")


def test_a_scene_file_opens_again(browser, seen, tmp_path):
    seen.click("diagram", 2.75, 0.72)
    path = tmp_path / "scene.toml"
    path.write_bytes(seen.take("scene.toml"))
    with served(path, tmp_path) as server:
        again = Seen(browser, server.url)
        for key in ("python", "facts", "title", "numbers", "points"):
            assert again.state(key) == seen.state(key)
        again.ends()
    seen.page.fill("#number_damping", "0.06")
    seen.page.keyboard.press("Enter")
    seen.at_rest()
    lines = seen.state("python")
    seen.page.set_input_files("#load", path)
    seen.until(f"jaxvibro.idle && jaxvibro.state.python.length < {len(lines)}")
    seen.at_rest()
    assert seen.state("numbers")["damping"] == 0.05


def test_the_lines_alone_print_the_same_numbers(seen, tmp_path):
    seen.click("diagram", 2.75, 0.72)
    path = tmp_path / "lines.py"
    path.write_bytes(seen.take("lines.py"))
    assert path.read_text() == seen.state("python")
    run = subprocess.run([sys.executable, path], capture_output=True, text=True, cwd=ROOT, check=True)
    point, _, orbit = seen.state("facts").partition("\n\n")
    assert point.startswith("point ")
    assert orbit in run.stdout
    for one in seen.state("points"):
        told = re.search(rf"^{one['kind']} +(\S+)", run.stdout, re.MULTILINE)
        assert float(told[1]) == pytest.approx(one["value"], rel=1e-8)


def test_the_data_are_netcdf(seen):
    with zipfile.ZipFile(io.BytesIO(seen.take("data.zip"))) as file:
        assert {"branch_1.nc", "branch_1.txt", "orbit_1.nc"} <= set(file.namelist())
        content = file.read("orbit_1.nc")
        table = file.read("orbit_1.txt").decode()
    assert content[:3] == b"CDF" or content[:4] == b"\x89HDF"
    motion = xr.load_dataset(io.BytesIO(content))
    x = float(re.search(r"x (\S+), v", table)[1])
    assert float(motion["x"][0]) == pytest.approx(x, rel=1e-9)
    assert motion.sizes["impact"] == 2


@pytest.mark.parametrize("panel", PANELS)
def test_pictures_are_of_their_kinds(seen, panel):
    for kind, magic in PICTURES.items():
        content = seen.take(f"{panel}.{kind}")
        assert content.startswith(magic) and len(content) > 5000


def test_a_page_outlives_its_server(browser, small):
    first = Served(small, small.parent)
    seen = Seen(browser, first.url)
    seen.click("diagram", 2.75, 0.72)
    kept = {key: seen.state(key) for key in ("python", "facts", "numbers", "points")}
    first.kill()
    seen.until("document.body.classList.contains('lost')")
    assert "trying again" in seen.page.inner_text("#status")
    second = Served(small, small.parent, first.port)
    try:
        assert second.url == first.url
        seen.until("!document.body.classList.contains('lost')")
        seen.until("jaxvibro.idle && !jaxvibro.state.works.length && jaxvibro.pictures.portrait > 2")
        assert {key: seen.state(key) for key in kept} == kept
        seen.page.click("#undo", force=True)
        seen.click("diagram", 1.5, 0.65)
        assert seen.state("facts") != kept["facts"]
    finally:
        second.kill()
    with suppress(AssertionError):
        seen.ends()
    assert all("ERR_CONNECTION_REFUSED" in one for one in seen.complaints)
