"""`jaxvibro view` as a process, and its page in Chromium."""

import os
import shutil
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

from playwright.sync_api import sync_playwright

ROOT = Path(__file__).parents[2]
NAMES = ("chromium", "chromium-browser", "google-chrome")
MISSING = f"there is none of {', '.join(NAMES)} here: apt-get install chromium"
WAIT = 120_000  # ms: for what compiles
# A page between two walls that asks for nothing but the branch of its first orbit.
SMALL = """[scene]
amplitude = 2.0
frequency = 2.1
damping = 0.05
restitution = 0.7
left.position = -1.0
right.position = 1.0

[branch]
parameter = "amplitude"
bounds = [0.0, 6.0]
start = {x = 0.9, v = -1.1}
"""
SAYS = "() => document.querySelector('header').innerText + document.getElementById('told').innerText"
SIZE = {"width": 1400, "height": 900}


def found():
    """The path of a Chromium, None where there is none."""
    return next((path for path in map(shutil.which, NAMES) if path), None)


@contextmanager
def chromium():
    """A Chromium without a window."""
    root = ["--no-sandbox"] if hasattr(os, "getuid") and os.getuid() == 0 else []
    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=found(), args=root)
        yield browser
        browser.close()


class Served:
    """The command on a scene file, in a process of its own."""

    def __init__(self, scene, home, port=0):
        here = {"XDG_CACHE_HOME": str(home), "PYTHONPATH": str(ROOT)}
        command = [sys.executable, "-m", "jaxvibro", "view", str(scene), "--no-browser", "--port", str(port)]
        self.process = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=home, env=os.environ | here
        )
        self.url = self.process.stdout.readline().strip()
        if not self.url:
            raise RuntimeError(self.process.stderr.read())

    @property
    def port(self):
        """The port that it is at."""
        return int(self.url.split(":")[2].split("/")[0])

    def kill(self):
        """Ends it, as a crash would."""
        self.process.kill()
        self.process.communicate()


@contextmanager
def served(scene, home):
    """A `Served`, ended at the end."""
    one = Served(scene, home)
    try:
        yield one
    finally:
        one.kill()


class Seen:
    """A page, and what it complained of."""

    def __init__(self, browser, url, wait=True, **asked):
        self.complaints = []
        self.context = browser.new_context(**{"viewport": SIZE, "accept_downloads": True, **asked})
        self.page = self.context.new_page()
        self.page.set_default_timeout(WAIT)
        self.page.on("console", lambda one: one.type == "error" and self.complaints.append(one.text))
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.page.goto(url)
        if wait:
            self.at_rest()

    def at_rest(self):
        """Waits until the page shows an orbit and nothing is under way."""
        self.until("jaxvibro.idle && jaxvibro.state.title && !jaxvibro.state.works.length")

    def until(self, condition):
        """Waits for a condition of the page, asked from outside: the page itself lets no text be run."""
        end = time.monotonic() + WAIT / 1000
        while not self.page.evaluate(f"() => Boolean({condition})"):
            assert time.monotonic() < end, f"never true: {condition}; {self.page.evaluate(SAYS)}"
            self.page.wait_for_timeout(10)

    def state(self, key):
        """What the page was told last."""
        return self.page.evaluate("(key) => jaxvibro.state[key]", key)

    def pixel(self, panel, x, y):
        """Where a point of a panel's axes is in the window."""
        return self.page.evaluate(
            """([name, x, y]) => {
                const area = document.getElementById(name).getBoundingClientRect();
                const [across, down] = panels[name].pixel([x, y]);
                return [area.left + across * area.width, area.top + down * area.height];
            }""",
            [panel, x, y],
        )

    def click(self, panel, x, y):
        """Clicks at a point of a panel's axes, and waits for what comes of it."""
        self.page.mouse.click(*self.pixel(panel, x, y))
        self.at_rest()

    def drag(self, panel, first, last):
        """Drags from a point of a panel's axes to another."""
        self.page.mouse.move(*self.pixel(panel, *first))
        self.page.mouse.down()
        self.page.mouse.move(*self.pixel(panel, *last), steps=5)
        self.page.mouse.up()
        self.until("jaxvibro.idle")

    def take(self, name):
        """A file of the page: its bytes."""
        if self.page.get_attribute("#files", "open") is None:
            self.page.click("#files summary")
        with self.page.expect_download() as told:
            self.page.click(f"[data-take='{name}']")
        assert told.value.suggested_filename == name
        return Path(told.value.path()).read_bytes()

    def ends(self):
        """Closes the page; it must not have complained."""
        self.context.close()
        assert self.complaints == []
